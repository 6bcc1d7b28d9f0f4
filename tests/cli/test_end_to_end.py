"""The whole benchmark through its command: rendered flights, scores, resume, and what is said of mistakes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typed_commands import typed

from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.cli import main
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
    for workers in (1, 2):
        results = flown(tmp_path / str(workers), *GOLD, "--episodes", 3, workers=workers)
        assert results.summary().overall.passed == 3
        assert (tmp_path / str(workers) / "report.html").stat().st_size > 100_000
    assert repeatable(tmp_path / "1") == repeatable(tmp_path / "2")


def test_without_a_directive_the_seeker_flies_well_and_chooses_at_chance(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "colour_seeker", "--clips", 0, "--episodes", 12)
    score = flown(tmp_path / "raw", *arguments).summary().overall
    assert 1 <= score.passed <= 8
    assert score.pass_given_choice == 1.0


def test_the_oracle_flies_tracks_to_their_end(tmp_path):
    arguments = ("--suite", "open-v1:track", "--policy", "oracle", "--episodes", 1, "--clips", 1)
    results = flown(tmp_path / "track", *arguments)
    assert results.summary().overall.passed == 5


def test_a_killed_run_goes_on_where_it_was(tmp_path, capsys):
    task = ("--suite", "open-v1:smoke", "--policy", "oracle", "--episodes", 6, "--clips", 1)
    arguments = ("bench", *task, "--workers", 1, "--out", tmp_path / "run")
    with subprocess.Popen(command(*arguments), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        records = tmp_path / "run" / "episodes.jsonl"
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and not (records.exists() and records.read_bytes().count(b"\n") >= 2):
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    assert 2 <= records.read_bytes().count(b"\n") < 6
    refused(capsys, *arguments)
    assert run(*arguments, "--resume").returncode == 0
    whole = flown(tmp_path / "whole", *task)
    assert repeatable(tmp_path / "run") == repeatable(tmp_path / "whole")
    assert len(whole.episodes) == 6


def test_a_policy_of_ones_own_is_scored(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "own_policy:Straight", "--episodes", 2, "--clips", 0)
    straight = flown(tmp_path / "own", *arguments, PYTHONPATH=str(ROOT / "examples"))
    assert {stage.chosen for episode in straight.episodes for stage in episode.stages} <= {1, None}


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the published tasks and label images are not at hand")
def test_published_tasks_fly_with_their_own_pictures(tmp_path):
    for kind in ("Letters", "Math_desk"):
        results = flown(
            tmp_path / kind,
            *("--tasks", PUBLISHED / "tasks" / f"{kind}.json", "--labels", PUBLISHED / "labels"),
            *("--policy", "colour_seeker", "--reasoner", "oracle", "--episodes", 2),
        )
        assert results.summary().overall.passed == 2


def test_every_label_of_every_suite_can_be_drawn():
    pack = load_pack()
    for name in SUITES:
        suite = load_suite(name, size=300) if name.endswith(":train") else load_suite(name)
        references = {r for track in suite.tracks for task in track for r in (*task.labels, task.board) if r}
        for reference in sorted(references)[::4]:
            assert pack.image(reference).shape == (256, 256, 3)


def test_two_runs_are_compared(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "colour_seeker", "--episodes", 2, "--clips", 0)
    flown(tmp_path / "a", *arguments)
    flown(tmp_path / "b", *arguments, "--reasoner", "oracle")
    assert "McNemar" in typed(["compare", "a", "b"], tmp_path)


TASK: dict[str, Any] = {
    "prompt": "Fly through the gate with the letter A",
    "prompt_simpler": "Fly through the small red round gate",
    "options": ["A", "B", "C"],
    "correct": 1,
    "gates": {
        "1": {"size": "small", "shape": "round", "color": "red"},
        "2": {"size": "big", "shape": "square", "color": "green"},
        "3": {"size": "small", "shape": "triangle", "color": "blue"},
    },
    "background": "room",
}


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What the command says of a mistake; an error that nobody catches would show a traceback."""
    with pytest.raises(SystemExit) as end:
        main(list(map(str, arguments)))
    assert end.value.code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (json.dumps([TASK | {"correct": 4}]), "correct"),
        (json.dumps([TASK | {"options": ["zebr", "B", "C"]}]), "zebr"),  # of which there is no picture
    ],
)
def test_a_malformed_task_is_one_sentence_and_exit_code_2(tmp_path, capsys, text, says):
    file = tmp_path / "Letters.json"
    file.write_text(text)
    (tmp_path / "pictures" / "Letters").mkdir(parents=True)
    for letter in "ABC":
        Image.fromarray(np.full((32, 32, 3), 200, np.uint8)).save(tmp_path / "pictures" / "Letters" / f"{letter}.png")
    said = refused(
        capsys,
        *("bench", "--tasks", file, "--labels", tmp_path / "pictures", "--policy", "hover", "--workers", 1),
        *("--out", tmp_path / "out"),
    )
    assert says in said
    assert len(said.strip().splitlines()) <= 3
