"""Drawn people: image layers for the attributes of a reference, painted from back to front."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

from PIL import Image, ImageChops, ImageDraw

from cognitivedrone.errors import LabelError, did_you_mean

SIDE = 256
"""Side of a panel, px."""

ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
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

BACKGROUNDS: Mapping[str, tuple[int, int, int]] = {
    "white": (255, 255, 255),
    "sky": (176, 217, 255),
    "sand": (240, 216, 168),
    "mint": (182, 236, 205),
    "rose": (252, 200, 208),
    "lilac": (214, 198, 246),
    "slate": (142, 155, 174),
    "cream": (255, 243, 196),
}
"""Background colours, which are the styles of a person; the first is the default."""

_HAT_BRIM = {"hat": 88, "beanie": 66, "turban": 80, "hijab": SIDE}
"""Row of the panel above which a hat hides the hair, px."""
_DOME = (30, 60, 228, 258)
"""Left, top, right, bottom of the circle that limits the hair under a hat above its middle, px."""
_SHOULDERS = 185
"""Row of the panel below which hair is not limited, px."""

LayerSource = Callable[[str], tuple[Image.Image, tuple[int, int]]]
"""From the name of a layer to its RGBA image and the position of its upper left corner, px."""


def parse_person(concept: str) -> dict[str, str]:
    """All attributes of a person given as `attribute=value,attribute=value`; omitted ones have their first value.

    Raises `LabelError` with similar names for an attribute or a value that is not in `ATTRIBUTES`.
    """
    chosen: dict[str, str] = {}
    for item in filter(None, concept.split(",")):
        attribute, equals, value = item.partition("=")
        if not equals:
            raise LabelError(f"label 'person/{concept}': {item!r} is not of the form attribute=value")
        if attribute not in ATTRIBUTES:
            hint = did_you_mean(attribute, ATTRIBUTES)
            raise LabelError(f"label 'person/{concept}': people have no attribute {attribute!r}; {hint}")
        if value not in ATTRIBUTES[attribute]:
            hint = did_you_mean(value, ATTRIBUTES[attribute])
            raise LabelError(f"label 'person/{concept}': {attribute} cannot be {value!r}; {hint}")
        if attribute in chosen:
            raise LabelError(f"label 'person/{concept}' gives {attribute} twice")
        chosen[attribute] = value
    return {attribute: chosen.get(attribute, values[0]) for attribute, values in ATTRIBUTES.items()}


def layer_names(person: Mapping[str, str]) -> list[str]:
    """The layers of a person with all attributes, from the back to the front."""
    hair_color = person["hair_color"]
    return [
        f"skin/{person['skin']}",
        f"clothes/{person['clothes']}-{person['clothes_color']}",
        f"expression/{person['expression']}",
        *([f"hair/{person['hair']}-{hair_color}"] if person["hair"] != "bald" else []),
        *([f"beard/{person['beard']}-{hair_color}"] if person["beard"] != "none" else []),
        *([f"glasses/{person['glasses']}"] if person["glasses"] != "none" else []),
        *([f"hat/{person['hat']}-{person['hat_color']}"] if person["hat"] != "none" else []),
    ]


def draw_person(concept: str, background: str, layer: LayerSource) -> Image.Image:
    """(SIDE, SIDE) RGB portrait. Raises `LabelError` like `parse_person`; `background` is one of BACKGROUNDS."""
    person = parse_person(concept)
    image = Image.new("RGBA", (SIDE, SIDE), (*BACKGROUNDS[background], 255))
    for name in layer_names(person):
        part, (x, y) = layer(name)
        if name.startswith("hair/") and person["hat"] != "none":
            room = _room_for_hair(person["hat"]).crop((x, y, x + part.width, y + part.height))
            part = part.copy()
            part.putalpha(ImageChops.multiply(part.getchannel("A"), room))
        image.alpha_composite(part, (x, y))
    return image.convert("RGB")


@cache
def _room_for_hair(hat: str) -> Image.Image:
    """(SIDE, SIDE) mask of the area for hair under a hat: below the brim, limited to a dome at the sides."""
    scale = 4
    mask = Image.new("L", (SIDE * scale, SIDE * scale))
    draw = ImageDraw.Draw(mask)
    left, top, right, bottom = (scale * edge for edge in _DOME)
    draw.ellipse((left, top, right, bottom), fill=255)
    draw.rectangle((left, (top + bottom) // 2, right, SIDE * scale), fill=255)
    draw.rectangle((0, scale * _SHOULDERS, SIDE * scale, SIDE * scale), fill=255)
    draw.rectangle((0, 0, SIDE * scale, scale * _HAT_BRIM[hat] - 1), fill=0)
    return mask.resize((SIDE, SIDE), Image.Resampling.BOX)
