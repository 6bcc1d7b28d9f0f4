"""Nothing in a data set decides where its files go, and nothing in one that is imported is waited for or unpacked."""

import io
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
import pytest
from factory import make_episode
from PIL import Image
from tests.test_pictures import png_of

from cognitivedrone.collect.replay import import_set
from cognitivedrone.data.episode import Episode
from cognitivedrone.data.formats import EXPORTS, export, import_, lerobot, rlds
from cognitivedrone.data.formats.exchange import check_image, check_size
from cognitivedrone.data.store import Store
from cognitivedrone.errors import DataError

EVIL = (
    "../x", "../../../../tmp/x", "/etc/x", "a/b", "..", "", "a\x00b", "a\nb",
    "x" * 300,
    "\uff0e\uff0e\uff0fx",
    "[/f]",
)  # fmt: skip
FORMATS = ("rlds", "lerobot", "published", "mcap")


def evil_episode(name: str, index: int = 0) -> Episode:
    """A flight all of whose texts are that name."""
    episode = make_episode(index, 2, encoding="jpeg")
    task = replace(episode.task, id=name, family=name, instruction=name, background=name)
    conditions = replace(episode.conditions, airframe=name, look=name)
    return replace(episode, suite=name, task=task, conditions=conditions)


def everything(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


@pytest.mark.parametrize("name", EVIL, ids=ascii)
def test_an_export_stays_in_its_folder(tmp_path, to, name):
    inner = tmp_path / "a" / "b" / "c"
    inner.mkdir(parents=True)
    assert export([("train", evil_episode(name)), ("train", evil_episode("tame", 1))], to, inner / "out") == 2
    assert everything(tmp_path) - {"a", "a/b", "a/b/c"} == {
        f"a/b/c/out{path}" for path in ("", *(f"/{path}" for path in everything(inner / "out")))
    }
    assert all(path.resolve().is_relative_to(inner / "out") for path in (inner / "out").rglob("*"))


def test_a_published_folder_is_called_after_its_family(tmp_path):
    families = ["../x", "a/b", "a_b", "my family", "math_board"]
    export([("train", evil_episode(name, index)) for index, name in enumerate(families)], "published", tmp_path / "out")
    names = {path.name.partition("-")[0] for path in (tmp_path / "out").iterdir()}
    assert names == {"_X", "A_B", "My Family", "Math_desk"}
    assert len(list((tmp_path / "out").iterdir())) == len(families)


def test_a_text_that_has_no_encoding_is_one_sentence(tmp_path, to):
    with pytest.raises(DataError, match="cannot be written, a text of the data has no UTF-8"):
        export([("train", evil_episode("\ud800"))], to, tmp_path / "out")
    assert not everything(tmp_path)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("name", [name for name in EVIL if name.isprintable() and name], ids=ascii)
def test_an_import_stays_in_its_folder_and_goes_out_again(tmp_path, form, name):
    export([("train", evil_episode(name))], form, tmp_path / "set")
    before = everything(tmp_path)
    assert import_set(tmp_path / "set", form, tmp_path / "store") == 1
    assert all(path.startswith("store") for path in everything(tmp_path) - before)
    assert export(Store.open(tmp_path / "store").labelled(), "published", tmp_path / "again") == 1
    assert {path.partition("/")[0] for path in everything(tmp_path)} == {"set", "store", "again"}


@pytest.mark.parametrize("form", FORMATS)
def test_texts_of_an_import_are_checked_as_those_of_a_task_file(tmp_path, form):
    export([("train", evil_episode("a\x1b[2Jb"))], form, tmp_path / "set")
    with pytest.raises(DataError, match=r"id contains the control character U\+001B at position 2; remove it"):
        list(import_(tmp_path / "set", form))


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """A small set of every format. For reading only."""
    folder = tmp_path_factory.mktemp("sets")
    for to in EXPORTS:
        export([("train", make_episode(0, 3, encoding="png"))], to, folder / to)
    return folder


@pytest.mark.parametrize("kind", ["pipe", "device", "link", "folder"])
def test_a_file_of_a_set_that_is_none_is_refused_at_once(sets, tmp_path, to, kind):
    form = to.partition("-")[0]
    for name in sorted(path for path in everything(sets / to) if (sets / to / path).is_file()):
        if name in ("README.md", "cognitivedrone/1.0.0/features.json", "meta/stats.json", "meta/tasks.parquet"):
            continue  # for other readers
        copy = tmp_path / name.replace("/", "_")
        shutil.copytree(sets / to, copy)
        (copy / name).unlink()
        if kind == "pipe":
            os.mkfifo(copy / name)
        elif kind == "folder":
            (copy / name).mkdir()
        else:
            (copy / name).symlink_to("/dev/zero" if kind == "device" else tmp_path / "nowhere")
        with pytest.raises(DataError) as refused:
            list(import_(copy, form))
        assert str(copy) in str(refused.value)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("side", [13_300, 30_000])
@pytest.mark.parametrize("form", FORMATS)
def test_a_huge_frame_is_refused_by_its_header(tmp_path, form, side, monkeypatch):
    episode = make_episode(0, 1, encoding="png")
    frame = png_of(side, side)
    if form == "published":
        export([("train", replace(episode, encoding="jpeg", images=(b"\xff\xd8\xff",)))], form, tmp_path / "set")
        (next((tmp_path / "set").rglob("image_1.jpg"))).write_bytes(frame)
    elif form == "lerobot":
        monkeypatch.setattr(lerobot.Statistics, "add", lambda *_: {})
        monkeypatch.setattr(lerobot.Statistics, "total", lambda _: {})
        export([("train", replace(episode, images=(frame,)))], form, tmp_path / "set")
    else:
        export([("train", replace(episode, images=(frame,)))], form, tmp_path / "set")
    with pytest.raises(DataError, match=r"13300 x 13300 pixels; a frame has at most 2048|decompression bomb"):
        list(import_(tmp_path / "set", form))


def test_a_frame_of_16_bits_does_not_become_white(tmp_path):
    buffer = io.BytesIO()
    Image.fromarray(np.full((256, 256), 1000, np.uint16)).save(buffer, "PNG")
    for check in (check_image, check_size):
        with pytest.raises(DataError, match="a frame: has pixels of 16 bits; a frame has 8 bits a colour, so convert"):
            check(buffer.getvalue(), "a frame")


def test_a_huge_video_is_refused_by_its_header(sets, tmp_path):
    shutil.copytree(sets / "lerobot-video", tmp_path / "set")
    video = next((tmp_path / "set").rglob("*.mp4"))
    with av.open(str(video), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = 4096, 64, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((64, 4096, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode(None))
    with pytest.raises(DataError, match=r"has 4096 x 64 pixels; a frame has at most 2048 a side"):
        list(import_(tmp_path / "set", "lerobot"))


def test_a_frame_that_is_too_many_bytes_is_not_read(sets, tmp_path):
    shutil.copytree(sets / "published", tmp_path / "set")
    with next((tmp_path / "set").rglob("image_1.jpg")).open("r+b") as frame:
        frame.truncate(2**40)  # sparse: takes no space
    with pytest.raises(
        DataError, match=r"image_1\.jpg: .* cannot be read \(it has 1,099,511,627,776 bytes, and at most"
    ):
        list(import_(tmp_path / "set", "published"))


@pytest.mark.parametrize("name", ["../../../other/train", "/etc/passwd", "", 3, None])
def test_splits_of_an_rlds_set_are_no_paths(sets, tmp_path, name):
    shutil.copytree(sets / "rlds", tmp_path / "set")
    path = tmp_path / "set" / rlds.NAME / rlds.VERSION / rlds.INFO
    info = json.loads(path.read_text())
    info["splits"][0]["name"] = name
    path.write_text(json.dumps(info))
    with pytest.raises(DataError, match=r"has a split .*; only train and val can be imported"):
        list(import_(tmp_path / "set", "rlds"))


@pytest.mark.parametrize("value", ["../../../x", "/x", -1, None])
def test_file_numbers_of_a_lerobot_set_are_no_paths(sets, tmp_path, value):
    shutil.copytree(sets / "lerobot", tmp_path / "set")
    path = tmp_path / "set" / lerobot.EPISODES_PATH
    rows = [row | {"data/chunk_index": value} for row in pq.read_table(path).to_pylist()]
    pq.write_table(lerobot.pa.Table.from_pylist(rows), path)
    with pytest.raises(DataError, match=r"data/chunk_index is .*; it must be a number from 0"):
        list(import_(tmp_path / "set", "lerobot"))
