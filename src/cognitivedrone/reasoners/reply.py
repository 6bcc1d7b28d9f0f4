"""Reads a vision-language model's reply: JSON of the schema, perhaps after thinking, or a directive.

A reply names a gate, or is one of the faults of `ReasonerError`. Nothing is guessed: servers force the schema, what is
neither can be asked for again, and the flight continues well enough without an answer.
"""

from __future__ import annotations

import re
from typing import Any

from cognitivedrone.errors import ReasonerError
from cognitivedrone.tasks.directives import looks_asked, parse_directive
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import Guidance

MAX_REPLY = 4000
"""Maximum length in characters without thinking; a reply of the schema has under 80."""
CONFIDENCE = (0.0, 0.6, 0.8, 1.0)
"""Confidence by the number of parts (size, color, shape) named, for replies that give none of their own."""
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
_OBJECT = re.compile(r"\{[^{}]*\}")
_KEYS = ("size", "color", "shape")
_UNKNOWN = (None, "", "unknown", "none")
_CONDITION = re.compile(r"\b(?:if|unless|or|when|provided|wait|not)\b", re.IGNORECASE)


def read_reply(text: str, finish_reason: str | None = None) -> Guidance:
    """The gate that a reply names, in an object of the schema or in a sentence that names a gate and nothing else.

    `finish_reason` is what the server says of the reply's end. Thinking is not read, nor is what comes before the
    object. The directive is worded as by `write_directive`, without the parts that the reply omits. Raises
    `ReasonerError`.
    """
    plain = answer_of(text, finish_reason)
    found = [(match.end(), fields) for match in _OBJECT.finditer(plain) if (fields := _fields(match.group()))]
    if not found:
        asked = looks_asked(plain) if len(plain.splitlines()) == 1 else None
        if asked is None:
            raise ReasonerError("garbage", f"the reply is not JSON of size, color and shape: {quote(plain)}")
        return _guidance(asked)
    end, fields = found[-1]
    if any(other != fields for _, other in found):
        raise ReasonerError("schema", f"the reply lists several gates, one was asked for: {quote(text)}")
    after = plain[end:]
    if _CONDITION.search(after) or any(parse_directive(after)):
        raise ReasonerError("unsure", f"the reply contradicts its own JSON: {quote(text)}")
    return _read_fields(fields, text)


def answer_of(text: str, finish_reason: str | None = None, longest: int = MAX_REPLY) -> str:
    """The part of a reply that is its answer, without thinking and markup, of at most `longest` characters.

    Raises `ReasonerError` if there is none, it is too long, or the server says that it was cut off.
    """
    if finish_reason is not None and finish_reason.lower() not in FINISHED:
        raise unfinished(text, finish_reason)
    plain = _answer(text)
    if len(plain) > longest:
        raise ReasonerError("too_long", f"the reply has {len(plain)} characters; {longest} are read")
    if not plain:
        raise unfinished(text, "") if text.strip() else ReasonerError("garbage", "the reply is empty")
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


def _fields(block: str) -> dict[str, Any] | None:
    """The pairs of an object by key in lower case; none if it is not JSON, or names neither color nor shape."""
    try:
        found = parse_json(block)
    except ValueError:
        return None
    fields = {key.lower(): value.strip().lower() if isinstance(value, str) else value for key, value in found.items()}
    return fields if fields.keys() & {"color", "shape"} else None


def _read_fields(fields: dict[str, Any], text: str) -> Guidance:
    known = tuple(_part(fields, which) for which in range(3))
    if fields.get("color") == "unknown" or not any(known[1:]):
        raise ReasonerError("unsure", f"the model cannot tell which gate is meant: {quote(text)}")
    gate, confidence = fields.get("gate"), fields.get("confidence")
    if isinstance(gate, int) and gate not in (1, 2, 3):
        raise ReasonerError("no_such_gate", f"the reply names gate {gate}; there are gates 1 to 3")
    is_share = isinstance(confidence, int | float) and 0 <= confidence <= 1
    return _guidance(known, gate - 1 if isinstance(gate, int) else None, confidence if is_share else None)


def _part(fields: dict[str, Any], which: int) -> str | None:
    """A size, a color or a shape in the words of directives; none if the reply leaves it open."""
    value = fields.get(_KEYS[which])
    if value in _UNKNOWN:
        return None
    looks = looks_asked(f"{value} gate")
    if looks is None or [part is not None for part in looks] != [kind == which for kind in range(3)]:
        raise ReasonerError("schema", f"the reply's {_KEYS[which]} is {value!r}, which is none that gates have")
    return looks[which]


def _guidance(parts: tuple[str | None, ...], gate: int | None = None, confidence: float | None = None) -> Guidance:
    named = [part for part in parts if part is not None]
    sure = CONFIDENCE[len(named)] if confidence is None else float(confidence)
    return Guidance(" ".join(["Fly through the", *named, "gate"]), gate, sure)
