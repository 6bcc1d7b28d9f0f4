"""Places: the shipped ones, the light that is read off them, and panoramas of a user's own, good and bad."""

import hashlib
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.errors import AppearanceError, RenderError
from cognitivedrone.plan import Scenario
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.types import Gate, Stage
from cognitivedrone.world import places
from cognitivedrone.world.appearance import PLAIN, photo_appearance
from cognitivedrone.world.assets import build_assets

STAGE = Stage(
    (Gate("big", "round", "red"), Gate("big", "square", "green"), Gate("small", "triangle", "blue")),
    ("animal/cat", "animal/dog", "animal/owl"),
)
PICTURES = [np.full((64, 64, 3), 128, np.uint8)] * 3


def panorama(width=512, height=256, color=(90, 120, 60)) -> Image.Image:
    """A ground of one colour under a bright sky whose left half, seen from the middle, is brighter."""
    pixels = np.full((height, width, 3), color, np.uint8)
    pixels[: height // 2] = (120, 150, 200)
    pixels[: height // 3, : width // 4] = 255
    return Image.fromarray(pixels)


@pytest.mark.parametrize("name", places.names())
def test_a_shipped_place_has_a_picture_and_a_light_from_above(name):
    place = places.load_place(name)
    assert place.pixels.shape == (256, 512, 3)
    assert place.light[2] < 0
    assert np.linalg.norm(place.light) == pytest.approx(1.0)
    for color in (place.light_color, place.ambient_color):
        assert max(color) == pytest.approx(1.0)


def test_the_pictures_name_their_source_and_licence_and_are_small():
    folder = resources.files("cognitivedrone.world") / "panoramas"
    table = json.loads((folder / "manifest.json").read_text())
    assert table["licence"] == "CC0-1.0"
    assert sum(len((folder / f"{name}.jpg").read_bytes()) for name in places.names()) < 1_500_000


def test_every_face_of_the_mesh_is_seen_from_the_eye():
    vertices, faces, texture = places.mesh()
    eye = np.array([0.0, 0.0, places.EYE_M])
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - eye)
    assert (outward < 0).all(), "counter-clockwise from inside"
    assert texture.min() >= 0.0
    assert texture.max() <= 1.0
    ground = vertices[:, 2] < 1e-9
    assert np.allclose(vertices[ground, 2], 0.0)
    assert np.linalg.norm(vertices[ground, :2], axis=1).max() == pytest.approx(places.REACH_M)


def test_a_ray_from_the_eye_meets_its_own_pixel():
    """Vertices lie where the direction of their texture coordinates points."""
    vertices, _, texture = places.mesh()
    seen = vertices - [0.0, 0.0, places.EYE_M]
    elevation = np.arctan2(seen[:, 2], np.linalg.norm(seen[:, :2], axis=1))
    np.testing.assert_allclose(texture[:, 1], 0.5 - elevation / np.pi, atol=1e-6)
    level = np.linalg.norm(seen[:, :2], axis=1) > 1e-6
    turn = np.exp(1j * (np.arctan2(seen[level, 1], seen[level, 0]) + 2 * np.pi * (texture[level, 0] - 0.5)))
    np.testing.assert_allclose(turn, 1.0, atol=1e-6)


def test_the_light_comes_from_where_the_picture_is_brightest(tmp_path):
    panorama().save(tmp_path / "mine.png")
    east, north, down = places.load_place(str(tmp_path / "mine.png")).light
    assert down < 0
    assert east > 0, "the bright quarter is behind on the left, so the light goes ahead"
    assert north < 0


def test_an_appearance_is_drawn_from_the_generator_alone_and_reaches_every_place():
    among = places.names("training")
    drawn = [photo_appearance(np.random.default_rng(seed), among) for seed in range(100)]
    assert drawn == [photo_appearance(np.random.default_rng(seed), among) for seed in range(100)]
    assert {each.place for each in drawn} == {*among}


def test_cameras_have_textures_for_the_places_that_they_can_show_at_once():
    poses = [[-1.0, 0.0, 0.75]], [[1.0, 0.0, 0.0, 0.0]]
    drawn = {}
    with Cameras(1) as one, Cameras(3) as three:
        for name in ("hall", "lab", "hall", "park", "venice", "lobby", "hall"):
            look = photo_appearance(np.random.default_rng(1), [name])
            one.set_stage(0, STAGE, PICTURES, appearance=look)
            drawn.setdefault(name, one.first_person(*poses).copy())
            assert (one.first_person(*poses) == drawn[name]).all()
        for slot, name in enumerate(("hall", "lab", "park")):
            look = photo_appearance(np.random.default_rng(1), [name])
            three.set_stage(slot, STAGE, PICTURES, appearance=look)
        three.set_stage(1, STAGE, PICTURES, appearance=photo_appearance(np.random.default_rng(1), ["venice"]))
        for slot, name in enumerate(("hall", "venice", "park")):
            assert (three.first_person(*poses, slots=[slot]) == drawn[name]).all(), name
    assert len(build_assets(1, 64).places) == 1
    assert len(build_assets(40, 64).places) == len(places.names())


def test_a_place_is_drawn_the_same_each_time_and_only_where_it_is_asked_for():
    look = photo_appearance(np.random.default_rng(1), ["hall"])
    pose = [[-1.0, 0.0, 0.75]], [[1.0, 0.0, 0.0, 0.0]]
    with Cameras(2) as cameras:
        cameras.set_stage(0, STAGE, PICTURES)
        before = cameras.first_person(*pose).copy()
        cameras.set_stage(1, STAGE, PICTURES, appearance=look)
        first = cameras.first_person(*pose, slots=[1]).copy()
        assert (cameras.first_person(*pose, slots=[1]) == first).all()
        assert (cameras.first_person(*pose, slots=[0]) == before).all()
        turned = cameras.first_person(*pose, slots=[1], yaw_rates=[5.0]).copy()
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 1000
    assert len(np.unique(before.reshape(-1, 3), axis=0)) < 200
    across = np.abs(np.diff(first.astype(int), axis=2)).mean()
    assert np.abs(np.diff(turned.astype(int), axis=2)).mean() < across


@pytest.mark.parametrize("seed", range(2))
def test_pads_are_seen_on_the_ground_of_a_place(seed):
    look = photo_appearance(np.random.default_rng(seed), ["sunset"])
    red, green, blue = (Gate("big", "round", color) for color in ("red", "green", "blue"))
    frames = []
    with Cameras(1) as cameras:
        for gates in ((red, green, blue), (green, blue, red)):
            stage = Stage(gates, STAGE.labels, landing=True)
            cameras.set_stage(0, stage, PICTURES, appearance=look)
            frames.append(cameras.first_person([[0.0, 0.0, 1.5]], [[1.0, 0.0, 0.0, 0.0]]).copy().astype(int))
    differ = np.abs(frames[0] - frames[1]).max(axis=-1)[0] > 40
    assert [part.sum() > 200 for part in np.array_split(differ, 3, axis=1)] == [True] * 3


def test_a_stage_with_a_board_is_drawn_in_a_place():
    look, board = photo_appearance(np.random.default_rng(1), ["hall"]), np.full((64, 128, 3), 255, np.uint8)
    pose = [[-1.0, 0.0, 0.75]], [[1.0, 0.0, 0.0, 0.0]]
    with Cameras(1) as cameras:
        cameras.set_stage(0, STAGE, PICTURES, appearance=look)
        without = cameras.first_person(*pose).copy()
        cameras.set_stage(0, STAGE, PICTURES, board, look)
        seen = cameras.first_person(*pose).copy()
    changed = (seen != without).any(axis=3).mean()
    assert 0.002 < changed < 0.1, "the board, and nothing else"


def test_one_place_of_ones_own_is_drawn_at_a_time(tmp_path):
    looks = []
    for name, color in (("a", (200, 30, 30)), ("b", (30, 30, 200))):
        panorama(color=color).save(tmp_path / f"{name}.png")
        looks.append(photo_appearance(np.random.default_rng(0), [str(tmp_path / f"{name}.png")]))
    pose = [[-1.0, 0.0, 0.75]], [[1.0, 0.0, 0.0, 0.0]]
    with Cameras(2) as cameras:
        cameras.set_stage(0, STAGE, PICTURES, appearance=looks[0])
        red = cameras.first_person(*pose, slots=[0])[0, -20:].mean(axis=(0, 1))
        with pytest.raises(RenderError, match="one place of your own"):
            cameras.set_stage(1, STAGE, PICTURES, appearance=looks[1])
        cameras.set_stage(0, STAGE, PICTURES, appearance=PLAIN)
        cameras.set_stage(0, STAGE, PICTURES, appearance=looks[1])
        blue = cameras.first_person(*pose, slots=[0])[0, -20:].mean(axis=(0, 1))
    assert red[0] > 2 * red[2]
    assert blue[2] > 2 * blue[0]


@pytest.mark.parametrize(
    ("size", "said"),
    [
        ((1, 1), "takes at least 128x64"),
        ((600, 200), "it is a strip"),
        ((512, 512), "a part of the sphere, or two fish-eye"),
        ((640, 480), "a part of the sphere"),
    ],
)
def test_pictures_that_are_no_panoramas_are_refused_with_the_way_out(tmp_path, size, said):
    Image.new("RGB", size, "grey").save(tmp_path / "mine.jpg")
    with pytest.raises(AppearanceError, match=said):
        places.load_place(str(tmp_path / "mine.jpg"))


def save_with_xmp(pixels: np.ndarray, path: Path, xmp: str) -> None:
    """As phones do; not every version of Pillow that we allow writes XMP."""
    Image.fromarray(pixels).save(path, quality=95)
    segment = b"http://ns.adobe.com/xap/1.0/\0" + xmp.encode()
    data = path.read_bytes()
    path.write_bytes(data[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment + data[2:])


def test_a_part_of_a_sphere_is_drawn_where_its_own_metadata_say(tmp_path):
    strip = np.full((128, 256, 3), (90, 120, 60), np.uint8)
    strip[:, 120:136] = (250, 20, 20)  # a post, a sixteenth of the picture
    values = {"FullPanoWidth": 512, "FullPanoHeight": 256, "CroppedAreaLeft": 128, "CroppedAreaTop": 64}
    values |= {"CroppedAreaImageWidth": 256, "CroppedAreaImageHeight": 128}
    xmp = "<x:xmpmeta xmlns:x='adobe:ns:meta/'>" + " ".join(f'GPano:{k}Pixels="{v}"' for k, v in values.items())
    save_with_xmp(strip, tmp_path / "part.jpg", xmp)
    pixels = places.load_place(str(tmp_path / "part.jpg")).pixels.astype(int)
    post = (pixels[512, :, 0] > 200) & (pixels[512, :, 1] < 80)
    assert np.flatnonzero(post).mean() == pytest.approx(1023.5, abs=4)
    assert post.sum() == pytest.approx(64, abs=6), "half as wide as stretched over everything"
    save_with_xmp(strip, tmp_path / "bad.jpg", xmp.replace('"512"', '"100"'))
    with pytest.raises(AppearanceError, match="does not fit"):
        places.load_place(str(tmp_path / "bad.jpg"))


def test_a_name_that_is_neither_place_nor_file_is_met_with_the_nearest(tmp_path):
    with pytest.raises(AppearanceError, match="did you mean 'warehouse'"):
        places.load_place("wearhouse")


@pytest.mark.parametrize(("value", "said"), [(0, "all black"), (255, "all white"), (90, "all of one colour")])
def test_a_place_of_one_colour_is_refused(tmp_path, value, said):
    Image.new("RGB", (256, 128), (value,) * 3).save(tmp_path / "mine.png")
    with pytest.raises(AppearanceError, match=f"{said}, so it shows no place; take it again"):
        places.load_place(str(tmp_path / "mine.png"))


@pytest.mark.parametrize("dark", [0, 240])
def test_a_place_that_is_almost_black_or_white_is_flown(tmp_path, dark):
    pixels = np.full((128, 256, 3), dark, np.uint8)
    pixels[80:] += 15
    Image.fromarray(pixels).save(tmp_path / "mine.png")
    look = photo_appearance(np.random.default_rng(0), [str(tmp_path / "mine.png")])
    assert np.isfinite([*look.light_direction, *look.ambient_color, *look.light_color]).all()


def test_two_fish_eye_pictures_side_by_side_are_no_panorama(tmp_path):
    y, x = np.mgrid[-1:1:256j, -1:1:256j]
    half = np.where((x**2 + y**2 < 0.98)[..., None], 140, 0).astype(np.uint8).repeat(3, axis=2)
    Image.fromarray(np.hstack([half, half])).save(tmp_path / "mine.jpg")
    with pytest.raises(AppearanceError, match=r"two fish-eye pictures .* export it .* as an equirectangular"):
        places.load_place(str(tmp_path / "mine.jpg"))
    night = np.zeros((256, 512, 3), np.uint8)  # a black sky is no ring around a circle
    night[140:] = 90
    Image.fromarray(night).save(tmp_path / "night.png")
    places.load_place(str(tmp_path / "night.png"))


def test_a_file_of_200_megabytes_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "mine.jpg").open("wb") as file:
        file.write(b"\xff\xd8\xff")
        file.truncate(200_000_000)
    with pytest.raises(AppearanceError, match=r"mine.jpg cannot be read: .*100"):
        places.load_place(str(tmp_path / "mine.jpg"))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"<html>", ""),
        (b"\x76\x2f\x31\x01" + bytes(100), "high dynamic range; save it as PNG or JPEG"),
        (b"#?RADIANCE\n", "high dynamic range; save it as PNG or JPEG"),
        (bytes([0, 0, 0, 24]) + b"ftypisom" + bytes(100), "a video; save one frame of it"),
        (b"RIFF\0\0\0\0AVI ", "a video; save one frame of it"),
    ],
)
def test_files_that_are_no_pictures_are_refused_with_the_way_out_where_their_kind_is_known(tmp_path, content, said):
    (tmp_path / "mine.jpg").write_bytes(content)
    with pytest.raises(AppearanceError, match=rf"panorama .* cannot be read.*{said}"):
        places.load_place(str(tmp_path / "mine.jpg"))


def test_half_floats_of_the_package_of_panoramas_are_mended_when_the_places_are_built():
    for name in places.names():
        pixels = places.load_place(name).pixels.astype(int)
        around = np.stack([np.roll(pixels, shift, axis=(0, 1)) for shift in ((0, 2), (0, -2), (2, 0), (-2, 0))])
        holes = (pixels.max(axis=2) < 8) & (around.min(axis=(0, 3)) > 220)
        assert not holes[4:-4].any(), name


def test_a_place_alone_asks_for_photographs_and_contradictions_are_refused():
    assert Scenario(place="hall").appearance == "photo"
    assert TrackConfig.of(Scenario(appearance="photo")).place == "training"
    with pytest.raises(AppearanceError, match="leave out --appearance varied"):
        Scenario(place="hall", appearance="varied")
    with pytest.raises(AppearanceError, match="there is no place 'hal'"):
        TrackConfig.of(Scenario(place="hal"))


def test_results_know_a_file_by_its_content(tmp_path):
    panorama().save(tmp_path / "mine.png")
    digest = hashlib.sha256((tmp_path / "mine.png").read_bytes()).hexdigest()
    assert places.known_as(str(tmp_path / "mine.png")) == f"sha256:{digest}"
    assert places.known_as("kept") == "kept"
