"""The whole benchmark through its command: rendered flights, scores, resume, and what is said of mistakes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import SUITES, load_suite

ROOT = Path(__file__).resolve().parent.parent
PUBLISHED = ROOT.parent / "shared" / "upstream"
EXAMPLES = {**os.environ, "PYTHONPATH": str(ROOT / "examples")}


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "cognitivedrone", *map(str, arguments)]


def run(*arguments: object, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=300, env=env, check=False)


def bench(out: Path, *arguments: object, env: dict[str, str] | None = None):
    done = run("bench", "--out", out, *arguments, env=env)
    assert done.returncode == 0, done.stderr
    return read_results(out / "results.json")


def repeatable(out: Path):
    results = json.loads((out / "results.json").read_text())
    return {key: value for key, value in results.items() if key not in ("timing", "platform")}


def test_smoke_with_the_gold_directive_and_on_any_number_of_workers(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "colour_seeker", "--reasoner", "oracle")
    results = bench(tmp_path / "whole", *arguments, "--clips", 1)
    assert results.summary().overall.passed >= 29
    assert (tmp_path / "whole" / "report.html").stat().st_size > 100_000
    for workers in (1, 2):
        bench(tmp_path / str(workers), *arguments, "--episodes", 5, "--workers", workers)
    assert repeatable(tmp_path / "1") == repeatable(tmp_path / "2")


def test_without_a_directive_the_seeker_flies_well_and_chooses_at_chance(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "colour_seeker", "--clips", 0)
    score = bench(tmp_path / "raw", *arguments).summary().overall
    assert 3 <= score.passed <= 18
    assert score.pass_given_choice == 1.0


def test_the_oracle_flies_tracks_to_their_end(tmp_path):
    arguments = ("--suite", "open-v1:track", "--policy", "oracle", "--episodes", 2, "--clips", 1)
    results = bench(tmp_path / "track", *arguments)
    assert results.summary().overall.passed == 10


def test_single_tasks_can_be_chained_into_tracks(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "oracle", "--track", "--episodes", 1, "--clips", 0)
    results = bench(tmp_path / "t", *arguments)
    assert results.summary().overall.passed == 5


def test_a_killed_run_goes_on_where_it_was(tmp_path):
    flown = ("--suite", "open-v1:smoke", "--policy", "oracle", "--episodes", 12, "--clips", 2)
    arguments = ("bench", *flown, "--workers", 1, "--out", tmp_path / "run")
    with subprocess.Popen(command(*arguments), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        records = tmp_path / "run" / "episodes.jsonl"
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and not (records.exists() and records.read_bytes().count(b"\n") >= 5):
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    assert 5 <= records.read_bytes().count(b"\n") < 12
    assert run(*arguments).returncode == 2
    assert run(*arguments, "--resume").returncode == 0
    whole = bench(tmp_path / "whole", *flown, "--workers", 2)
    assert repeatable(tmp_path / "run") == repeatable(tmp_path / "whole")
    assert len(whole.episodes) == 12


def test_a_policy_of_ones_own_is_scored(tmp_path):
    straight = bench(
        tmp_path / "own", "--suite", "open-v1:smoke", "--policy", "own_policy:Straight", "--episodes", 4, env=EXAMPLES
    )
    assert {stage.chosen for episode in straight.episodes for stage in episode.stages} <= {1, None}


def test_nan_actions_are_counted_apart(tmp_path):
    (tmp_path / "broken.py").write_text(
        "import numpy as np\n"
        "class Broken:\n"
        "    def reset(self, context): self.steps = 0\n"
        "    def act(self, observation):\n"
        "        self.steps += 1\n"
        "        return np.full((1, 4), np.nan if self.steps > 3 else 0.1, np.float32)\n"
    )
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    out = tmp_path / "nan"
    arguments = ("--suite", "open-v1:smoke", "--policy", "broken:Broken", "--episodes", 2)
    done = run("bench", "--out", out, *arguments, env=env)
    assert done.returncode == 1  # nothing was flown by the policy
    assert "every episode ended in an error of the policy" in done.stdout
    results = read_results(out / "results.json")
    assert results.summary().overall.outcomes["policy_error"] == 2


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the published tasks and label images are not at hand")
def test_published_tasks_fly_with_their_own_pictures(tmp_path):
    for kind in ("Letters", "Math_desk"):
        results = bench(
            tmp_path / kind,
            *("--tasks", PUBLISHED / "tasks" / f"{kind}.json", "--labels", PUBLISHED / "labels"),
            *("--policy", "colour_seeker", "--reasoner", "oracle", "--episodes", 4),
        )
        assert results.summary().overall.passed == 4


def test_every_label_of_every_suite_can_be_drawn():
    pack = load_pack()
    for name in SUITES:
        suite = load_suite(name, size=300) if name.endswith(":train") else load_suite(name)
        references = {r for track in suite.tracks for task in track for r in (*task.labels, task.board) if r}
        for reference in sorted(references)[::4]:
            assert pack.image(reference).shape == (256, 256, 3)


def test_view_draws_a_task(tmp_path):
    done = run("view", "--suite", "open-v1:smoke", "--episode", 2, "--out", tmp_path / "v.png")
    assert done.returncode == 0, done.stderr
    assert np.asarray(Image.open(tmp_path / "v.png")).std() > 20


def test_list_names_what_there_is():
    done = run("list")
    assert done.returncode == 0, done.stderr
    for name in ("open-v1:hard", "colour_seeker", "math_board", "iris"):
        assert name in done.stdout


def test_two_runs_are_compared(tmp_path):
    arguments = ("--suite", "open-v1:smoke", "--policy", "colour_seeker", "--episodes", 4, "--clips", 0)
    bench(tmp_path / "a", *arguments)
    bench(tmp_path / "b", *arguments, "--reasoner", "oracle")
    done = run("compare", tmp_path / "a", tmp_path / "b")
    assert done.returncode == 0, done.stderr
    assert "McNemar" in done.stdout


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


def broken(**changes: object) -> str:
    return json.dumps([{**TASK, **changes}])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (broken(correct=4), "correct"),
        (broken(options=["A", "A", "C"]), "'A'"),
        (broken(gates={**TASK["gates"], "2": TASK["gates"]["1"]}), "colo"),
        (broken(options=["zebr", "B", "C"]), "zebr"),
        ("{", "JSON"),
        ("[]", "holds no task"),
    ],
)
def test_a_malformed_task_is_one_sentence_and_exit_code_2(tmp_path, text, says):
    file = tmp_path / "Letters.json"
    file.write_text(text)
    (tmp_path / "pictures" / "Letters").mkdir(parents=True)
    for letter in "ABC":
        Image.fromarray(np.full((32, 32, 3), 200, np.uint8)).save(tmp_path / "pictures" / "Letters" / f"{letter}.png")
    done = run(
        *("bench", "--tasks", file, "--labels", tmp_path / "pictures", "--policy", "hover", "--workers", 1),
        *("--out", tmp_path / "out"),
    )
    assert done.returncode == 2, done.stdout
    assert says in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) <= 3


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--suite", "open-v1:tset"), "did you mean 'open-v1:test'"),
        (("--policy", "orakel"), "did you mean 'oracle'"),
        (("--reasoner", "orakel"), "did you mean 'oracle'"),
        (("--tasks", "no/such/file.json"), "no/such/file.json"),
        (("--labels", "no/such/folder"), "no/such/folder"),
        (("--airframe", "irish"), "did you mean 'iris'"),
        (("--workers", -1), "worker"),
        (("--episodes", 0), "episode"),
    ],
)
def test_a_mistake_is_one_sentence_and_exit_code_2(tmp_path, arguments, says):
    done = run("bench", "--out", tmp_path / "out", *arguments)
    assert done.returncode == 2, done.stdout
    assert says in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir())


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    done = run("bench", "--suite", "open-v1:smoke", "--policy", "hover", "--out", tmp_path, "--overwrite")
    assert done.returncode == 2
    assert (tmp_path / "precious.txt").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["precious.txt"]
