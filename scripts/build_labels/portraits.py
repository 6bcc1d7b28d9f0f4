"""Layers of the further artists of people, drawn from collections of DiceBear."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from people import Layer
from PIL import Image
from rasterise import rasterise
from sources import sources, unpacked

CANVAS = 128

PACKAGES = {hand: f"npm:@dicebear/{hand}" for hand in ("open-peeps", "toon-head", "personas")}
VIEW = {"open-peeps": 704, "toon-head": 768, "personas": 64}
"""Side of the square on which each collection draws."""
PLACE = {
    "open-peeps": {
        "head": "matrix(.99789 0 0 1 156 62)", "face": "translate(315 248)", "facialHair": "translate(279 400)",
        "accessories": "translate(203 303)",
    },
    "toon-head": {"rearHair": "translate(0 10)"},
    "personas": {
        "eyes": "translate(20 24)", "hair": "translate(2 2)", "body": "translate(11 44)", "mouth": "translate(23 36)",
        "nose": "translate(24 28)", "facialHair": "translate(14 26)",
    },
}  # fmt: skip
"""Where each collection puts its parts."""

Parts = list[tuple[str, str]]
LAYERS: dict[str, dict[str, Parts]] = {
    "open-peeps": {
        "clothes/any": [("base", "default")],
        "hair/short": [("head", "grayShort")], "hair/curly": [("head", "mediumBangs2")],
        "hair/long": [("head", "long")],
        "hair/bob": [("head", "bangs")], "hair/bun": [("head", "grayBun")], "hair/afro": [("head", "afro")],
        "hair/dreadlocks": [("head", "dreads1")], "hair/bald": [("head", "noHair1")],
        "hat/beanie": [("head", "hatBeanie")], "hat/turban": [("head", "turban")], "hat/hijab": [("head", "hijab")],
        "expression/smile": [("face", "smile")], "expression/serious": [("face", "serious")],
        "expression/sad": [("face", "solemn")], "expression/surprised": [("face", "awe")],
        "expression/laughing": [("face", "smileLOL")],
        "beard/full": [("facialHair", "full3")], "beard/moustache": [("facialHair", "moustache5")],
        "glasses/glasses": [("accessories", "glasses3")], "glasses/round": [("accessories", "glasses")],
        "glasses/sunglasses": [("accessories", "sunglasses")], "glasses/eyepatch": [("accessories", "eyepatch")],
    },
    "toon-head": {
        "skin/any": [("body", "body"), ("head", "head")],
        "behind/long": [("rearHair", "longStraight")], "behind/bob": [("rearHair", "neckHigh")],
        "hair/short": [("hair", "sideComed")], "hair/long": [("hair", "sideComed")],
        "hair/bob": [("hair", "sideComed")],
        "hair/bun": [("hair", "bun")],
        "clothes/tshirt": [("clothes", "tShirt")], "clothes/blazer": [("clothes", "openJacket")],
        "beard/full": [("beard", "longBeard")], "beard/moustache": [("beard", "moustacheTwirl")],
        "expression/smile": [("mouth", "smile"), ("eyes", "happy"), ("eyebrows", "neutral")],
        "expression/sad": [("mouth", "sad"), ("eyes", "humble"), ("eyebrows", "sad")],
        "expression/surprised": [("mouth", "agape"), ("eyes", "wide"), ("eyebrows", "raised")],
        "expression/laughing": [("mouth", "laugh"), ("eyes", "bow"), ("eyebrows", "raised")],
        "expression/wink": [("mouth", "smile"), ("eyes", "wink"), ("eyebrows", "happy")],
    },
    "personas": {
        "skin/any": [("base", "default")],
        "glasses/none": [("eyes", "open")], "glasses/glasses": [("eyes", "glasses")],
        "glasses/sunglasses": [("eyes", "sunglasses")],
        "hair/short": [("hair", "shortCombover")], "hair/curly": [("hair", "curly")],
        "hair/long": [("hair", "extraLong")],
        "hair/bob": [("hair", "bobBangs")], "hair/bun": [("hair", "straightBun")],
        "clothes/any": [("body", "squared")],
        "expression/smile": [("mouth", "smile"), ("nose", "mediumRound")],
        "expression/sad": [("mouth", "frown"), ("nose", "mediumRound")],
        "expression/surprised": [("mouth", "surprise"), ("nose", "mediumRound")],
        "expression/laughing": [("mouth", "bigSmile"), ("nose", "mediumRound")],
        "beard/full": [("facialHair", "beardMustache")], "beard/stubble": [("facialHair", "shadow")],
        "beard/moustache": [("facialHair", "walrus")],
    },
}  # fmt: skip
"""Layer to the parts of the collection that it consists of."""


def portraits(work: Path) -> Iterator[tuple[str, Layer]]:
    """Every layer with its artist."""
    modules = work / "portraits" / "node_modules" / "@dicebear"
    modules.mkdir(parents=True, exist_ok=True)
    for package in (*PACKAGES.values(), "npm:@dicebear/core"):
        link = modules / package.rpartition("/")[2]
        if not link.exists():
            link.symlink_to(unpacked(sources()[package], work).resolve())
    command = ["node", "--preserve-symlinks", str(Path(__file__).with_suffix(".mjs")), *PACKAGES]
    done = subprocess.run(command, cwd=work / "portraits", check=True, capture_output=True, text=True)
    fragments: dict[str, dict[str, dict[str, str]]] = json.loads(done.stdout)
    for hand, layers in LAYERS.items():
        for name, parts in layers.items():
            yield hand, _layer(name, hand, _body(hand, name, parts, fragments[hand]))


def _body(hand: str, name: str, parts: Parts, fragments: dict[str, dict[str, str]]) -> str:
    body = ""
    for part, variant in parts:
        place = PLACE[hand].get(part)
        body += f'<g transform="{place}">{fragments[part][variant]}</g>' if place else fragments[part][variant]
    if hand == "open-peeps":
        # The first colour of the base is the skin's, the second the shirt's. Ink is hair or cloth there.
        body = body.replace("COLOR_base", "COLOR_skin", 1)
        if name.startswith("hair/") or name in ("hat/hijab", "beard/full", "beard/moustache"):
            body = body.replace('fill="#000"', 'fill="COLOR_second"')
    elif parts == [("base", "default")]:
        body = body.replace("COLOR_base", "COLOR_skin")
    return re.sub(r"COLOR_(?!skin)\w+", "COLOR_second", body)


def _layer(name: str, hand: str, body: str) -> Layer:
    """What is fixed above; below, how much of the first and of the second colour it takes."""

    def drawn(skin: str, second: str) -> np.ndarray:
        view = VIEW[hand]
        shown = body.replace("COLOR_skin", skin).replace("COLOR_second", second)
        svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {view} {view}" fill="none">{shown}</svg>'
        return np.asarray(rasterise(svg, CANVAS)).astype(np.int16)

    fixed = drawn("#000000", "#000000")
    amounts = np.zeros_like(fixed)
    amounts[..., 0] = (drawn("#ffffff", "#000000") - fixed)[..., :3].max(axis=-1)
    amounts[..., 1] = (drawn("#000000", "#ffffff") - fixed)[..., :3].max(axis=-1)
    amounts[..., 3] = 255
    ink = Image.fromarray(fixed.astype(np.uint8))
    box = ink.getbbox(alpha_only=True)
    if box is None:
        raise ValueError(f"layer {name} of {hand} came out blank")
    both = Image.new("RGBA", (box[2] - box[0], 2 * (box[3] - box[1])))
    both.paste(ink.crop(box), (0, 0))
    both.paste(Image.fromarray(amounts.clip(0, 255).astype(np.uint8)).crop(box), (0, both.height // 2))
    return Layer(name, both, (box[0], box[1]))
