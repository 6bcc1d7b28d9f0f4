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
