"""Pictures of any depth, transparency, colour space and orientation are read as people see them."""

import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageCms

from cognitivedrone.errors import LabelError
from cognitivedrone.pictures import MAX_FILE_BYTES, decode_picture, read_picture
from cognitivedrone.pictures.reading import split_alpha

RAMP = np.linspace(0, 65535, 256)[None].repeat(8, 0).astype(np.uint16)
"""(8, 256) grey levels of 16 bits."""
GREY = np.arange(256, dtype=np.uint8)[None].repeat(8, 0)
COLOURS = np.stack(np.meshgrid(*[np.linspace(0, 255, 8).astype(np.uint8)] * 3), -1).reshape(16, 32, 3)


def encoded(image: Image.Image, form: str = "PNG", **options) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, form, **options)
    return buffer.getvalue()


def read(content: bytes, longest: int | None = None) -> np.ndarray:
    return np.asarray(decode_picture(content, "label image cat.png", LabelError, longest)).astype(int)


def chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def png(levels: np.ndarray, depth: int, colour: int, *extra: bytes) -> bytes:
    """A PNG of (H, W) or (H, W, channels) levels, one bit pattern of `depth` bits each."""
    rows = levels.reshape(len(levels), -1)
    if depth == 16:
        packed = rows.astype(">u2").view(np.uint8).reshape(len(rows), -1)
    else:
        bits = (rows[..., None] >> np.arange(depth - 1, -1, -1)) & 1
        packed = np.packbits(bits.reshape(len(rows), -1).astype(np.uint8), axis=1)
    data = zlib.compress(b"".join(b"\0" + row.tobytes() for row in packed))
    header = struct.pack(">IIBBBBB", levels.shape[1], len(levels), depth, colour, 0, 0, 0)
    chunks = (chunk(b"IHDR", header), *extra, chunk(b"IDAT", data), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


# Depth.


def test_grey_of_16_bits_keeps_its_levels():
    image = read(encoded(Image.fromarray(RAMP)))
    assert (image == GREY[..., None]).all()
    assert len(np.unique(image)) == 256


CASES = [(1, 0), *((depth, colour) for depth in (8, 16) for colour in (0, 2, 4, 6))]


@pytest.mark.parametrize(
    ("depth", "colour", "transparent"),
    [(*case, clear) for case in CASES for clear in (False, True) if not clear or case != (16, 2)],
)
def test_png_of_every_depth(depth, transparent, colour):
    """Grey, RGB, grey with alpha, RGBA; with one transparent colour or alpha."""
    most, channels = (1 << depth) - 1, {0: 1, 2: 3, 4: 2, 6: 4}[colour]
    levels = np.random.default_rng(depth).integers(0, most + 1, (12, 20, channels))
    levels[3, 5] = most // 2
    key = levels[3, 5]
    opaque = np.ones(levels.shape[:2])
    extra = []
    if colour in (4, 6):
        levels[..., -1] = levels[..., -1] if transparent else most
        opaque, levels_of = levels[..., -1] / most, levels[..., :-1]
    else:
        levels_of = levels
        if transparent:
            extra.append(chunk(b"tRNS", b"".join(struct.pack(">H", level) for level in key)))
            opaque = (levels != key).any(axis=2).astype(float)
    expected = 255 * (opaque[..., None] * levels_of / most + 1 - opaque[..., None])
    image = read(png(levels, depth, colour, *extra))
    assert np.abs(image - np.broadcast_to(expected, image.shape)).max() <= 2
    if transparent and colour in (0, 2):
        assert (image[3, 5] == 255).all()


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
def test_palettes_of_every_depth_with_transparency(depth):
    count = 1 << depth
    palette = np.random.default_rng(0).integers(0, 255, (count, 3), np.uint8)
    opacity = np.linspace(0, 255, count).astype(np.uint8)
    levels = np.arange(64).reshape(4, 16) % count
    image = read(png(levels, depth, 3, chunk(b"PLTE", palette.tobytes()), chunk(b"tRNS", opacity.tobytes())))
    share = opacity[levels][..., None] / 255
    assert np.abs(image - (palette[levels] * share + 255 * (1 - share))).max() <= 1


# Pillow's modes, whatever file they may come from.


def in_mode(mode: str) -> tuple[Image.Image, np.ndarray, np.ndarray | None]:
    """An image of a mode, the RGB that is seen in it, and its opacity."""
    alpha = np.linspace(0, 255, 32).astype(np.uint8)[None].repeat(16, 0)
    grey, colour, opacity = Image.fromarray(GREY), Image.fromarray(COLOURS), Image.fromarray(alpha)
    if mode == "1":
        return grey.convert("1"), np.asarray(grey.convert("1").convert("RGB")), None
    if mode == "L":
        return grey, np.asarray(grey.convert("RGB")), None
    if mode == "I" or mode.startswith("I;16"):
        levels = RAMP.astype(">u2" if mode == "I;16B" else "<u2")
        if mode == "I":
            return Image.fromarray(RAMP.astype(np.int32)), np.asarray(grey.convert("RGB")), None
        return Image.frombytes(mode, (256, 8), levels.tobytes()), np.asarray(grey.convert("RGB")), None
    if mode in ("LA", "La"):
        both = Image.merge("LA", (colour.convert("L"), opacity))
        seen = np.asarray(colour.convert("L").convert("RGB"))
        return (both if mode == "LA" else both.convert("La")), seen, alpha
    if mode in ("RGBA", "RGBa"):
        both = colour.copy()
        both.putalpha(opacity)
        return (both if mode == "RGBA" else both.convert("RGBa")), COLOURS, alpha
    if mode in ("P", "PA"):
        palette = colour.quantize(64)
        seen = np.asarray(palette.convert("RGB"))
        if mode == "P":
            return palette, seen, None
        both = palette.convert("PA")
        both.putalpha(opacity)
        return both, seen, alpha
    if mode == "LAB":
        lab, srgb = ImageCms.createProfile("LAB"), ImageCms.createProfile("sRGB")
        return ImageCms.profileToProfile(colour, srgb, lab, outputMode="LAB"), COLOURS, None
    return colour.convert(mode), COLOURS, None


@pytest.mark.parametrize("mode", Image.MODES)
def test_every_mode_of_pillow_is_seen_or_refused(mode):
    if mode == "F":
        with pytest.raises(ValueError, match="mode F, whose white is unknown; scale them to 8 bits"):
            split_alpha(Image.new("F", (4, 4), 0.5))
        return
    image, seen, alpha = in_mode(mode)
    assert image.mode == mode
    colour, opacity = split_alpha(image)
    shown = np.asarray(colour.convert("RGB")).astype(int)
    clear = np.ones(shown.shape[:2], bool) if alpha is None else alpha > 60  # below, premultiplied colours are coarse
    apart = np.abs(shown - seen)[clear]
    assert apart.max() <= {"YCbCr": 3, "HSV": 6, "LAB": 40, "La": 4, "RGBa": 4}.get(mode, 0)
    assert apart.mean() < 3
    assert np.all((255 if opacity is None else np.asarray(opacity)) == (255 if alpha is None else alpha))


def test_whole_numbers_of_unknown_white_are_refused():
    with pytest.raises(ValueError, match="grey levels are 0 to 70000, not 0 to 65535"):
        split_alpha(Image.fromarray(np.array([[0, 70000]], np.int32)))


@pytest.mark.parametrize(
    ("mode", "form"),
    [
        *((mode, "PNG") for mode in ("1", "L", "LA", "I;16", "P", "RGB", "RGBA")),
        *((mode, "JPEG") for mode in ("1", "L", "RGB", "RGBX", "YCbCr", "CMYK")),
        *((mode, "WEBP") for mode in ("L", "RGB", "RGBA", "P", "LA", "CMYK")),
        *((mode, "BMP") for mode in ("1", "L", "P", "RGB")),
    ],
)
def test_every_mode_of_every_format_is_read(mode, form):
    image, seen, alpha = in_mode(mode)
    options: dict[str, dict[str, int]] = {"JPEG": {"quality": 100, "subsampling": 0}, "WEBP": {"lossless": True}}
    content = encoded(image, form, **options.get(form, {}))
    share = (np.full(seen.shape[:2], 255) if alpha is None else alpha)[..., None] / 255
    assert np.abs(read(content) - (seen * share + 255 * (1 - share))).mean() < (3 if form == "JPEG" else 1.1)


def test_an_unused_fourth_byte_of_a_bitmap_is_no_transparency():
    image = Image.fromarray(COLOURS)
    image.putalpha(0)
    assert (read(encoded(image, "BMP")) == COLOURS).all()
    assert (read(encoded(image, "PNG")) == 255).all()


# Colour space.


def profile(space: str, gamma: float = 1.0) -> bytes:
    """An ICC profile: of grey with a gamma, or of RGB with the channels in another order."""
    head = bytearray(128)
    struct.pack_into(">4xI4s4s4s", head, 4, 0x02100000, b"mntr", b"GRAY" if space == "L" else b"RGB ", b"XYZ ")
    head[36:40] = b"acsp"
    head[68:80] = struct.pack(">iii", 63190, 65536, 54061)

    def xyz(*values: float) -> bytes:
        return b"XYZ \0\0\0\0" + struct.pack(">iii", *(round(65536 * value) for value in values))

    curve = b"curv\0\0\0\0" + struct.pack(">IH2x", 1, round(256 * gamma))
    tags = {b"wtpt": xyz(0.9642, 1.0, 0.8249)}
    if space == "L":
        tags[b"kTRC"] = curve
    else:
        red, green, blue = (0.4361, 0.2225, 0.0139), (0.3851, 0.7169, 0.0971), (0.1431, 0.0606, 0.7141)
        tags |= {b"rXYZ": xyz(*blue), b"gXYZ": xyz(*green), b"bXYZ": xyz(*red)}
        tags |= {b"rTRC": curve, b"gTRC": curve, b"bTRC": curve}
    table, body, place = struct.pack(">I", len(tags)), b"", 128 + 4 + 12 * len(tags)
    for name, data in tags.items():
        table += name + struct.pack(">II", place + len(body), len(data))
        body += data
    head[0:4] = struct.pack(">I", place + len(body))
    return bytes(head) + table + body


@pytest.mark.parametrize("form", ["PNG", "JPEG", "WEBP"])
def test_colours_are_those_of_the_profile(form):
    """Red in a profile whose first channel is blue is blue."""
    image = Image.new("RGB", (16, 16), (255, 0, 0))
    seen = read(encoded(image, form, icc_profile=profile("RGB", 2.2)))[8, 8]
    assert seen[2] > 245
    assert seen[:2].max() < 12


def test_a_grey_profile_is_followed_also_with_16_bits_and_alpha():
    """A linear grey of a half is 188 of 255 in sRGB."""
    for image in (
        Image.new("L", (8, 8), 128),
        Image.fromarray(np.full((8, 8), 32896, np.uint16)),
        Image.merge("LA", (Image.new("L", (8, 8), 128), Image.new("L", (8, 8), 255))),
    ):
        assert np.abs(read(encoded(image, icc_profile=profile("L"))) - 188).max() <= 1


def test_a_linear_png_is_brightened():
    assert np.abs(read(png(np.full((4, 4), 128), 8, 0, chunk(b"gAMA", struct.pack(">I", 100000)))) - 186).max() <= 1


@pytest.mark.parametrize("broken", [b"", b"no profile", profile("L"), profile("RGB")[:200], b"\xff" * 400])
def test_a_broken_or_unfitting_profile_is_ignored(broken):
    for form, options in (("PNG", {}), ("WEBP", {"lossless": True})):
        assert (read(encoded(Image.fromarray(COLOURS), form, icc_profile=broken, **options)) == COLOURS).all()


# Orientation, and what else is in the metadata.


def corners(content: bytes) -> str:
    """The colours of the corners, clockwise from the upper left."""
    image = read(content)
    picked = (image[2, 2], image[2, -3], image[-3, -3], image[-3, 2])
    return "".join("w" if each.min() > 127 else "rgb"[int(each.argmax())] for each in picked)


def four_corners() -> Image.Image:
    image = Image.new("RGB", (48, 32), "white")
    for place, colour in (((0, 0), "#f00"), ((32, 0), "#0f0"), ((32, 16), "#00f")):
        image.paste(colour, (*place, place[0] + 16, place[1] + 16))
    return image


@pytest.mark.parametrize("form", ["PNG", "JPEG", "WEBP"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_orientation_is_upright(form, orientation):
    turn = {
        2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180, 4: Image.Transpose.FLIP_TOP_BOTTOM,
        5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_90, 7: Image.Transpose.TRANSVERSE,
        8: Image.Transpose.ROTATE_270,
    }.get(orientation)  # fmt: skip
    stored = four_corners() if turn is None else four_corners().transpose(turn)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    xmp = f'<x:xmpmeta><rdf:Description tiff:Orientation="{orientation}"/></x:xmpmeta>'.encode()
    assert corners(encoded(stored, form, exif=exif)) == "rgbw"
    if form == "WEBP":
        assert corners(encoded(stored, form, xmp=xmp)) == "rgbw"
        return
    if form == "JPEG":
        plain, segment = encoded(stored, form), b"http://ns.adobe.com/xap/1.0/\0" + xmp
        marker = b"\xff\xe1" + struct.pack(">H", len(segment) + 2)
        assert corners(plain[:2] + marker + segment + plain[2:]) == "rgbw"
        return
    text = b"XML:com.adobe.xmp\0\0\0\0\0" + xmp
    raw = b"Raw profile type exif\0\0" + zlib.compress(
        b"\nexif\n%8d\n" % len(exif.tobytes()) + exif.tobytes().hex().encode() + b"\n"
    )
    for extra in (chunk(b"iTXt", text), chunk(b"zTXt", raw)):
        assert corners(png(np.asarray(stored), 8, 2, extra)) == "rgbw"


def test_an_orientation_behind_the_pixels_counts():
    content = encoded(four_corners().transpose(Image.Transpose.ROTATE_90))
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    assert corners(content[:-12] + chunk(b"eXIf", exif.tobytes()[6:]) + content[-12:]) == "rgbw"


def tiff(order: str, entries: list[tuple[int, int, int, bytes]], tail: bytes = b"", **wrong: int) -> bytes:
    """EXIF: entries of tag, type, count and value (4 bytes), then what they point to."""
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", wrong.get("start", 8))
    body = struct.pack(f"{order}H", wrong.get("count", len(entries)))
    body += b"".join(struct.pack(f"{order}HHI", *entry[:3]) + entry[3] for entry in entries)
    return head + body + b"\0\0\0\0" + tail


def slightly_wrong() -> Iterator[tuple[str, bytes, bool]]:
    """EXIF that cameras, telephones and editors write: name, bytes, and whether its orientation can be read."""
    for order in "<>":
        turned = (0x0112, 3, 1, struct.pack(f"{order}H", 6).ljust(4, b"\0"))
        far, nine = struct.pack(f"{order}I", 60000), struct.pack(f"{order}H", 9).ljust(4, b"\0")
        yield f"{order} Make beyond the end", tiff(order, [(0x010F, 2, 100, far), turned]), True
        yield f"{order} an unknown type", tiff(order, [(0x010F, 77, 1, far), turned]), True
        yield f"{order} entries out of order", tiff(order, [(0x8769, 4, 1, bytes(4)), turned]), True
        yield f"{order} more entries than there are", tiff(order, [turned], count=500), True
        yield f"{order} orientation 9", tiff(order, [(0x0112, 3, 1, nine)]), False
        yield f"{order} a directory beyond the end", tiff(order, [turned], start=9999), False
        yield f"{order} cut in an entry", tiff(order, [turned])[:14], False
    yield "text", b"hello" * 20, False


@pytest.mark.parametrize("form", ["PNG", "JPEG", "WEBP"])
@pytest.mark.parametrize(("exif", "known"), [pytest.param(e, known, id=name) for name, e, known in slightly_wrong()])
def test_broken_exif_changes_nothing_but_the_orientation(form, exif, known):
    content = encoded(four_corners(), form, exif=b"Exif\0\0" + exif)
    assert corners(content) == ("wrgb" if known else "rgbw")


@pytest.mark.parametrize("density", [True, False])
@pytest.mark.parametrize("form", ["JPEG", "WEBP"])
def test_mutants_of_exif_are_all_shown(form, density):
    exif = Image.Exif()
    exif[ExifTags.Base.XResolution] = exif[ExifTags.Base.YResolution] = 72.0
    exif[ExifTags.Base.ImageDescription] = "a cat"
    exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSAltitude] = 120.0
    content = encoded(Image.fromarray(COLOURS), form, exif=exif)
    if form == "JPEG" and not density:  # then Pillow asks EXIF for it
        content = content[:2] + content[20:]
    begin = content.find(b"II*\0") if b"II*\0" in content else content.find(b"MM\0*")
    shapes = set()
    for seed in range(60):
        rng = np.random.default_rng(seed)
        mutant = bytearray(content)
        for place in rng.integers(begin, begin + len(exif.tobytes()) - 6, rng.integers(1, 5)):
            mutant[place] = int(rng.choice([0, 1, 3, 5, 7, 10, 12, 127, 255, int(rng.integers(256))]))
        shapes.add(read(bytes(mutant)).shape)
    assert shapes <= {(16, 32, 3), (32, 16, 3)}


def test_broken_thumbnails_are_ignored():
    jpeg = encoded(Image.fromarray(COLOURS), "JPEG")
    segments = b"".join(b"\xff" + marker + struct.pack(">H", 6) + b"\xff\xd8\xff\xd9" for marker in (b"\xed", b"\xfe"))
    plural = b"\xff\xe2" + struct.pack(">H", 14) + b"MPF\0II*\0\xff\xff\xff\xff"
    assert (read(jpeg[:2] + segments + plural + jpeg[2:]) == read(jpeg)).all()


# Animation and size.


@pytest.mark.parametrize("form", ["PNG", "WEBP"])
def test_the_first_picture_of_an_animation_is_shown(form):
    frames = [Image.new("RGB", (20, 10), colour) for colour in ("red", "lime", "blue")]
    content = encoded(frames[0], form, save_all=True, append_images=frames[1:], duration=50)
    assert np.abs(read(content) - [255, 0, 0]).max() < 8


def test_sizes_from_one_pixel_to_a_strip():
    for size in ((1, 1), (1, 3000), (3000, 1), (256, 256), (257, 256)):
        image = read(encoded(Image.new("RGB", size, "red")), 256)
        assert max(image.shape) <= max(256, 3)
        assert min(image.shape) >= 1
        assert (image == [255, 0, 0]).all()
    assert read(encoded(Image.new("RGB", (600, 300))), None).shape == (300, 600, 3)


def test_a_picture_beyond_the_limits_is_not_decoded(tmp_path: Path):
    with pytest.raises(LabelError, match=r"7000x6000 pixels; at most 40 million are read; save it smaller"):
        read(encoded(Image.new("1", (7000, 6000))))
    bomb = png(np.zeros((1, 1), int), 1, 0)
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 1, 0, 0, 0, 0))
    with pytest.raises(LabelError, match=r"cat\.png has far more than 40 million pixels; save it smaller"):
        read(bomb[:8] + header + bomb[33:])
    large = tmp_path / "large.png"
    with large.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    with pytest.raises(LabelError, match=r"label image .*large\.png cannot be read: it has 20,000,001 bytes"):
        read_picture(large, "label image", LabelError)
