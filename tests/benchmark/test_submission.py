"""Submissions: made from real runs, tampering is found, and a sample is flown again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.results import read_results
from cognitivedrone.benchmark.runner import run
from cognitivedrone.benchmark.submission import (
    Rate,
    Verified,
    leaderboard,
    read_submission,
    submission_of,
    verify,
    write_submission,
)
from cognitivedrone.cli import main
from cognitivedrone.errors import RunError

STRAIGHT = """
import numpy as np

class Straight:
    def reset(self, context): pass
    def act(self, observation): return np.array([[4.0, 0, 0, 0]])
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole run of a shipped suite."""
    out = tmp_path_factory.mktemp("run") / "smoke"
    run(Plan.of(policy="oracle", suite="open-v1:smoke", workers=0, clips=0, out=out), progress=False)
    return out


@pytest.fixture
def file(folder: Path, tmp_path: Path) -> Path:
    path = tmp_path / "leaderboard" / "mine.json"
    write_submission(path, submission_of([folder], "Mine", "Us"))
    return path


def test_a_submission_holds_the_run_and_is_read_back(folder: Path, file: Path) -> None:
    submission = read_submission(file)
    assert submission == submission_of([folder], "Mine", "Us")
    (made,) = submission.runs
    assert made.overall.n == 30
    assert made.overall.rate == 1.0
    assert made.mean == 1.0
    assert len(made.flown) == 30
    assert made.command.startswith("cognitivedrone bench")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda run: run["overall"].update(passed=29), "scores do not follow"),
        (lambda run: run["flown"][3].__setitem__(0, {"outcome": "timeout", "chosen": None}), "scores do not follow"),
        (lambda run: run["flown"].pop(), "flights are not those of the suite"),
        (lambda run: run["run"]["suite"].update(digest="0" * 64), "other tasks than the suite"),
        (lambda run: run["run"]["suite"].update(name="mine"), "no shipped suite"),
        (lambda run: run["flown"][3].__setitem__(0, {"outcome": "won", "chosen": 1}), "won"),
        (lambda run: run.pop("machine"), "missing"),
    ],
)
def test_tampering_is_found(file: Path, change, said: str) -> None:
    document = json.loads(file.read_text())
    change(document["runs"][0])
    file.write_text(json.dumps(document))
    with pytest.raises(RunError, match=said):
        read_submission(file)


def test_what_cannot_be_submitted(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="printable characters"):
        submission_of([folder], "", "Us")
    with pytest.raises(RunError, match="several runs of open-v1:smoke"):
        submission_of([folder, folder], "Mine", "Us")
    part = tmp_path / "part"
    run(Plan.of(policy="oracle", suite="open-v1:smoke", episodes=1, workers=0, clips=0, out=part), progress=False)
    with pytest.raises(RunError, match="has 1 episodes only"):
        submission_of([part], "Mine", "Us")


def test_a_sample_is_flown_again(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (checked,) = verify(read_submission(file), 2, progress=False)
    assert (checked.flown, checked.equal, checked.passed, checked.submitted) == (2, 2, 2, 2)
    assert checked.verdict == "confirmed"
    main(["verify", str(file), "--sample", "1"])
    assert capsys.readouterr().out == (
        "open-v1:smoke: 1 of 1 stages ended as submitted; 1 passed, 1 submitted as passed: not refuted, but the sample"
        " has too few passes to judge the score; give more than --sample 1\n"
    )
    main(["verify", str(file), "--sample", "8"])
    assert capsys.readouterr().out == (
        "open-v1:smoke: 8 of 8 stages ended as submitted; 8 passed, 8 submitted as passed: confirmed\n"
    )


def test_a_pilot_that_passes_less_often_is_not_confirmed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    submission = submission_of([folder], "Mine", "Us")
    path = tmp_path / "other.json"
    write_submission(path, submission)
    # The submitted pilot is replaced by one that drives into the first thing it meets.
    document = json.loads(path.read_text())
    document["runs"][0]["run"]["policy"] = "random"
    path.write_text(json.dumps(document))
    (checked,) = verify(read_submission(path), 8, progress=False)
    assert checked.passed == 0
    assert checked.verdict == "refuted"
    with pytest.raises(SystemExit, match="1"):
        main(["verify", str(path), "--sample", "7"])
    said = capsys.readouterr().out
    assert "undecided: the sample has too few passes to judge the score; give more than --sample 7" in said


@pytest.mark.parametrize(
    ("passed", "submitted", "p", "verdict"),
    [
        (20, 20, 1.0, "confirmed"),
        (21, 20, 1.0, "confirmed"),
        (0, 0, 1.0, "confirmed"),
        (18, 20, 0.5, "confirmed"),  # of so many, two may be chance
        (12, 20, 0.0078, "refuted"),
        (6, 7, 1.0, "undecided"),
        (0, 7, 0.0156, "undecided"),
        (0, 8, 0.0078, "refuted"),
    ],
)
def test_a_sample_confirms_refutes_or_is_too_small(passed: int, submitted: int, p: float, verdict: str) -> None:
    assert Verified("open-v1:test", 20, 20, passed, submitted, p, ()).verdict == verdict


def test_other_code_of_an_own_policy_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = tmp_path / "steering.py"
    module.write_text(STRAIGHT)
    monkeypatch.syspath_prepend(str(tmp_path))
    plan = Plan.of(policy="steering:Straight", suite="open-v1:smoke", workers=0, clips=0, out=tmp_path / "run")
    run(plan, progress=False)
    file = tmp_path / "mine.json"
    write_submission(file, submission_of([tmp_path / "run"], "Mine", "Us"))
    (checked,) = verify(read_submission(file), 2, progress=False)
    assert checked.verdict == "confirmed"
    module.write_text(STRAIGHT + "# edited\n")
    with pytest.raises(RunError, match=r"policy_code is another file here .*; get the submission's code"):
        verify(read_submission(file), 2, progress=False)
    with pytest.raises(RunError, match=r"contains another run: .*policy_code"):
        run(plan.changed(resume=True), progress=False)


def test_other_weights_are_refused(file: Path) -> None:
    document = json.loads(file.read_text())
    document["runs"][0]["run"]["options"]["model"] = "0" * 64
    file.write_text(json.dumps(document))
    with pytest.raises(RunError, match="model is another file here"):
        verify(read_submission(file), 1, progress=False)


def test_the_leaderboard_is_sorted(folder: Path) -> None:
    good = submission_of([folder], "a|b", "Us", "https://example.org")
    rows = leaderboard([good], ["open-v1:smoke", "open-v1:test"])
    assert rows == [["[a|b](https://example.org)", "Us", "`oracle` (ground truth)", "`none`", "100.0 (89 to 100)", "–"]]


def test_the_leaderboard_counts_runs_with_default_options_alone(folder: Path, tmp_path: Path) -> None:
    windy = tmp_path / "results.json"
    document = json.loads((folder / "results.json").read_text())
    document["options"]["wind_m_s"] = 4.0
    windy.write_text(json.dumps(document))
    submission = submission_of([folder, windy], "Mine", "Us")
    still, moved = submission.runs
    assert still.flown_with()
    assert not still.flown_with(wind_m_s=4.0)
    assert moved.flown_with(wind_m_s=4.0)
    lower = replace(still, overall=Rate(30, 15, 0.5, (0.3, 0.7)))
    for runs, shown in (((moved, lower), "50.0 (30 to 70)"), ((lower, moved), "50.0 (30 to 70)"), ((moved,), "–")):
        assert leaderboard([replace(submission, runs=runs)], ["open-v1:smoke"])[0][4] == shown


def test_a_run_has_its_scores_by_family_and_the_commit_that_flew_it(folder: Path) -> None:
    (made,) = submission_of([folder], "Mine", "Us").runs
    results = read_results(folder)
    flown = results.summary()
    assert {name: score.passed for name, score in made.summary.families.items()} == {
        name: score.passed for name, score in flown.families.items()
    }
    assert made.summary.overall.pass_given_choice == flown.overall.pass_given_choice
    assert made.summary.choices == flown.choices
    assert (made.commit or "none") == results.platform["commit"]


def test_the_command(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mine.json"
    main(["submit", str(folder), "--name", "Mine", "--by", "Us", "--out", str(out)])
    assert "open-v1:smoke: 30 of 30 passed" in capsys.readouterr().out
    assert read_submission(out).name == "Mine"
