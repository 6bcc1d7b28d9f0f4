"""What a file is by its first bytes, whatever its name says, and what to do with a picture that is not read."""

from __future__ import annotations

import re
from typing import Final

from cognitivedrone.text.printable import visible

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
