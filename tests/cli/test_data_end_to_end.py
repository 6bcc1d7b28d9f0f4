"""The data engine through its command: collect, verify, convert, replay, and what is said of mistakes."""

import io
import shutil
from contextlib import redirect_stdout

import pytest

from cognitivedrone.cli import main
from cognitivedrone.data.store import Store


def ok(*arguments: object) -> str:
    """What the command prints, in this process."""
    with redirect_stdout(io.StringIO()) as printed:
        main(list(map(str, arguments)))
    return printed.getvalue()


def refused(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> tuple[str, str]:
    """What it prints of a mistake, in this process; an error that nobody catches would show a traceback."""
    with pytest.raises(SystemExit) as end:
        main(list(map(str, arguments)))
    assert end.value.code == code
    return capsys.readouterr()


@pytest.fixture(scope="module")
def two_cameras(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "two"
    ok("collect", "--recipe", "debug", "--episodes", 2, "--workers", 1, "--down-camera", "--out", path)
    return path


def test_a_set_of_two_cameras_is_whole_and_shown(two_cameras, tmp_path):
    assert "intact" in ok("data", "verify", two_cameras)
    assert "two cameras' frames as jpeg" in " ".join(ok("data", "show", two_cameras).split())
    ok("data", "report", two_cameras, "--out", tmp_path / "card.html")
    page = (tmp_path / "card.html").read_text()
    assert "data:image/" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "the same bits" in ok("data", "replay", two_cameras, 1)


@pytest.mark.parametrize("form", ["rlds", "published"])
def test_the_second_camera_travels_or_is_said_to_be_left_out(two_cameras, tmp_path, form):
    said = ok("data", "export", two_cameras, "--to", form, "--out", tmp_path / form)
    left_out = form == "published"
    assert ("frames of the camera that looks down are left out: published has no place for them" in said) == left_out
    ok("data", "import", tmp_path / form, "--from", form, "--out", tmp_path / "back")
    before = {episode.task.id: episode.down for episode in Store.open(two_cameras).episodes()}
    after = {episode.task.id: episode.down for episode in Store.open(tmp_path / "back").episodes()}
    assert after == (dict.fromkeys(before, ()) if left_out else before)


def test_a_run_of_two_cameras_is_not_resumed_with_one(two_cameras, capsys):
    arguments = ("--recipe", "debug", "--episodes", 2, "--resume", "--out", two_cameras)
    said = " ".join(refused(capsys, 2, "collect", *arguments)[1].split())
    assert "holds a data set of another recipe (down_camera: True there, None here)" in said


def test_an_altered_shard_is_named(two_cameras, tmp_path, capsys):
    copy = shutil.copytree(two_cameras, tmp_path / "copy")
    (shard,) = copy.glob("shards/*.parquet")
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    assert shard.name in refused(capsys, 1, "data", "verify", copy)[0]


@pytest.mark.parametrize("what", ["show", "verify", "report"])
def test_a_folder_that_is_no_set_is_said_to_be_none(tmp_path, capsys, what):
    assert "not a data set" in refused(capsys, 2, "data", what, tmp_path)[1]
