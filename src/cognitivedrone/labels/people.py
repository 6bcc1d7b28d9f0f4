"""Drawn people: image layers for the attributes of a reference, painted from back to front.

People by further artists: few layers, which take any colour when they are drawn.

A layer is an image of two halves. The upper half is what has a fixed colour. The lower half says how much of the first
colour (red channel) and of the second colour (green channel) is added to it. The first colour is the skin's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageChops, ImageColor, ImageDraw

from cognitivedrone.errors import LabelError, did_you_mean
from cognitivedrone.references import PERSON_ATTRIBUTES, PERSON_HANDS, full_person

SIDE = 256
"""Side of a panel, px."""

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
    """All attributes of a person given as `attribute=value,attribute=value`; left-out ones at their first value.

    Raises `LabelError` with near names for an attribute or a value that is not in `PERSON_ATTRIBUTES`.
    """
    chosen: dict[str, str] = {}
    for item in filter(None, concept.split(",")):
        attribute, equals, value = item.partition("=")
        if not equals:
            raise LabelError(f"label 'person/{concept}': {item!r} is not of the form attribute=value")
        if attribute not in PERSON_ATTRIBUTES:
            hint = did_you_mean(attribute, PERSON_ATTRIBUTES)
            raise LabelError(f"label 'person/{concept}': people have no attribute {attribute!r}; {hint}")
        if value not in PERSON_ATTRIBUTES[attribute]:
            hint = did_you_mean(value, PERSON_ATTRIBUTES[attribute])
            raise LabelError(f"label 'person/{concept}': {attribute} cannot be {value!r}; {hint}")
        if attribute in chosen:
            raise LabelError(f"label 'person/{concept}' gives {attribute} twice")
        chosen[attribute] = value
    return full_person(chosen)


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


CANVAS = 128
"""Side of the canvas of a portrait's layers, px."""

Colors = Mapping[str, Mapping[str, str]]
"""Attribute to value to colour, "#rrggbb"."""


def layers_of(hand: str, person: Mapping[str, str]) -> list[tuple[str, str]]:
    """Layers of a person from back to front, each with the attribute that gives its second colour ("" for none)."""
    covering = "hair" if person["hat"] == "none" else "hat"
    hair = (f"{covering}/{person[covering]}", f"{covering}_color")
    beard = [("beard/" + person["beard"], "hair_color")] if person["beard"] != "none" else []
    glasses = [("glasses/" + person["glasses"], "")] if person["glasses"] != "none" else []
    face = ("expression/" + person["expression"], "hair_color")
    body = ("clothes/" + person["clothes"] if "clothes" in PERSON_HANDS[hand] else "clothes/any", "clothes_color")
    if hand == "open-peeps":
        return [body, hair, face, *beard, *glasses]
    if hand == "toon-head":
        behind = [("behind/" + person["hair"], "hair_color")] if person["hair"] in ("long", "bob") else []
        return [*behind, ("skin/any", ""), body, face, *beard, *([] if person["hair"] == "bald" else [hair])]
    eyes = ("glasses/" + person["glasses"], "")
    return [("skin/any", ""), eyes, *([] if person["hair"] == "bald" else [hair]), body, face, *beard]


def draw_portrait(concept: str, hand: str, background: str, layer: LayerSource, colors: Colors) -> Image.Image:
    """(SIDE, SIDE) RGB portrait by an artist of `PERSON_HANDS`.

    Raises `LabelError` like `parse_person`, and for a value that this artist does not draw.
    """
    person = parse_person(concept)
    for attribute, values in PERSON_HANDS[hand].items():
        if person[attribute] not in values and not (attribute == "hat_color" and person["hat"] == "none"):
            hint = did_you_mean(person[attribute], values)
            raise LabelError(
                f"label 'person/{concept}': the artist {hand} draws no {attribute} {person[attribute]!r}; {hint}"
            )
    skin = ImageColor.getrgb(colors["skin"][person["skin"]])
    image = Image.new("RGBA", (CANVAS, CANVAS), (*BACKGROUNDS[background], 255))
    for name, attribute in layers_of(hand, person):
        part, corner = layer(name)
        second = ImageColor.getrgb(colors[attribute][person[attribute]]) if attribute else (0, 0, 0)
        image.alpha_composite(_colored(part, skin, second), corner)
    return image.convert("RGB").resize((SIDE, SIDE), Image.Resampling.BICUBIC)


def _colored(layer: Image.Image, first: tuple[int, ...], second: tuple[int, ...]) -> Image.Image:
    pixels: NDArray[np.uint8] = np.asarray(layer)
    half = len(pixels) // 2
    fixed, amounts = pixels[:half].astype(np.float32), pixels[half:, :, :2].astype(np.float32) / 255
    fixed[..., :3] += amounts @ np.array([first, second], dtype=np.float32)
    return Image.fromarray(np.clip(fixed.round(), 0, 255).astype(np.uint8))
