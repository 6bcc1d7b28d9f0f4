"""Directives: the plain sentence that names a gate by size, colour and shape."""

from __future__ import annotations

import re
from collections.abc import Sequence

from cognitivedrone.types import Color, Gate, Shape, Size

_SIZES: dict[str, Size] = {
    **dict.fromkeys(("big", "large", "bigger", "larger", "biggest", "largest"), "big"),
    **dict.fromkeys(("small", "little", "smaller", "smallest", "tiny"), "small"),
}
_SHAPES: dict[str, Shape] = {
    **dict.fromkeys(("round", "circle", "circular", "ring"), "round"),
    **dict.fromkeys(("square", "rectangle", "rectangular", "quadratic"), "square"),
    **dict.fromkeys(("triangle", "triangular"), "triangle"),
}
_COLORS: dict[str, Color] = {"red": "red", "green": "green", "blue": "blue"}


_LOOKS = (
    _SIZES.keys() - {"bigger", "larger", "biggest", "largest", "smaller", "smallest"},
    _COLORS.keys(),
    _SHAPES.keys() - {"ring"},
)
"""Words that name a size, a colour or a shape, and nothing that a panel may show."""
_AROUND = frozenset(
    re.findall(
        r"\w+",
        "fly go head pass move steer navigate aim take cross enter find please now drone i want you to would like could"
        " can through via at for towards toward into the a an and that this which is coloured colored shaped request"
        " transit gate portal hoop",
    )
)
"""Words of a directive that say nothing of the gate."""
_ENDS = frozenset(("gate", "gates", "portal", "portals", "hoop", "hoops", "with"))
HOLD = "Hold position"
"""The directive that declines: no gate matches the instruction, so none is to be flown through."""


def declines(directive: str) -> bool:
    """Whether a directive is `HOLD`, or to land, in any case and with any punctuation: through no gate."""
    return re.findall(r"[a-z]+", directive.lower()) in (["hold", "position"], ["land", "on", "the", "pad"])


def write_directive(gate: Gate) -> str:
    """The canonical directive, "Fly through the small red round gate"."""
    return f"Fly through the {gate.size} {gate.color} {gate.shape} gate"


def parse_directive(text: str) -> tuple[Size | None, Color | None, Shape | None]:
    """Size, colour and shape of the gate that a sentence names, in any order; None for what it does not say.

    Only words before the first "gate" or "with" count, because later words describe the panel ("... gate with a red
    hat"). Among several words of one kind the last wins. Published directives, such as "Fly through the big triangle
    red gate with 9", are parsed as well.
    """
    words = re.findall(r"[a-z]+", text.lower())
    stop = next((i for i, word in enumerate(words) if word in _ENDS), len(words))
    size: Size | None = None
    color: Color | None = None
    shape: Shape | None = None
    for word in words[:stop]:
        size = _SIZES.get(word, size)
        color = _COLORS.get(word, color)
        shape = _SHAPES.get(word, shape)
    return size, color, shape


def looks_asked(text: str) -> tuple[Size | None, Color | None, Shape | None] | None:
    """Size, colour and shape of the gate that a sentence asks for, if it says nothing else; None for any other.

    Words that compare ("the smaller gate") and sentences with several colours, shapes or sizes are others.
    """
    said = re.findall(r"[^\W_]+", re.sub(r"\Wover\W*$", "", text.lower()))  # as said on the radio
    words = [word for word in said if word not in _AROUND]
    found = [next((kind for kind, known in enumerate(_LOOKS) if word in known), None) for word in words]
    if not words or {"gate", "portal", "hoop"}.isdisjoint(said) or None in found or len({*found}) < len(found):
        return None
    return parse_directive(" ".join(words))


def fitting_gate(text: str, gates: Sequence[Gate]) -> int | None:
    """Index of the only gate that a directive fits; None if it fits none or several, or does not describe a gate."""
    asked = parse_directive(text)
    looks = [(gate.size, gate.color, gate.shape) for gate in gates]
    fits = [all(mine in (None, its) for mine, its in zip(asked, look, strict=True)) for look in looks]
    return fits.index(True) if any(asked) and sum(fits) == 1 else None
