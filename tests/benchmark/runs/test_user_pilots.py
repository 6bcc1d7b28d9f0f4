"""Mistakes in users' own policies and reasoners are counted, and the run goes on; in the real simulator."""

import re
import signal

import pytest
import user_pilots
from benchmark_fakes import lasting

from cognitivedrone import evaluate
from cognitivedrone.benchmark.runs.runner import Interrupted
from cognitivedrone.cli import main
from cognitivedrone.control.calls import calling, check_chunk
from cognitivedrone.errors import PolicyError


@pytest.mark.parametrize(
    ("how", "says", "trace"),
    [
        ("raise", r"the policy raised RuntimeError: CUDA out of memory (user_pilots.py, line", "in misbehave"),
        ("interrupt", "the policy raised KeyboardInterrupt: (user_pilots.py, line", "in misbehave"),
        ("array interrupts", "the policy raised KeyboardInterrupt: (user_pilots.py, line", "in __array__"),
        ("nan", "not all of it is a finite number", "check_chunk"),
    ],
)
def test_a_mistake_is_a_policy_error_with_its_traceback(tmp_path, how, says, trace):
    evaluation = evaluate(
        f"user_pilots:Faulty:{how}", episodes=2, workers=0, out=tmp_path / "run", clips=1, progress=False
    )
    assert evaluation.summary.overall.outcomes["policy_error"] == 2
    for episode in evaluation.results.episodes:
        assert says in episode.message
        assert episode.steps == 2
    kept = (tmp_path / "run" / "errors" / "episode-0001.txt").read_text()
    assert trace in kept
    table = " ".join(evaluation.table().split())
    assert table.startswith("every episode ended in an error of the policy: the policy ")
    assert "policy errors, counted as not passed: 2" in table
    assert "all in the folder errors; --fail-fast stops at the first" in table


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ("surrogate", r"the policy raised RuntimeError: no file \udcff.npy\x1b[31m (user_pilots.py, line"),
        ("exit", "the policy raised SystemExit: 0 (user_pilots.py, line"),
        ("cancelled", "the policy raised CancelledError: (user_pilots.py, line"),
        ("end", "the policy raised Ended: (user_pilots.py, line"),
        ("array exits", "the policy raised SystemExit: 3 (user_pilots.py, line"),
        ("array divides", "the policy raised ZeroDivisionError: division by zero (user_pilots.py, line"),
        ("shape", "rate in rad/s; return one action as [[vx, vy, vz, yaw_rate]]"),
        ("words", "the policy returned 'str', not an array of numbers"),
        ("nothing", "the policy returned None, not an array of numbers"),
        ("complex", "not an array of numbers; expected (k, 4) float32, came complex128"),
        ("numbers as text", "the policy returned 'list', not an array of numbers"),
        ("yes and no", "the policy returned 'ndarray', not an array of numbers"),
        ("text in an object", "the policy returned 'ndarray', not an array of numbers"),
        ("too large", "not all of it is a finite number"),
    ],
)
def test_whatever_a_policy_raises_or_returns_is_said_in_words(how, says):
    with pytest.raises(PolicyError, match=re.escape(says)), calling("the policy"):
        check_chunk(user_pilots.Faulty(how).misbehave(None))


def test_a_run_in_which_every_episode_fails_is_written_and_ends_with_exit_code_1(tmp_path, capsys):
    arguments = ["--suite", "open-v1:smoke", "--episodes", "2", "--workers", "0", "--clips", "0"]
    with pytest.raises(SystemExit) as end:
        main(["bench", "--policy", "user_pilots:Faulty", *arguments, "--out", str(tmp_path / "all")])
    assert end.value.code == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "every episode ended in an error of the policy: the policy raised RuntimeError: CUDA out" in printed
    assert (tmp_path / "all" / "results.json").exists()
    main(["bench", "--policy", "user_pilots:FaultyOnce", *arguments, "--out", str(tmp_path / "one")])
    assert lasting(tmp_path / "one")["scores"]["through"]["overall"]["outcomes"]["policy_error"] == 1
    assert "every episode" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "how", ["hang", *(pytest.param(how, marks=pytest.mark.slow) for how in ("quit", "interrupt", "array hangs"))]
)
def test_mistakes_that_take_the_process_or_its_time_are_counted(tmp_path, how):
    evaluate(
        f"user_pilots:Faulty:{how}", episodes=1, workers=1, decision_timeout=1.0, out=tmp_path, clips=0, progress=False
    )
    assert lasting(tmp_path)["scores"]["through"]["overall"]["outcomes"]["policy_error"] == 1


def test_on_a_track_what_was_flown_before_the_mistake_stays(tmp_path):
    evaluation = evaluate("user_pilots:Faulty", "open-v1:track", episodes=1, workers=0, progress=False)
    (episode,) = evaluation.results.episodes
    assert [stage.outcome for stage in episode.stages] == ["policy_error", *["not_reached"] * 4]


@pytest.mark.parametrize("how", ["", "swallow", "exit"])
def test_a_real_ctrl_c_in_a_policy_ends_the_run_whatever_the_policy_makes_of_it(tmp_path, how):
    with pytest.raises(Interrupted, match="stopped after 0 of 2 episodes"):
        evaluate(
            f"user_pilots:Pressed{how and ':' + how}", episodes=2, workers=0, out=tmp_path / "run", clips=0,
            progress=False,
        )  # fmt: skip
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_policy_that_raises_in_its_reports_or_cannot_be_made_does_not_look_like_ctrl_c(tmp_path):
    evaluation = evaluate("user_pilots:Inner", episodes=1, workers=0, progress=False)
    assert evaluation.summary.overall.outcomes["policy_error"] == 1
    for workers in (0, 1):
        with pytest.raises(PolicyError, match="cannot be made: KeyboardInterrupt"):
            evaluate("user_pilots:CannotBeMade", episodes=1, workers=workers, progress=False)


@pytest.mark.parametrize(("how", "fault"), [("text", "schema"), ("surrogate", "garbage"), ("raise", "raised")])
def test_a_reasoner_that_returns_nonsense_is_counted_and_the_policy_flies_on(tmp_path, how, fault):
    evaluation = evaluate(
        "user_pilots:Straight", reasoner=f"user_pilots:Reasons:{how}", episodes=1, workers=0,
        out=tmp_path / "run", clips=1, progress=False,
    )  # fmt: skip
    overall = evaluation.summary.overall
    assert overall.outcomes["policy_error"] == 0
    assert set(overall.reasoner.faults) == {fault}
    assert (tmp_path / "run" / "errors").exists() == (how == "raise")


def test_a_policy_that_needs_a_camera_that_looks_down_has_one_in_the_simulator(tmp_path):
    flown = evaluate(
        "user_pilots:LooksDown", suite="open-v1:smoke", episodes=1, workers=0, out=tmp_path / "run", progress=False
    )
    assert flown.summary.overall.outcomes["policy_error"] == 0
