"""Make the shipped places from the package of panoramas that they come from. Run by hand; needs OpenEXR and NumPy.

Usage: python scripts/build_places.py PACKAGE

PACKAGE is the unpacked npm package @pmndrs/assets 1.7.0, whose panoramas (CC0, from Poly Haven) are EXR pictures of 512
x 256 pixels in base64. Each becomes a JPEG of the same size in src/cognitivedrone/world/panoramas.

Which places are kept for tests was settled before any was looked at: forest and warehouse, in which a pilot that knew
no places had been measured, and of the others the four whose names have the smallest SHA-256.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

OUT = Path(__file__).resolve().parent.parent / "src/cognitivedrone/world/panoramas"
KEPT_FIRST = ("forest", "warehouse")
QUALITY = 90
_HOLE = 4  # pixels around one that are looked at
_BRIGHT = 4.0


def radiance(content: bytes) -> np.ndarray:
    """Linear RGB (h, w, 3) float32, mended where it is brightest.

    Half floats hold no value of the sun: there are infinities, or black holes of up to 6 pixels. Both become as bright
    as what is around them.
    """
    with tempfile.NamedTemporaryFile(suffix=".exr") as file:
        file.write(content)
        file.flush()
        channels = OpenEXR.File(file.name).channels()
        found = channels["RGB"].pixels if "RGB" in channels else np.stack([channels[c].pixels for c in "RGB"], axis=-1)
    pixels = np.asarray(found, np.float32)
    finite = np.isfinite(pixels)
    pixels = np.where(finite, np.maximum(pixels, 0.0), pixels[finite].max())
    padded = np.pad(pixels, ((_HOLE, _HOLE), (0, 0), (0, 0)), mode="edge")
    shifted = (
        np.roll(padded[_HOLE + up : len(padded) - _HOLE + up], right, axis=1)
        for up in range(-_HOLE, _HOLE + 1)
        for right in range(-_HOLE, _HOLE + 1)
    )
    around = functools.reduce(np.maximum, shifted)
    return np.where((pixels < 1e-3) & (around > _BRIGHT), around, pixels)


def developed(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB: the geometric mean of the luminance at middle grey, highlights compressed (Reinhard et al. 2002)."""
    luminance = linear @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    mean = float(np.exp(np.mean(np.log(luminance + 1e-4))))
    scaled = 0.22 / mean * linear
    white = 0.22 / mean * float(np.percentile(luminance, 98.0))
    squeezed = scaled * (1 + scaled / max(white, 1.0) ** 2) / (1 + scaled)
    curve = np.where(squeezed <= 0.0031308, 12.92 * squeezed, 1.055 * np.maximum(squeezed, 1e-9) ** (1 / 2.4) - 0.055)
    return np.clip(np.round(255 * curve), 0, 255).astype(np.uint8)


def main() -> None:
    package = Path(sys.argv[1])
    names = sorted(path.name.partition(".")[0] for path in (package / "hdri").glob("*.exr.js"))
    others = sorted(set(names) - set(KEPT_FIRST), key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    kept = {*KEPT_FIRST, *others[:4]}
    OUT.mkdir(exist_ok=True)
    for name in names:
        text = (package / "hdri" / f"{name}.exr.js").read_text()
        content = base64.b64decode(text.partition("base64,")[2].partition("'")[0])
        Image.fromarray(developed(radiance(content))).save(OUT / f"{name}.jpg", quality=QUALITY, optimize=True)
    table = {
        "source": "npm package @pmndrs/assets 1.7.0, hdri/*.exr.js; panoramas of Poly Haven",
        "licence": "CC0-1.0",
        "training": [name for name in names if name not in kept],
        "kept": [name for name in names if name in kept],
    }
    (OUT / "manifest.json").write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    main()
