"""Parses a vision-language model's reply: JSON, something like JSON, or sentences about a gate.

Pure text processing. A reply names a gate, or is one of the faults of `ReasonerError`. Nothing is guessed: the flight
continues well enough without an answer.
"""

from __future__ import annotations

import re
from dataclasses import replace

from cognitivedrone.errors import ReasonerError, ReasonerFault
from cognitivedrone.reasoners.sentences import Description, contradicts, describe, read_sentences
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import Guidance

MAX_REPLY = 4000
"""Maximum length in characters; a reply of the schema has under 80, a long chain of thought some 2000."""
CONFIDENCE = (0.0, 0.6, 0.8, 1.0)
"""Confidence by the number of parts (size, color, shape) named, for replies that give none of their own."""

LONGEST_THINKING = 100_000
"""Maximum length in characters of a reply with its thinking, which is not read."""
FINISHED = frozenset(("stop", "eos", "eos_token", "end_turn", "stop_sequence"))
"""Values of `finish_reason` by which servers say that the model ended its reply itself."""

_NAMES = r"(?:seed:)?(?:think(?:ing)?|thoughts?|reason(?:ing)?|analysis|reflection|scratchpad|cot)"
_OPENING = re.compile(
    rf"<\|?{_NAMES}\|?>|<\|begin_of_thought\|>|\[THINK\]|◁think▷|<\|?channel\|?>\s*(?:analysis|thought|commentary)",
    re.IGNORECASE,
)
_CLOSING = re.compile(
    rf"</\|?{_NAMES}\|?>|<\|end_of_thought\|>|\[/THINK\]|◁/think▷|<\|?channel\|?>\s*final(?:<\|message\|>)?|<channel\|>",
    re.IGNORECASE,
)
"""How models mark their thinking, and its end: Qwen, DeepSeek, GLM and most others, Seed, Magistral, Kimi, gpt-oss."""
_FINAL = re.compile(
    r"<(?P<tag>answer|conclusion|response)>|<\|begin_of_(?:box|solution)\|>|\\boxed\{(?:\\text\{)?", re.IGNORECASE
)
_FINAL_END = re.compile(r"</(?:answer|conclusion|response)>|<\|end_of_(?:box|solution)\|>", re.IGNORECASE)
_PAIR = re.compile(
    r"""["']?(?P<key>[A-Za-z_]\w*)["']?\s*:\s*
        (?: "(?P<double>[^"\n]*)" | '(?P<single>[^'\n]*)' | \[\s*["']?(?P<item>[^\[\],"'\n]*)["']?\s*\]
          | (?P<bare>[-+\w.%]+(?:[ ]\w+)*)\s*(?=[,}\n]) )
        (?P<open>(?!\s*(?:[,}\n]|//|\#|$)))?""",
    re.VERBOSE,
)
_OBJECT = re.compile(r"\{[^{}]*(?:\}|$)")
_CORRECTION = re.compile(
    r"\b(?:wait|actually|answer|final(?:ly)?|so|therefore|thus|hence|correct(?:ion|ed)?|sorry|instead|revised|rather)\b",
    re.IGNORECASE,
)
_CONDITION = re.compile(r"\W*(?:if|unless|or|when|provided)\b", re.IGNORECASE)
_ENDS_OPEN = re.compile(
    r"(?:[,;:(-]|\b(?:the|an?|is|are|and|or|but|with|of|to|in|on|at|by|that|which|because|so|therefore|thus|shows?|has|"
    r"have|i|it|its|this|must|should|would|will|if|not|for|from|be|as|fly|through|since|if|when|while))$",
    re.IGNORECASE,
)
_KEYS = {"colour": "color", "position": "gate", "index": "gate", "gate_color": "color", "gate_shape": "shape"}
_UNKNOWN = {"", "unknown", "none", "null", "unsure", "unclear", "n/a", "na", "cannot tell", "uncertain", "not sure"}
_POSITIONS = {"left": 0, "middle": 1, "center": 1, "centre": 1, "right": 2}
_HTML = re.compile(r"<\s*(?:!doctype|html|head|body|div|script|title)\b", re.IGNORECASE)
_TEXT_CONFIDENCE = re.compile(r"confiden\w*\s*(?:is|of|level|score|:|=|\s)*\s*(\d+(?:\.\d+)?\s*%?)", re.IGNORECASE)


def read_reply(text: str, finish_reason: str | None = None) -> Guidance:
    """The gate that a reply names.

    `finish_reason` is what the server says of the reply's end; without it, the end of the text must show that the reply
    is whole. Thinking is not read. JSON takes precedence over the sentences around it; of several statements, the last
    clear one counts. The directive is worded as by `write_directive`, without the parts that the reply omits. Raises
    `ReasonerError`.
    """
    plain = answer_of(text.replace("’", "'").replace("“", '"').replace("”", '"'), finish_reason)
    whole = finish_reason is not None
    guidance = _read_json(plain)
    if guidance is not None:
        return guidance
    outside = _OBJECT.sub(" ", plain)
    try:
        described = read_sentences(outside, whole=whole or _ends(outside))
    except ReasonerError as error:
        if error.kind == "garbage" and re.match(r"[\[{]", plain.lstrip("json \n")):
            kind: ReasonerFault = "schema" if plain.endswith(("}", "]")) else "garbage"
            raise ReasonerError(kind, f"the reply is not JSON of size, color and shape: {quote(plain)}") from None
        raise
    if _cut_off(outside, whole=whole):
        raise unfinished(outside, "")
    return _guidance(described, _text_confidence(outside))


def answer_of(text: str, finish_reason: str | None = None, longest: int = MAX_REPLY) -> str:
    """The part of a reply that is its answer, without thinking and markup, of at most `longest` characters.

    Raises `ReasonerError` if there is none, it is too long or a web page, or the server says that it was cut off.
    """
    if finish_reason is not None and finish_reason.lower() not in FINISHED:
        raise unfinished(text, finish_reason)
    if len(text) > LONGEST_THINKING:
        raise ReasonerError("too_long", f"the reply has {len(text)} characters; {LONGEST_THINKING} are read")
    plain = _answer(text)
    if len(plain) > longest:
        raise ReasonerError("too_long", f"the reply has {len(plain)} characters; {longest} are read")
    if not plain:
        raise unfinished(text, "") if text.strip() else ReasonerError("garbage", "the reply is empty")
    if _HTML.search(plain):
        raise ReasonerError("garbage", f"the reply is a web page: {quote(plain)}")
    return plain


def unfinished(text: str, finish_reason: str) -> ReasonerError:
    """The error of a reply that ends before its answer."""
    if finish_reason == "content_filter":
        return ReasonerError("refusal", "the server's content filter ended the reply")
    thinks = len(_OPENING.findall(text)) > len(_CLOSING.findall(text)) or not _answer_part(text)
    what = "the model was still thinking when its reply ended" if thinks else "the reply ended before it was complete"
    if not text.strip():
        what = "the server's response holds the model's thinking, and no answer"
    why = {"length": " at the token limit", "max_tokens": " at the token limit", "stop": "", "": ""}.get(
        finish_reason.lower(), f" (finish_reason {finish_reason[:40]!r})"
    )
    return ReasonerError(
        "unfinished",
        f"{what}{why}: {quote(text)}; allow more with tokens=N, switch thinking off (reasoner vlm: thinking=no), or use"
        " a model that answers without thinking",
    )


def quote(text: str, longest: int = 80) -> str:
    """The start of a reply on one line, for messages."""
    line = " ".join(text.split())
    return repr(line if len(line) <= longest else line[: longest - 3] + "...")


def _answer(text: str) -> str:
    """The part of a reply that is its answer, without thinking and markup; raises `ReasonerError` if it only thinks."""
    plain = _answer_part(text)
    if _OPENING.search(plain):
        raise unfinished(text, "")
    marks = list(_FINAL.finditer(plain))
    if marks:
        plain = plain[marks[-1].end() :]
        plain = plain[: end.start()] if (end := _FINAL_END.search(plain)) else plain
    return re.sub(r"\*+|`+|__|<\|[a-z_]+\|>", "", plain).strip()


def _answer_part(text: str) -> str:
    """What follows the thinking."""
    ends = [match.end() for match in _CLOSING.finditer(text)]
    return text[ends[-1] :].strip() if ends else text.strip()


def _ends(text: str) -> bool:
    """Whether a text ends as a sentence does."""
    return text.rstrip(" \n\"')").endswith((".", "!", "?", "。"))


def _cut_off(text: str, *, whole: bool) -> bool:
    """Whether a text ends within a sentence; a `whole` one, whatever its punctuation, only where a word must follow."""
    last = text.rstrip().rpartition("\n")[2]
    if _ends(last) or re.search(r"[\d%][)\s]*$", last):
        return False
    return bool(_ENDS_OPEN.search(last.rstrip(" \"'"))) or (not whole and bool(re.search(r"[.!?]\s+\S", last)))


def _read_json(text: str) -> Guidance | None:
    """The gate in the last object that has a color or a shape; none if there is no such object."""
    found = [(match, fields) for match in _OBJECT.finditer(text) if (fields := _fields(match.group()))]
    if not found:
        bare = (_fields(text + "\n") or {}) if "{" not in text else {}
        # "color: green, shape: round" needs no braces, but both keys: a line "Color: green" may describe a panel.
        return _read_fields(bare, text) if {"color", "shape"} <= bare.keys() else None
    match, fields = found[-1]
    if len(found) > 1:
        before, other = found[-2]
        if fields != other and not _CORRECTION.search(text, before.end(), match.start()):
            raise ReasonerError("schema", f"the reply lists several gates, one was asked for: {quote(text)}")
    if not match.group().endswith("}") and not {"size", "color", "shape"} <= fields.keys():
        raise unfinished(text, "")
    guidance = _read_fields(fields, text)
    described = describe(guidance.directive)
    after = text[match.end() :]
    if described is not None and (_CONDITION.match(after) or contradicts(after, described)):
        raise ReasonerError("unsure", f"the reply contradicts its own JSON: {quote(text)}")
    return guidance


def _fields(block: str) -> dict[str, str] | None:
    """The complete pairs of an object, by key in lower case; none if there is no color and no shape.

    None also for a form that is not filled in, such as `"size": "big" or "small"`, and for keys with two values.
    """
    fields: dict[str, str] = {}
    for key, value, is_open in _pairs(block):
        name = _KEYS.get(key.lower(), key.lower())
        plain = " ".join(value.lower().split())
        if name in ("size", "color", "shape") and (is_open or fields.get(name, plain) != plain):
            return None
        fields[name] = plain
    return fields if fields.keys() & {"color", "shape"} else None


def _pairs(block: str) -> list[tuple[str, str, bool]]:
    """Key, value, and whether something unexpected follows the value."""
    try:
        pairs = parse_json(block, objects=list) if block.startswith("{") else None
    except ValueError:
        pairs = None
    if pairs is None:
        kinds = ("double", "single", "item", "bare")
        return [
            (match["key"], next(match[kind] for kind in kinds if match[kind] is not None), match["open"] is not None)
            for match in _PAIR.finditer(block)
        ]
    found = []
    for key, value in pairs:
        single = value[0] if isinstance(value, list) and len(value) == 1 else value
        number = isinstance(single, int | float) and not isinstance(single, bool)
        text = single if isinstance(single, str) else str(single) if number else "null" if single is None else None
        found.append((key, "a list" if text is None else text, False))
    return found


def _read_fields(fields: dict[str, str], text: str) -> Guidance:
    known = Description()
    for name in ("size", "color", "shape"):
        value = fields.get(name, "")
        if value in _UNKNOWN:
            continue
        read = describe(value)
        if read is not None and read.unknown_word is not None and name != "size":
            raise ReasonerError("no_such_gate", f"no gate is {read.unknown_word!r}: {quote(text)}")
        part = getattr(read, name) if read is not None else None
        if part is None:
            raise ReasonerError("schema", f"the reply's {name} is {value!r}, which is none that gates have")
        known = replace(known, **{name: part})
    if fields.get("color") == "unknown" or (known.color is None and known.shape is None):
        raise ReasonerError("unsure", f"the model cannot tell which gate is meant: {quote(text)}")
    return replace(_guidance(known, _fraction(fields.get("confidence", ""))), gate=_position(fields.get("gate", "")))


def _position(value: str) -> int | None:
    """A gate's index, 0 to 2, from its number, 1 to 3 from the left; none if the value is not a position."""
    if re.fullmatch(r"[-+]?\d{1,9}", value):
        if value not in ("1", "2", "3"):
            raise ReasonerError("no_such_gate", f"the reply names gate {value}; there are gates 1 to 3")
        return int(value) - 1
    return _POSITIONS.get(value)


def _fraction(value: str) -> float | None:
    """A confidence, 0 to 1, also from a percentage; none if it is neither."""
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{0,9})?)\s*(%?)", value)
    if match is None:
        return None
    number = float(match[1])
    if match[2] or number > 1:
        number /= 100
    return number if number <= 1 else None


def _text_confidence(text: str) -> float | None:
    found = _TEXT_CONFIDENCE.findall(text)
    return _fraction(found[-1]) if found else None


def _guidance(description: Description, confidence: float | None) -> Guidance:
    parts = [part for part in (description.size, description.color, description.shape) if part is not None]
    if confidence is None:
        confidence = CONFIDENCE[len(parts)] * (0.5 if description.hedged else 1.0)
    return Guidance(" ".join(["Fly through the", *parts, "gate"]), None, confidence)
