"""Parses a vision-language model's reply: JSON, something like JSON, or sentences about a gate.

Pure text processing. A reply names a gate, or is one of the faults of `ReasonerError`. Nothing is guessed: the flight
continues well enough without an answer.
"""

from __future__ import annotations

import re
from dataclasses import replace

from cognitivedrone.errors import ReasonerError, ReasonerFault
from cognitivedrone.reasoners.sentences import Description, describe, read_sentences
from cognitivedrone.types import Guidance

MAX_REPLY = 4000
"""Maximum length in characters; a reply of the schema has under 80, a long chain of thought some 2000."""
CONFIDENCE = (0.0, 0.6, 0.8, 1.0)
"""Confidence by the number of parts (size, color, shape) named, for replies that give none of their own."""

_PAIR = re.compile(
    r"""["']?(?P<key>[A-Za-z_]\w*)["']?\s*:\s*
        (?: "(?P<double>[^"\n]*)" | '(?P<single>[^'\n]*)' | (?P<bare>[-+\w.%]+(?:[ ]\w+)*)\s*(?=[,}\n]) )""",
    re.VERBOSE,
)
_OBJECT = re.compile(r"\{[^{}]*(?:\}|$)")
_SIBLINGS = re.compile(r"""\s*,\s*(?:["']?\w+["']?\s*:\s*)?""")
_KEYS = {"colour": "color", "position": "gate", "index": "gate", "gate_color": "color", "gate_shape": "shape"}
_UNKNOWN = {"", "unknown", "none", "null", "unsure", "unclear", "n/a", "na", "cannot tell", "uncertain", "not sure"}
_POSITIONS = {"left": 0, "middle": 1, "center": 1, "centre": 1, "right": 2}
_HTML = re.compile(r"<\s*(?:!doctype|html|head|body|div|script|title)\b", re.IGNORECASE)
_TEXT_CONFIDENCE = re.compile(r"confiden\w*\s*(?:is|of|level|score|:|=|\s)*\s*(\d+(?:\.\d+)?\s*%?)", re.IGNORECASE)


def read_reply(text: str) -> Guidance:
    """The gate that a reply names.

    JSON takes precedence over the sentences around it; of several statements, the last clear one counts. The directive
    is worded as by `write_directive`, without the parts that the reply omits. Raises `ReasonerError`.
    """
    if len(text) > MAX_REPLY:
        raise ReasonerError("too_long", f"the reply has {len(text)} characters; {MAX_REPLY} are read")
    plain = text.replace("’", "'").replace("“", '"').replace("”", '"').rpartition("</think>")[2].strip()
    if not plain:
        raise ReasonerError("garbage", "the reply is empty")
    if _HTML.search(plain):
        raise ReasonerError("garbage", f"the reply is a web page: {quote(plain)}")
    guidance = _read_json(plain)
    if guidance is not None:
        return guidance
    outside = _OBJECT.sub(" ", plain)
    try:
        return _guidance(read_sentences(outside), _text_confidence(outside))
    except ReasonerError as error:
        if error.kind == "garbage" and re.match(r"[\[{]", plain.lstrip("`json \n")):
            kind: ReasonerFault = "schema" if plain.rstrip("` \n").endswith(("}", "]")) else "garbage"
            raise ReasonerError(kind, f"the reply is not JSON of size, color and shape: {quote(plain)}") from None
        raise


def quote(text: str) -> str:
    """The start of a reply on one line, for messages."""
    line = " ".join(text.split())
    return repr(line if len(line) <= 80 else line[:77] + "...")


def _read_json(text: str) -> Guidance | None:
    """The gate in the last object that has a color or a shape; none if there is no such object."""
    found = [(match, fields) for match in _OBJECT.finditer(text) if (fields := _fields(match.group()))]
    if not found:
        bare = _fields(text + "\n") or {}
        # "color: green, shape: round" needs no braces, but both keys: a line "Color: green" may describe a panel.
        return _read_fields(bare, text) if "{" not in text and {"color", "shape"} <= bare.keys() else None
    match, fields = found[-1]
    if len(found) > 1:
        before, other = found[-2]
        if fields != other and _SIBLINGS.fullmatch(text[before.end() : match.start()]):
            raise ReasonerError("schema", f"the reply lists several gates, one was asked for: {quote(text)}")
    return _read_fields(fields, text)


def _fields(block: str) -> dict[str, str] | None:
    """The complete pairs of an object, by key in lower case; none if there is no color and no shape."""
    fields: dict[str, str] = {}
    for match in _PAIR.finditer(block):
        key = match["key"].lower()
        value = next(v for v in (match["double"], match["single"], match["bare"]) if v is not None)
        fields[_KEYS.get(key, key)] = " ".join(value.lower().split())
    return fields if fields.keys() & {"color", "shape"} else None


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
