"""What a file is whose name promises a picture, and what to do with it."""

import gzip
import io
import struct

import pytest
from PIL import Image

from cognitivedrone.errors import LabelError
from cognitivedrone.pictures import decode_picture


def saved(form: str, **options) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (20, 20), "red").save(buffer, form, **options)
    return buffer.getvalue()


def boxes(*brands: bytes) -> bytes:
    """The begin of a file of ISO's media format: HEIC, AVIF, MP4."""
    body = brands[0] + bytes(4) + b"".join(brands[1:])
    return struct.pack(">I", 8 + len(body)) + b"ftyp" + body + b"\0\0\0\x08mdat" + bytes(64)


SVG = b'<svg xmlns="http://www.w3.org/2000/svg" width="10" height="10"><circle r="5"/></svg>'
SAVE = "save it as PNG or JPEG"
WRONG = {
    "HEIC": (boxes(b"heic", b"mif1", b"heic"), "it is a HEIC picture", "Most Compatible"),
    "HEIC of an animation": (boxes(b"hevc", b"msf1"), "it is a HEIC picture", SAVE),
    "AVIF": (boxes(b"avif", b"mif1", b"miaf"), "it is an AVIF picture", SAVE),
    "MP4": (boxes(b"isom", b"avc1"), "it is a video", "save one frame"),
    "QuickTime": (boxes(b"qt  "), "it is a video", "save one frame"),
    "Canon's raw": (boxes(b"crx "), "it is the raw picture of a camera", SAVE),
    "HTML": (b"<!DOCTYPE html><html><body>404</body></html>", "it is a web page (HTML)", "save the picture itself"),
    "HTML after a comment": (b"\xef\xbb\xbf\n<!-- x --><HTML>", "it is a web page (HTML)", "the picture itself"),
    "HTML in UTF-16": ("\ufeff<html></html>".encode("utf-16-le"), "it is a web page (HTML)", "the picture itself"),
    "SVG": (SVG, "it is an SVG drawing", "export it as PNG"),
    "SVG with its declaration": (b'<?xml version="1.0"?>\n<!-- a -->\n' + SVG, "it is an SVG drawing", "export it"),
    "SVGZ": (gzip.compress(SVG, mtime=0), "it is a compressed file (gzip)", "unpack it"),
    "empty": (b"", "it is empty", "copy or download it again"),
    "zeros": (bytes(5000), "it holds nothing but zeros", "copy or download it again"),
    "GIF": (saved("GIF"), "it is a GIF picture", SAVE),
    "TIFF": (saved("TIFF"), "it is a TIFF picture", SAVE),
    "PNM": (saved("PPM"), "it is a PNM picture", SAVE),
    "JPEG XL": (b"\xff\x0a" + bytes(30), "it is a JPEG XL picture", SAVE),
    "PDF": (b"%PDF-1.7\n", "it is a PDF or PostScript document", "export it as PNG"),
    "ZIP": (b"PK\3\4" + bytes(30), "it is an archive", "unpack it"),
    "AppleDouble": (b"\0\5\x16\7\0\2\0\0Mac OS X", "it is a Mac's notes about another file", "remove it"),
    "Git LFS": (b"version https://git-lfs.github.com/spec/v1\n", "it is a pointer of Git LFS", "git lfs pull"),
    "text": (b"\x1b[31mnot   a\npicture", r"it is text that begins with '\x1b[31mnot a picture'", SAVE),
    "JSON": (b'{"error": "not found"}', "it is text that begins with '{\"error\"", SAVE),
    "noise": (bytes(range(128, 256)) * 4, "it is no picture that is known here", "or remove it"),
    "another program's": (b"\x7fELF\2\1\1\0" + bytes(40), "it is no picture that is known here", SAVE),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_the_message_says_what_the_file_is_and_what_to_do(kind):
    content, what, way_out = WRONG[kind]
    with pytest.raises(LabelError) as refused:
        decode_picture(content, "label image cat.png", LabelError)
    message = str(refused.value)
    assert message.startswith(f"label image cat.png cannot be read as PNG, JPEG or WebP: {what}")
    assert way_out in message
    assert message.isprintable()


@pytest.mark.skipif(".avif" not in Image.registered_extensions(), reason="this Pillow writes no AVIF")
def test_a_real_avif_is_known():
    with pytest.raises(LabelError, match="it is an AVIF picture; save it as PNG or JPEG"):
        decode_picture(saved("AVIF"), "label image cat.jpg", LabelError)


@pytest.mark.parametrize("form", ["PNG", "JPEG", "WEBP", "BMP"])
def test_a_picture_under_another_ones_name_is_shown(form):
    assert decode_picture(saved(form), "label image cat.anything", LabelError).size == (20, 20)


@pytest.mark.parametrize("form", ["PNG", "JPEG", "WEBP", "BMP"])
def test_a_torn_picture_is_refused_at_every_length(form):
    """Nobody sees half of a picture without a word; what the last bytes say may be missing."""
    whole = saved(form)
    for length in [*range(1, 40), *range(40, len(whole) - 40, 37)]:
        with pytest.raises(LabelError, match=r"cannot be read as PNG, JPEG or WebP: .*; (copy|save)") as refused:
            decode_picture(whole[:length], "label image cat.png", LabelError)
        assert "object at 0x" not in str(refused.value)
