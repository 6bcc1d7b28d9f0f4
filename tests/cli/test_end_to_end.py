"""The benchmark and the data engine through their commands: flights, scores, sets, and what is said of mistakes."""

import io
import json
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest
from typed_commands import typed

from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.cli import main
from cognitivedrone.data.store import Store
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import SUITES, load_suite

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED = ROOT.parent / "shared" / "upstream"


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "cognitivedrone", *map(str, arguments)]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=300, check=False)


def bench(out: Path, *arguments: object):
    done = run("bench", "--out", out, *arguments)
    assert done.returncode == 0, done.stderr
    return read_results(out / "results.json")


def flown(out: Path, *arguments: object, workers: int = 0, **environment: str):
    """By the command, in this process."""
    typed(["bench", "--out", out, "--workers", workers, *arguments], out.parent, **environment)
    return read_results(out / "results.json")


def repeatable(out: Path):
    results = json.loads((out / "results.json").read_text())
    return {key: value for key, value in results.items() if key not in ("timing", "platform")}


GOLD = ("--suite", "open-v1:smoke", "--policy", "colour_seeker", "--reasoner", "oracle", "--clips", 1)


@pytest.mark.slow
def test_the_whole_smoke_suite_with_the_gold_directive(tmp_path):
    assert bench(tmp_path / "whole", *GOLD).summary().overall.passed >= 29


def test_the_gold_directive_on_any_number_of_workers(tmp_path):
    for workers in (0, 2):
        results = flown(tmp_path / str(workers), *GOLD, "--episodes", 2, workers=workers)
        assert results.summary().overall.passed == 2
        assert (tmp_path / str(workers) / "report.html").stat().st_size > 100_000
    assert repeatable(tmp_path / "0") == repeatable(tmp_path / "2")


def test_without_a_directive_the_seeker_flies_well_and_chooses_at_chance(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "colour_seeker", "--clips", 0, "--episodes", 6)
    score = flown(tmp_path / "raw", *arguments).summary().overall
    assert 1 <= score.passed <= 4
    assert score.pass_given_choice == 1.0


def test_a_policy_of_ones_own_is_scored(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "own_policy:Straight", "--episodes", 1, "--clips", 0)
    straight = flown(tmp_path / "own", *arguments, PYTHONPATH=str(ROOT / "examples"))
    assert {stage.chosen for episode in straight.episodes for stage in episode.stages} <= {1, None}


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the published tasks and label images are not at hand")
def test_published_tasks_fly_with_their_own_pictures(tmp_path):
    for kind in ("Letters", "Math_desk"):
        results = flown(
            tmp_path / kind,
            *("--tasks", PUBLISHED / "tasks" / f"{kind}.json", "--labels", PUBLISHED / "labels"),
            *("--policy", "colour_seeker", "--reasoner", "oracle", "--episodes", 1),
        )
        assert results.summary().overall.passed == 1


def test_every_label_of_every_suite_can_be_drawn():
    pack, tasks = load_pack(), [task for name in SUITES for track in load_suite(name).tracks for task in track]
    references = {reference for task in tasks for reference in (*task.labels, task.board) if reference}
    for reference in sorted(references)[::8]:
        assert pack.image(reference).shape == (256, 256, 3)


def test_two_runs_are_compared(tmp_path):
    flown(tmp_path / "a", "--suite", "open-v1:smoke", "--policy", "oracle", "--episodes", 1, "--clips", 0)
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    assert "McNemar" in typed(["compare", "a", "b"], tmp_path)


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
