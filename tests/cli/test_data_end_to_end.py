"""The data engine through its command: collect, kill, resume, verify, convert, replay, and what is said of mistakes."""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from cognitivedrone.cli import main
from cognitivedrone.data.store import Store


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "cognitivedrone", *map(str, arguments)]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=300, check=False)


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


def same_shards(a: Path, b: Path) -> bool:
    names = sorted(path.name for path in (a / "shards").iterdir())
    return names == sorted(path.name for path in (b / "shards").iterdir()) and all(
        (a / "shards" / name).read_bytes() == (b / "shards" / name).read_bytes() for name in names
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "set"
    ok("collect", "--recipe", "debug", "--episodes", 8, "--episodes-per-shard", 4, "--workers", 1, "--out", path)
    return path


def test_a_collected_set_is_whole_and_shown(store, tmp_path):
    assert "intact" in ok("data", "verify", store)
    shown = ok("data", "show", store)
    assert "math_board" in shown.replace(" ", "_")
    ok("data", "report", store, "--out", tmp_path / "card.html")
    page = (tmp_path / "card.html").read_text()
    assert "data:image/" in page
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_two_workers_and_a_killed_run_give_the_same_bytes(store, tmp_path):
    arguments = ("--recipe", "debug", "--episodes", 8, "--episodes-per-shard", 4)
    ok("collect", *arguments, "--workers", 2, "--out", tmp_path / "two")
    assert same_shards(store, tmp_path / "two")
    killed = tmp_path / "killed"
    with subprocess.Popen(
        command("collect", *arguments, "--workers", 1, "--out", killed),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and not list(killed.glob("shards/*.json")):
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGKILL)
    assert run("data", "verify", killed).returncode != 0
    ok("collect", *arguments, "--workers", 1, "--out", killed, "--resume")
    assert same_shards(store, killed)


@pytest.mark.parametrize("form", ["rlds", "lerobot", "published"])
def test_every_format_there_and_back_flies_the_same_flights(store, tmp_path, form):
    ok("data", "export", store, "--to", form, "--out", tmp_path / form)
    ok("data", "import", tmp_path / form, "--from", form, "--out", tmp_path / "back")
    before = {episode.task.id: episode for episode in Store.open(store).episodes()}
    after = {episode.task.id: episode for episode in Store.open(tmp_path / "back").episodes()}
    assert before.keys() == after.keys()
    for name, episode in before.items():
        assert after[name].task == episode.task
        assert after[name].images == episode.images
        assert after[name].action.tobytes() == episode.action.tobytes()
    assert "the same bits" in ok("data", "replay", tmp_path / "back", 2)


@pytest.fixture(scope="module")
def two_cameras(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "two"
    ok("collect", "--recipe", "debug", "--episodes", 2, "--workers", 1, "--down-camera", "--out", path)
    return path


def test_a_set_of_two_cameras_is_whole_and_shown(two_cameras, tmp_path):
    assert "intact" in ok("data", "verify", two_cameras)
    assert "two cameras' frames as jpeg" in " ".join(ok("data", "show", two_cameras).split())
    ok("data", "report", two_cameras, "--out", tmp_path / "card.html")
    assert "the same bits" in ok("data", "replay", two_cameras, 1)


@pytest.mark.parametrize("form", ["rlds", "lerobot", "mcap", "published"])
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


def test_an_altered_shard_is_named(store, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(store, copy)
    shard = sorted(copy.glob("shards/*.parquet"))[1]
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    assert shard.name in refused(capsys, 1, "data", "verify", copy)[0]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("data", "export", "STORE", "--to", "rlsd"), "did you mean 'rlds'"),
        (("data", "import", "STORE", "--from", "lerobto"), "did you mean 'lerobot'"),
        (("data", "import", "no/such", "--from", "rlds"), "no/such"),
    ],
)
def test_a_mistake_is_one_sentence_and_exit_code_2(store, tmp_path, capsys, arguments, says):
    words = (store if word == "STORE" else word for word in arguments)
    assert says in refused(capsys, 2, *words, "--out", tmp_path / "out")[1]


def test_a_folder_with_another_set_is_left_alone(store, capsys):
    before = (store / "manifest.json").read_bytes()
    refused(capsys, 2, "collect", "--recipe", "debug", "--episodes", 8, "--out", store)
    said = refused(capsys, 2, "collect", "--recipe", "paper", "--episodes", 8, "--out", store, "--resume")
    assert "another" in said[1]
    assert (store / "manifest.json").read_bytes() == before


@pytest.mark.parametrize("what", ["show", "verify", "report"])
def test_a_folder_that_is_no_set_is_said_to_be_none(tmp_path, capsys, what):
    assert "not a data set" in refused(capsys, 2, "data", what, tmp_path)[1]
