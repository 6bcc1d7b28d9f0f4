"""Layers of drawn people: every part of the Avataaars set that the pack uses, alone on one common canvas."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from rasterise import rasterise

CANVAS = 256
"""Side of a person's panel, px; the set draws on a square of 280 units."""

# Colours are the set's own where it has them, or a little further apart, so that they differ on a panel 40 px wide.
SKIN = {"light": "#ffdbb4", "tan": "#dfa46c", "brown": "#a8622f", "dark": "#5c3527"}
HAIR_COLOR = {
    "brown": "#7d4a2d", "black": "#1f1a1a", "blond": "#eac35f", "red": "#cf4a1c", "gray": "#aab1b8", "pink": "#f27fb2",
}  # fmt: skip
CLOTH_COLOR = {
    "blue": "#2f6fe0", "red": "#d62839", "green": "#2e9e4f", "yellow": "#f6c90e", "black": "#23272b",
    "white": "#e9ebef", "gray": "#929598", "pink": "#ff7eb0",
}  # fmt: skip
HAT_COLOR = {name: CLOTH_COLOR[name] for name in ("red", "blue", "green", "yellow", "black", "white")}

HAIR = {
    "short": "shortFlat", "curly": "curly", "long": "straight01", "bob": "miaWallace", "bun": "bun", "afro": "fro",
    "dreadlocks": "dreads", "shaved_sides": "shavedSides",
}  # fmt: skip
HAT = {"hat": "hat", "beanie": "winterHat03", "turban": "turban", "hijab": "hijab"}
BEARD = {"full": "beardMajestic", "stubble": "beardLight", "moustache": "moustacheMagnum"}
STUBBLE_OPACITY = 0.4
CLOTHES = {
    "tshirt": "shirtCrewNeck", "hoodie": "hoodie", "blazer": "blazerAndShirt", "overall": "overall",
    "sweater": "collarAndSweater", "vneck": "shirtVNeck",
}  # fmt: skip
GLASSES = {"glasses": "prescription02", "round": "round", "sunglasses": "wayfarers", "eyepatch": "eyepatch"}
EXPRESSION = {  # mouth, eyes, eyebrows
    "smile": ("twinkle", "default", "default"),
    "serious": ("serious", "default", "flatNatural"),
    "sad": ("sad", "default", "sadConcernedNatural"),
    "surprised": ("disbelief", "surprised", "raisedExcited"),
    "laughing": ("smile", "happy", "raisedExcited"),
    "wink": ("tongue", "wink", "upDown"),
}

PLACE = {
    "base": "0 0", "clothing": "0 170", "mouth": "78 134", "nose": "104 122", "eyes": "76 90", "eyebrows": "76 82",
    "top": "-1 0", "facialHair": "49 72", "accessories": "62 42",
}  # fmt: skip
"""Where the set puts each part on its canvas."""


@dataclass(frozen=True)
class Layer:
    """A part of a person, cut to what is drawn."""

    name: str
    """part/value or part/value-color"""
    image: Image.Image
    offset: tuple[int, int]
    """Of its upper left corner on the canvas, px."""


def layers(node_folder: Path) -> list[Layer]:
    """Every layer, in the order of the tables above."""
    script = Path(__file__).with_name("people.mjs")
    done = subprocess.run(["node", str(script)], cwd=node_folder, check=True, capture_output=True, text=True)
    fragments: dict[str, dict[str, str]] = json.loads(done.stdout)

    def layer(name: str, parts: dict[str, str], opacity: float = 1.0, **colors: str) -> Layer:
        body = "".join(
            f'<g transform="translate({PLACE[part]})">{fragments[part][variant]}</g>' for part, variant in parts.items()
        )
        body = re.sub(r"COLOR_(\w+)", lambda match: colors.get(match[1], "#262e33"), body)
        svg = (
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 280 280" fill="none">'
            f'<g transform="translate(8)" opacity="{opacity}">{body}</g></svg>'
        )
        image = rasterise(svg, CANVAS)
        box = image.getbbox(alpha_only=True)
        if box is None:
            raise ValueError(f"layer {name} came out blank")
        return Layer(name, image.crop(box), (box[0], box[1]))

    found = [layer(f"skin/{name}", {"base": "default"}, skin=color) for name, color in SKIN.items()]
    for name, variant in CLOTHES.items():
        for color, code in CLOTH_COLOR.items():
            found.append(layer(f"clothes/{name}-{color}", {"clothing": variant}, clothes=code))
    for name, (mouth, eyes, eyebrows) in EXPRESSION.items():
        parts = {"mouth": mouth, "nose": "default", "eyes": eyes, "eyebrows": eyebrows}
        found.append(layer(f"expression/{name}", parts))
    for name, variant in HAIR.items():
        for color, code in HAIR_COLOR.items():
            found.append(layer(f"hair/{name}-{color}", {"top": variant}, hair=code))
    for name, variant in HAT.items():
        for color, code in HAT_COLOR.items():
            found.append(layer(f"hat/{name}-{color}", {"top": variant}, hat=code))
    for name, variant in BEARD.items():
        opacity = STUBBLE_OPACITY if name == "stubble" else 1.0
        for color, code in HAIR_COLOR.items():
            found.append(layer(f"beard/{name}-{color}", {"facialHair": variant}, opacity, facialHair=code))
    for name, variant in GLASSES.items():
        found.append(layer(f"glasses/{name}", {"accessories": variant}))
    return found
