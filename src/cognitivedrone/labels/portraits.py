"""People by further artists: few layers, which take any colour when they are drawn.

A layer is an image of two halves. The upper half is what has a fixed colour. The lower half says how much of the first
colour (red channel) and of the second colour (green channel) is added to it. The first colour is the skin's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cognitivedrone.errors import LabelError, did_you_mean
from cognitivedrone.labels.people import BACKGROUNDS, SIDE, parse_person
from cognitivedrone.references import PERSON_HANDS

CANVAS = 128
"""Side of the canvas of a portrait's layers, px."""

Colors = Mapping[str, Mapping[str, str]]
"""Attribute to value to colour, "#rrggbb"."""
LayerSource = Callable[[str], tuple[Image.Image, tuple[int, int]]]
"""From the name of a layer, without its artist, to its RGBA image and its upper left corner on the canvas, px."""


def layers_of(hand: str, person: Mapping[str, str]) -> list[tuple[str, str]]:
    """Layers of a person from back to front, each with the attribute that gives its second colour ("" for none)."""
    covered = person["hat"] != "none"
    hair = ("hair/" + person["hair"], "hair_color")
    if covered:
        hair = ("hat/" + person["hat"], "hat_color")
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
    skin = _rgb(colors["skin"][person["skin"]])
    image = Image.new("RGBA", (CANVAS, CANVAS), (*BACKGROUNDS[background], 255))
    for name, attribute in layers_of(hand, person):
        part, corner = layer(name)
        second = _rgb(colors[attribute][person[attribute]]) if attribute else (0, 0, 0)
        image.alpha_composite(_colored(part, skin, second), corner)
    return image.convert("RGB").resize((SIDE, SIDE), Image.Resampling.BICUBIC)


def _colored(layer: Image.Image, first: tuple[int, ...], second: tuple[int, ...]) -> Image.Image:
    pixels: NDArray[np.uint8] = np.asarray(layer)
    half = len(pixels) // 2
    fixed, amounts = pixels[:half].astype(np.float32), pixels[half:, :, :2].astype(np.float32) / 255
    fixed[..., :3] += amounts @ np.array([first, second], dtype=np.float32)
    return Image.fromarray(np.clip(fixed.round(), 0, 255).astype(np.uint8))


def _rgb(code: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(code.removeprefix("#")))
