"""A picture file of any depth, transparency, orientation and colour space as 8-bit RGB, as people see it in a viewer.

| of the file | what is read |
|---|---|
| 16 bits of grey | all levels, scaled to 8 bits: 65535 becomes 255 |
| transparency: alpha, a palette's, or one transparent colour | laid on white |
| orientation in EXIF or XMP | turned and mirrored upright |
| colour space: ICC profile, gamma of PNG, CMYK, Lab | sRGB; what is sRGB within two levels stays as it is |
| animation, several pictures | the first one |
| other metadata | ignored |

Pixels whose white is unknown (floating point) are refused.

What a file is by its first bytes, whatever its name says, and what to do with a picture that is not read.

Limits of pictures from outside, and the look at a picture's size before it is decoded.

A few kilobytes can hold a picture that fills the memory. Whatever reads pictures of others uses these limits.
"""

from __future__ import annotations

import re
import warnings
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import ExifTags, Image, UnidentifiedImageError, features

from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.text.printable import visible

MAX_PIXELS: Final = 40_000_000
"""Of a photograph, and of a camera's frame."""
MAX_PICTURE_BYTES: Final = 128 * 2**20
"""Of a photograph's file; one without compression has three bytes per pixel."""
MAX_SIDE: Final = 2048
"""Maximum side of a frame in a data set, pixels; ours have 256."""
MAX_FRAME_BYTES: Final = 32 * 2**20
"""Of an encoded frame in a data set."""


def open_picture(
    content: bytes, formats: tuple[str, ...], *, max_pixels: int = MAX_PIXELS, max_side: int | None = None
) -> Image.Image:
    """An encoded picture, opened but not decoded, whose size is within the limits.

    Raises `ValueError` for one that is too large, and Pillow's many errors for what is no picture of these formats.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of odd metadata, and of sizes, for which the limits below are stricter
        try:
            picture = Image.open(BytesIO(content), formats=formats)
        except Image.DecompressionBombError as error:
            raise ValueError(f"{error}; {_limit(max_pixels, max_side)}") from None
    if picture.width * picture.height > max_pixels or (max_side is not None and max(picture.size) > max_side):
        raise ValueError(f"it has {picture.width} x {picture.height} pixels; {_limit(max_pixels, max_side)}")
    return picture


def _limit(max_pixels: int, max_side: int | None) -> str:
    if max_side is not None:
        return f"a frame has at most {max_side} pixels a side"
    return f"at most {max_pixels / 1e6:.0f} million are read"


OTHER_SUFFIXES: Final = (
    ".avif", ".gif", ".heic", ".heif", ".ico", ".jfif", ".jp2", ".jxl", ".psd", ".svg", ".tif", ".tiff",
)  # fmt: skip
"""Of picture files that are not read."""
_READ: Final = re.compile(rb"\x89PNG\r\n\x1a\n|\xff\xd8\xff|RIFF....WEBP|BM", re.DOTALL)
_SAVE: Final = "save it as PNG or JPEG"
_HEIC: Final = f"{_SAVE}; an iPhone takes JPEG with Settings > Camera > Formats > Most Compatible"
_VECTORS: Final = "export it as PNG, 256 or more pixels wide"
_PAGE: Final = "open its address in a browser and save the picture itself"
_KINDS: Final[tuple[tuple[bytes, str, str], ...]] = (
    (rb"GIF8[79]a", "a GIF picture", _SAVE),
    (rb"II\x2a\0........CR|....ftypcrx |FUJIFILM|IIU\0|IIRO", "the raw picture of a camera", _SAVE),
    (rb"II\x2a\0|MM\0\x2a|II\x2b\0|MM\0\x2b", "a TIFF picture, or the raw picture of a camera", _SAVE),
    (rb"8BPS", "a Photoshop picture", _SAVE),
    (rb"\xff\x0a|\0\0\0\x0cJXL ", "a JPEG XL picture", _SAVE),
    (rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51", "a JPEG 2000 picture", _SAVE),
    (rb"\0\0[\x01\x02]\0", "a Windows icon", _SAVE),
    (rb"P[1-7]\s", "a PNM picture", _SAVE),
    (rb"\x76\x2f\x31\x01|#\?R", "a picture of high dynamic range", _SAVE),
    (rb"qoif|DDS |gimp xcf", "a picture of another kind", _SAVE),
    (rb"%!PS|\xc5\xd0\xd3\xc6|%PDF", "a PDF or PostScript document", _VECTORS),
    (rb"\x1f\x8b", "a compressed file (gzip)", "unpack it"),
    (rb"PK\x03\x04|7z\xbc\xaf|Rar!", "an archive", "unpack it"),
    (rb"RIFF....AVI |\x1a\x45\xdf\xa3|....ftyp|....moov", "a video", "save one frame of it as PNG or JPEG"),
    (rb"\0\x05\x16\x07", "a Mac's notes about another file", "remove it"),
    (rb"version https://git-lfs", "a pointer of Git LFS, not the picture", "run `git lfs pull`"),
)
_FTYP: Final = 4, 8
_HTML: Final = re.compile(rb"<(!doctype html|html|head|body|script|meta|title)\b", re.IGNORECASE)
_SHOWN: Final = 40


def what_else(content: bytes) -> tuple[str, str] | None:
    """What a file is and what to do, in words; none for one that begins as a PNG, JPEG, WebP or BMP picture."""
    if _READ.match(content):
        return None
    if not content:
        return "it is empty", "copy or download it again"
    if not content.strip(b"\0"):
        return "it holds nothing but zeros", "copy or download it again"
    if content[slice(*_FTYP)] == b"ftyp":
        brands = content[8 : max(16, min(int.from_bytes(content[:4], "big"), 128))]
        if b"avif" in brands or b"avis" in brands:
            return "it is an AVIF picture", _SAVE
        if re.search(rb"hei[cxms]|hev[cxms]|mif1|msf1", brands):
            return "it is a HEIC picture", _HEIC
    for pattern, name, way_out in _KINDS:
        if re.match(pattern, content, re.DOTALL):
            return f"it is {name}", way_out
    return _text(content[:4096]) or ("it is no picture that is known here", f"{_SAVE}, or remove it")


def _text(head: bytes) -> tuple[str, str] | None:
    """What a file of text is; none for other ones."""
    wide = head.startswith((b"\xff\xfe", b"\xfe\xff"))
    text = head.decode("utf-16" if wide else "utf-8-sig", "replace").strip()
    plain = text.encode()
    if _HTML.search(plain[:1024]):
        return "it is a web page (HTML), not the picture", _PAGE
    if re.search(rb"<svg[\s>]", plain):
        return "it is an SVG drawing", _VECTORS
    if not text or "\0" in text or text.count("\ufffd") > len(text) // 20:
        return None
    begin = " ".join(text.split())[:_SHOWN]
    return f"it is text that begins with '{visible(begin)}'", f"{_SAVE}, or remove it"


MAX_FILE_BYTES: Final = 20_000_000
FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP")
_SRGB_GAMMA: Final = 1 / 2.2
_SAME_LEVELS: Final = 2
"""A colour space counts as sRGB if no colour changes by more levels of 255."""
_TURNS: Final = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
_SPACES: Final = {"GRAY": "L", "RGB": "RGB", "CMYK": "CMYK"}
"""Colour spaces of ICC profiles, and Pillow's modes with their channels."""


def read_picture(
    path: Path,
    what: str,
    error: type[CognitiveDroneError],
    longest: int | None = None,
    max_bytes: int | None = None,
    max_pixels: int = MAX_PIXELS,
) -> Image.Image:
    """RGB image of a PNG, JPEG, WebP or BMP file, scaled down to at most `longest` px a side.

    `what` names it in messages, as in "label image". Raises `error` with the file's name, what it is and a way out if
    it is larger than `max_bytes` (`MAX_FILE_BYTES`) or `max_pixels`, or no such picture.
    """
    try:
        content = read_regular(path, MAX_FILE_BYTES if max_bytes is None else max_bytes)
    except OSError as refused:
        raise error(f"{what} {path} cannot be read: {reason_of(refused)}") from None
    return decode_picture(content, f"{what} {path}", error, longest, max_pixels)


def decode_picture(
    content: bytes,
    named: str,
    error: type[CognitiveDroneError],
    longest: int | None = None,
    max_pixels: int = MAX_PIXELS,
) -> Image.Image:
    """As `read_picture`, of a file's content; `named` is how messages name the file."""
    if other := what_else(content):
        raise error(f"{named} cannot be read as PNG, JPEG or WebP: {other[0]}; {other[1]}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of sizes, for which the limit below is stricter
            with Image.open(BytesIO(content), formats=FORMATS) as opened:
                if opened.width * opened.height > max_pixels:
                    raise error(
                        f"{named} has {opened.width}x{opened.height} pixels; at most {max_pixels / 1e6:.0f} million are"
                        " read; save it smaller"
                    )
                if longest is not None:
                    opened.draft("RGB", (2 * longest, 2 * longest))
                opened.load()
                image = _seen(opened)
                with suppress(Exception):  # Pillow raises many kinds for broken EXIF, which is no reason to refuse it
                    image = image.transpose(_TURNS[opened.getexif()[ExifTags.Base.Orientation]])
            if longest is not None:
                image.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    except error:
        raise
    except Image.DecompressionBombError:
        raise error(f"{named} has far more than {max_pixels / 1e6:.0f} million pixels; save it smaller") from None
    except UnidentifiedImageError:
        raise error(f"{named} cannot be read as PNG, JPEG or WebP: it is damaged; copy or save it again") from None
    except Exception as reason:  # Pillow raises many kinds for broken files
        text = visible(" ".join(str(reason).split())[:200]) or type(reason).__name__
        raise error(f"{named} cannot be read as PNG, JPEG or WebP: {text}; copy or save it again") from None
    white = Image.new("RGBA", image.size, "white")
    white.alpha_composite(image)
    return white.convert("RGB")


def _seen(opened: Image.Image) -> Image.Image:
    """RGBA in sRGB, 8 bits, of a loaded image. Raises `ValueError` if its white is unknown."""
    colour, alpha = split_alpha(opened)
    if opened.format == "BMP" and alpha is not None and alpha.getextrema() == (0, 0):
        alpha = None  # the fourth byte of each pixel is unused
    image = _in_srgb(colour, opened.info)
    image.putalpha(alpha or 255)
    return image


def split_alpha(image: Image.Image) -> tuple[Image.Image, Image.Image | None]:
    """The colours as an 8-bit image of mode L, RGB or CMYK, and its opacity (mode L), none if all of it is opaque.

    Whole numbers of mode "I" are 16-bit levels. Raises `ValueError` for pixels whose white is unknown.
    """
    if image.mode == "I" or image.mode.startswith("I;16"):
        levels = np.asarray(image).astype(np.int32)
        if levels.min() < 0 or levels.max() > 0xFFFF:
            raise ValueError(f"its grey levels are {levels.min()} to {levels.max()}, not 0 to 65535; scale them")
        transparent = image.info.get("transparency")
        opaque = None if transparent is None else _of(np.where(levels != transparent, 255, 0))
        return _of((levels + 128) // 257), opaque
    if image.mode in ("LA", "La"):
        grey, alpha = image.convert("LA").split()
        return grey, alpha
    if image.mode == "CMYK":
        return image, None
    if image.mode == "LAB":
        from PIL import ImageCms

        lab, srgb = ImageCms.createProfile("LAB"), ImageCms.createProfile("sRGB")
        converted = ImageCms.profileToProfile(image, lab, srgb, outputMode="RGB")
        assert converted is not None  # noqa: S101  (only in place there is none)
        return converted, None
    if image.mode in ("P", "PA", "RGBA", "RGBa") or "transparency" in image.info:
        rgba = image.convert("RGBA")
        return rgba.convert("RGB"), rgba.getchannel("A")
    if image.mode in ("1", "L"):
        return image.convert("L"), None
    if image.mode in ("RGB", "RGBX", "YCbCr", "HSV"):
        return (image if image.mode == "RGB" else image.convert("RGB")), None
    raise ValueError(f"its pixels are of mode {image.mode}, whose white is unknown; scale them to 8 bits")


def _of(levels: Any) -> Image.Image:
    return Image.fromarray(np.asarray(levels, dtype=np.uint8))


def _opaque(mask: Any) -> Image.Image:
    return _of(np.where(mask, 255, 0))


def _in_srgb(colour: Image.Image, info: dict[Any, Any]) -> Image.Image:
    """RGB in sRGB, by the file's ICC profile or its gamma."""
    profile = info.get("icc_profile")
    if isinstance(profile, bytes) and (transform := _to_srgb(profile, colour.mode)) is not None:
        from PIL import ImageCms

        converted = ImageCms.applyTransform(colour, transform)
        assert converted is not None  # noqa: S101  (only in place there is none)
        return converted
    rgb = colour.convert("RGB")
    gamma = info.get("gamma")
    if profile or "srgb" in info or not isinstance(gamma, float) or not 0.05 < gamma < 5:
        return rgb if rgb is not colour else colour.copy()
    levels = np.rint(255 * (np.arange(256) / 255) ** (_SRGB_GAMMA / gamma))
    if np.abs(levels - np.arange(256)).max() <= _SAME_LEVELS:
        return rgb
    return rgb.point([int(level) for level in levels] * 3)


@lru_cache(maxsize=8)
def _to_srgb(profile: bytes, mode: str) -> Any:
    """What turns colours of a mode into sRGB; none for a broken profile, one of other channels, and for sRGB."""
    if not features.check("littlecms2"):
        return None
    from PIL import ImageCms

    try:
        opened = ImageCms.ImageCmsProfile(BytesIO(profile))
        if _SPACES.get(opened.profile.xcolor_space.strip()) != mode:
            return None
        transform = ImageCms.buildTransform(opened, ImageCms.createProfile("sRGB"), mode, "RGB")
        samples = _samples(mode)
        after = np.asarray(ImageCms.applyTransform(samples, transform)).astype(int)
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        return None
    return None if np.abs(after - np.asarray(samples.convert("RGB"))).max() <= _SAME_LEVELS else transform


def _samples(mode: str) -> Image.Image:
    """All levels of grey, or a grid of colours."""
    if mode == "L":
        return _of(np.arange(256)[None])
    steps = np.linspace(0, 255, 9).astype(np.uint8)
    grid = np.stack(np.meshgrid(*[steps] * len(mode)), axis=-1)
    return Image.frombytes(mode, (1, grid.size // len(mode)), grid.tobytes())
