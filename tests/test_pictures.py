"""Pictures that would fill the memory are refused by their size, before they are decoded."""

import struct
import zlib
from io import BytesIO

import pytest
from PIL import Image

from cognitivedrone.pictures import MAX_SIDE, open_picture


def png_of(width: int, height: int) -> bytes:
    """A PNG of that size in a few bytes, whose pixels are missing: whoever decodes it fails."""
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(b"")), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize("side", [12_000, 30_000, 2**31 - 1])
@pytest.mark.filterwarnings("error")
def test_a_huge_picture_is_refused_by_its_header(side: int) -> None:
    with pytest.raises(ValueError, match="at most 40 million are read"):
        open_picture(png_of(side, side), ("PNG",))
    with pytest.raises(ValueError, match="a frame has at most 2048 pixels a side"):
        open_picture(png_of(side, 1), ("PNG",), max_side=MAX_SIDE)


def test_a_picture_within_the_limits_is_opened() -> None:
    with open_picture(png_of(8000, 5000), ("PNG",)) as picture:
        assert picture.size == (8000, 5000)


def test_other_formats_are_not_tried() -> None:
    coded = BytesIO()
    Image.new("RGB", (2, 2)).save(coded, "GIF")
    with pytest.raises(OSError, match="cannot identify"):
        open_picture(coded.getvalue(), ("PNG", "JPEG"))
