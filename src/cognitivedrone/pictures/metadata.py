"""Metadata of picture files: the orientation alone is looked for; decoders get files without the rest.

Cameras, telephones and editors write EXIF that breaks its own rules. What a picture shows does not depend on it, so
nothing in it can be an error here.
"""

from __future__ import annotations

import re
import struct
import zlib
from contextlib import suppress
from typing import Final

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_PNG_KEPT: Final = (b"tRNS", b"gAMA", b"sRGB", b"iCCP")
"""Chunks that change what is seen, beside the critical ones. Without those of an animation, its first picture is."""
_MAY_BE_DROPPED: Final = (b"gAMA", b"sRGB", b"iCCP")
_ORIENTATION: Final = 0x0112
_INTEGERS: Final = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i"}
"""TIFF's types of whole numbers."""
_XMP: Final = re.compile(rb"tiff:Orientation(?:\s*=\s*[\"']|>)\s*([1-8])")
_MOST_EXIF: Final = 1 << 20


def without_metadata(content: bytes) -> tuple[bytes, int]:
    """The file without metadata, and the orientation that it asked for: 1 (upright) to 8, as in EXIF.

    Of files other than PNG and JPEG, the content is as it was.
    """
    if content.startswith(_PNG):
        kept, exif, xmp = _png(content)
    elif content.startswith(b"\xff\xd8"):
        kept, exif, xmp = _jpeg(content)
    elif content.startswith(b"RIFF"):
        kept, exif, xmp = content, *_webp(content)
    else:
        return content, 1
    found = _XMP.search(xmp)
    return kept, _of_exif(exif) or (int(found[1]) if found else 1)


def _of_exif(exif: bytes) -> int | None:
    """The orientation in the first directory of EXIF (a TIFF file); none where it cannot be read."""
    tiff = exif[6:] if exif.startswith(b"Exif\0") else exif
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return None
    with suppress(struct.error):  # it ends too early
        (start,) = struct.unpack_from(f"{order}I", tiff, 4)
        (count,) = struct.unpack_from(f"{order}H", tiff, start)
        for place in range(start + 2, start + 2 + 12 * count, 12):
            tag, kind = struct.unpack_from(f"{order}HH", tiff, place)
            if tag == _ORIENTATION and kind in _INTEGERS:
                (value,) = struct.unpack_from(f"{order}{_INTEGERS[kind]}", tiff, place + 8)
                return int(value) if 1 <= value <= 8 else None
    return None


def _jpeg(content: bytes) -> tuple[bytes, bytes, bytes]:
    """Without comments and application data, except those that say how to read the colours; EXIF; XMP."""
    kept, exif, xmp, place = [content[:2]], b"", b"", 2
    while place + 4 <= len(content) and content[place] == 0xFF:
        marker = content[place + 1]
        if marker == 0xFF:  # padding
            place += 1
            continue
        end = place + 2 + int.from_bytes(content[place + 2 : place + 4], "big")
        if marker == 0xDA or end < place + 4 or end > len(content):
            break
        body = content[place + 4 : end]
        if marker == 0xE1 and body.startswith(b"Exif\0"):
            exif += body[6:]  # what is too long for one segment goes on in the next
        elif marker == 0xE1:
            xmp += body
        colours = marker in (0xE0, 0xEE) or body.startswith(b"ICC_PROFILE\0")
        if colours or not (0xE0 <= marker <= 0xEF or marker == 0xFE):
            kept.append(content[place:end])
        place = end
    return b"".join([*kept, content[place:]]), exif, xmp


def _png(content: bytes) -> tuple[bytes, bytes, bytes]:
    """Without chunks that do not change what is seen; EXIF, also as ImageMagick writes it; XMP."""
    kept, exif, xmp, place = [_PNG], b"", b"", len(_PNG)
    while place < len(content):
        end = place + 12 + int.from_bytes(content[place : place + 4], "big")
        name, chunk = content[place + 4 : place + 8], content[place:end]
        body = chunk[8:-4]
        if name[:1].isupper() or (name in _PNG_KEPT and (name not in _MAY_BE_DROPPED or _is_whole(chunk))):
            kept.append(chunk)
        elif name == b"eXIf":
            exif = exif or body
        elif name in (b"zTXt", b"tEXt", b"iTXt"):
            xmp += body if b"tiff:Orientation" in body else b""
            exif = exif or _raw_profile(name, body)
        place = end
        if name == b"IEND":
            break
    return b"".join(kept), exif, xmp


def _is_whole(chunk: bytes) -> bool:
    return zlib.crc32(chunk[4:-4]) == int.from_bytes(chunk[-4:], "big")


def _raw_profile(name: bytes, body: bytes) -> bytes:
    """EXIF in a text of hexadecimal digits; empty if it is none."""
    keyword, _, text = body.partition(b"\0")
    if keyword not in (b"Raw profile type exif", b"Raw profile type APP1"):
        return b""
    with suppress(zlib.error, ValueError):
        if name == b"zTXt":
            text = zlib.decompressobj().decompress(text[1:], _MOST_EXIF)
        return bytes.fromhex("".join(text.decode("ascii").split()[2:]))
    return b""


def _webp(content: bytes) -> tuple[bytes, bytes]:
    """EXIF and XMP."""
    found, place = {b"EXIF": b"", b"XMP ": b""}, 12
    while place + 8 <= len(content):
        name, size = content[place : place + 4], int.from_bytes(content[place + 4 : place + 8], "little")
        if name in found:
            found[name] = content[place + 8 : place + 8 + size]
        place += 8 + size + size % 2
    return found[b"EXIF"], found[b"XMP "]
