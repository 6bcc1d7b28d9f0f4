"""Label references: `kind/concept@style`, the one string by which tasks name what label packs draw.

The concept of a person is `attribute=value` joined by `,`, with the attributes and values listed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cognitivedrone.errors import LabelError

PERSON_ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "skin": ("light", "tan", "brown", "dark"),
    "hair": ("short", "curly", "long", "bob", "bun", "afro", "dreadlocks", "shaved_sides", "bald"),
    "hair_color": ("brown", "black", "blond", "red", "gray", "pink"),
    "hat": ("none", "hat", "beanie", "turban", "hijab"),
    "hat_color": ("red", "blue", "green", "yellow", "black", "white"),
    "glasses": ("none", "glasses", "round", "sunglasses", "eyepatch"),
    "beard": ("none", "full", "stubble", "moustache"),
    "clothes": ("tshirt", "hoodie", "blazer", "overall", "sweater", "vneck"),
    "clothes_color": ("blue", "red", "green", "yellow", "black", "white", "gray", "pink"),
    "expression": ("smile", "serious", "sad", "surprised", "laughing", "wink"),
}
"""Values of each attribute; the first is the default. Beards have the hair's colour."""

_HAIR_COLORS = PERSON_ATTRIBUTES["hair_color"]
_CLOTH_COLORS = PERSON_ATTRIBUTES["clothes_color"]
PERSON_HANDS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "open-peeps": {
        "skin": PERSON_ATTRIBUTES["skin"],
        "hair": ("short", "curly", "long", "bob", "bun", "afro", "dreadlocks", "bald"),
        "hair_color": _HAIR_COLORS,
        "hat": ("none", "beanie", "turban", "hijab"),
        "hat_color": PERSON_ATTRIBUTES["hat_color"],
        "glasses": ("none", "glasses", "round", "sunglasses", "eyepatch"),
        "beard": ("none", "full", "moustache"),
        "clothes_color": _CLOTH_COLORS,
        "expression": ("smile", "serious", "sad", "surprised", "laughing"),
    },
    "toon-head": {
        "skin": PERSON_ATTRIBUTES["skin"],
        "hair": ("short", "long", "bob", "bun", "bald"),
        "hair_color": _HAIR_COLORS,
        "hat": ("none",),
        "glasses": ("none",),
        "beard": ("none", "full", "moustache"),
        "clothes": ("tshirt", "blazer"),
        "clothes_color": _CLOTH_COLORS,
        "expression": ("smile", "sad", "surprised", "laughing", "wink"),
    },
    "personas": {
        "skin": PERSON_ATTRIBUTES["skin"],
        "hair": ("short", "curly", "long", "bob", "bun", "bald"),
        "hair_color": _HAIR_COLORS,
        "hat": ("none",),
        "glasses": ("none", "glasses", "sunglasses"),
        "beard": ("none", "full", "stubble", "moustache"),
        "clothes_color": _CLOTH_COLORS,
        "expression": ("smile", "sad", "surprised", "laughing"),
    },
}
"""Further artists who draw people: the values that each can show. An attribute that is missing cannot be read from
their portraits. The style of such a portrait is `hand-background`, as in `person/hair=long@toon-head-sky`."""


def person_hand(style: str | None) -> str | None:
    """The artist in the style of a person; None for the one who draws all attributes."""
    hand = (style or "").rpartition("-")[0]
    return hand if hand in PERSON_HANDS else None


@dataclass(frozen=True, slots=True)
class Reference:
    """A parsed label reference."""

    kind: str
    concept: str
    style: str | None
    """None means the kind's first style."""

    def __str__(self) -> str:
        return f"{self.kind}/{self.concept}" + (f"@{self.style}" if self.style else "")


def parse_reference(text: str) -> Reference:
    """Parse `kind/concept@style`; the concept may contain further slashes, the style is optional.

    Raises `LabelError` if there is no kind, or an `@` without a style.
    """
    body, at, style = text.rpartition("@") if "@" in text else (text, "", "")
    kind, slash, concept = body.partition("/")
    if not (kind and slash) or (at and not style):
        raise LabelError(f"label {text!r} is not of the form kind/concept@style, such as animal/zebra@noto")
    return Reference(kind, concept, style or None)


def full_person(person: Mapping[str, str]) -> dict[str, str]:
    """All attributes of a person in the schema's order, those left out at their first value."""
    return {name: person.get(name, values[0]) for name, values in PERSON_ATTRIBUTES.items()}
