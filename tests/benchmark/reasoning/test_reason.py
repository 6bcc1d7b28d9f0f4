import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import benchmark_fakes
import numpy as np
import pytest
import reason_fakes

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reasoning.reason import ReasonPlan, ReasonResults, score_reasoner, views
from cognitivedrone.benchmark.reasoning.reason_scoring import calibration_error, judge, summarize_answers
from cognitivedrone.benchmark.reasoning.reason_table import reason_table
from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.benchmark.runs.runner import Interrupted
from cognitivedrone.benchmark.scores.results import encode
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import PolicyError, ReasonerFault, RunError
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import Gate
from cognitivedrone.world import geometry

GATES = (Gate("big", "square", "green"), Gate("small", "triangle", "red"), Gate("small", "round", "blue"))


@pytest.fixture
def config(tmp_path: Path) -> ReasonPlan:
    """Six tasks."""
    return ReasonPlan.of(suite="open-v1:smoke", episodes=6, out=tmp_path / "reason")


def asked(config: ReasonPlan) -> ReasonResults:
    return score_reasoner(config, progress=False)


def lasting(results: ReasonResults) -> list:
    """What must be the same on every repetition."""
    return [replace(answer, seconds=0.0) for answer in results.answers]


def text_of(results: ReasonResults) -> str:
    return benchmark_fakes.text_of(reason_table(results))


@pytest.mark.parametrize(
    ("directive", "gate", "color", "shape", "size", "everything"),
    [
        ("Fly through the small red triangle gate", True, True, True, True, True),
        ("Go to the red triangle", True, True, True, None, False),
        ("Fly through the triangular one with the green hat", True, None, True, None, False),
        ("Fly through the small gate", False, None, None, True, False),
        ("Go to the red circle", False, True, False, None, False),
        ("Fly through the big green square gate", False, False, False, False, False),
        ("I cannot tell", False, None, None, None, False),
        (None, False, None, None, None, False),
    ],
)
def test_a_directive_is_judged_by_what_it_says(directive, gate, color, shape, size, everything):
    right = judge(directive, GATES, 1)
    assert (right.gate, right.color, right.shape, right.size) == (gate, color, shape, size)
    assert right.all is everything


def test_the_oracle_is_always_right(config):
    results = asked(config)
    overall = results.summary.overall
    assert (overall.n, overall.right, overall.complete, overall.index_right) == (6, 6, 1.0, 6)
    assert overall.faults == {}
    assert sum(score.n for score in results.summary.families.values()) == 6
    tasks = [task for (task,) in load_suite("open-v1:smoke").tracks[:6]]
    assert [(answer.task, answer.instruction) for answer in results.answers] == [(t.id, t.instruction) for t in tasks]


def test_a_noisy_oracle_is_wrong_in_the_same_tasks_every_time(config, tmp_path):
    first = asked(config.changed(reasoner="noisy-oracle:0.5"))
    again = asked(config.changed(reasoner="noisy-oracle:0.5", out=tmp_path / "again"))
    other = asked(config.changed(reasoner="noisy-oracle:0.5", out=tmp_path / "other", seed=1))
    assert lasting(first) == lasting(again)
    assert 0 < first.summary.overall.right < 6
    assert [a.directive for a in first.answers] != [a.directive for a in other.answers]
    assert {a.image_sha256 for a in first.answers}.isdisjoint(a.image_sha256 for a in other.answers)


def test_a_replay_of_faults_has_the_same_faults(config, tmp_path):
    first = asked(config.changed(reasoner="reason_fakes:Overcounter"))
    assert first.summary.overall.faults == {"no_such_gate": 3}
    assert first.summary.overall.right == 3
    replayed = asked(config.changed(reasoner=f"replay:{first.out / 'reason.jsonl'}", out=tmp_path / "replayed"))
    assert replayed.summary.overall == first.summary.overall
    assert "faults, counted as not right: no such gate 3; the first at open-v1:smoke/0000" in " ".join(
        text_of(first).split()
    )


def test_what_is_no_answer_is_counted_and_written_and_the_next_task_is_asked(config):
    nonsense = asked(config.changed(reasoner="reason_fakes:Boaster"))
    assert nonsense.summary.overall.faults == {"schema": nonsense.summary.overall.n}
    assert "the confidence is 2.0; expected a number from 0 to 1" in (nonsense.out / "reason.jsonl").read_text()


@pytest.mark.parametrize("look", ["plain", "varied"])
def test_it_sees_what_a_flight_of_the_same_seed_sees_first(config, look):
    answer = asked(config.changed(appearance=look, seed=5, episodes=2)).answers[1]
    run = Plan.of(policy="oracle", suite=config.scenario.suite, appearance=look, seed=5)
    runner = PilotRunner(resolve(run))
    film = runner.fly(1, film=True).film
    runner.close()
    assert hashlib.sha256(film[0].image.tobytes()).hexdigest() == answer.image_sha256


def test_free_words_count_for_what_they_say(config):
    overall = asked(config.changed(reasoner="reason_fakes:FreeSpeaker")).summary.overall
    assert (overall.rate, overall.color, overall.shape, overall.size, overall.complete) == (1.0, 1.0, 1.0, 0.0, 0.0)
    assert overall.index_given == 0


def test_the_last_answer_of_several_frames_counts_and_a_later_fault_takes_nothing_back(config, tmp_path):
    stumbler = config.changed(reasoner="reason_fakes:Stumbler", episodes=2)
    assert asked(replace(stumbler, frames=2)).summary.overall.faults == {"timeout": 2}
    assert asked(replace(stumbler, frames=4, out=tmp_path / "four")).summary.overall.right == 2
    each = asked(config.changed(reasoner="noisy-oracle:0.5,each", frames=1, out=tmp_path / "one"))
    later = asked(config.changed(reasoner="noisy-oracle:0.5,each", frames=3, out=tmp_path / "three"))
    assert [a.directive for a in each.answers] != [a.directive for a in later.answers]


def test_a_track_is_reported_as_in_flight(config):
    tracks = config.changed(reasoner="reason_fakes:Rememberer", suite="open-v1:track", episodes=2)
    results = asked(tracks)
    assert [(a.episode, a.stage) for a in results.answers] == [(e, s) for e in range(2) for s in range(5)]
    reported = [word.split() for word in reason_fakes.LOG]
    assert [word[0] for word in reported] == 10 * ["reset", "refine"]
    assert [int(word[1]) for word in reported[::2]] == 2 * [0, 1, 2, 3, 4]
    first, second = ({word[2] for word in reported[10 * episode : 10 * episode + 10 : 2]} for episode in range(2))
    assert len(first) == len(second) == 1
    assert first != second


def test_later_stages_are_looked_at_from_their_own_start_boxes():
    simulator = Simulator(1)
    track_runner = TrackRunner(simulator.world(0), load_pack("open-v1"), TrackConfig())
    suite = load_suite("open-v1:track")
    low, high = (geometry.START + sign * geometry.START_HALF_EXTENT for sign in (-1, 1))
    starts = []
    for view in views(track_runner, suite, 0, episode_rng(suite.digest, 0, 0)):
        stage, task = view.truth.stage, suite.tracks[0][view.index]
        assert (view.truth.task, stage.gates) == (task, task.gates)
        first, second = view.look(), view.look()
        state = view.truth.state()
        local = world_to_heading(state.position[:2] - np.array(stage.origin), stage.yaw)
        starts.append((*local, state.position[2]))
        assert (low[:2] <= local).all()
        assert (local <= high[:2]).all()
        assert yaw_of(state.quaternion) == pytest.approx(np.arctan2(np.sin(stage.yaw), np.cos(stage.yaw)), abs=1e-3)
        assert simulator.time(0) == pytest.approx(0.5)
        # The drone hovers: the scene hardly moves.
        assert np.abs(first.astype(int) - second).mean() < 2
        if view.index:
            assert stage.origin != (0.0, 0.0)
    simulator.close()
    assert len(set(starts)) == len(suite.tracks[0])


def test_what_is_written_is_what_was_scored(config):
    results = asked(config.changed(reasoner="noisy-oracle:0.5", appearance="varied"))
    document = json.loads((results.out / "reason.json").read_text())
    assert document["scores"] == encode(results.summary)
    assert document["suite"]["name"] == "open-v1:smoke"
    assert document["options"]["appearance"] == "varied"
    assert document["platform"]["command"] == (
        "cognitivedrone reason --suite open-v1:smoke --seed 0 --appearance varied"
        " --reasoner noisy-oracle:0.5 --episodes 6"
    )
    lines = [json.loads(line) for line in (results.out / "reason.jsonl").read_text().splitlines()]
    assert lines == [encode(answer) for answer in results.answers]


def test_answers_are_not_thrown_away_unasked(config):
    asked(config)
    with pytest.raises(RunError, match="already contains answers; give --overwrite"):
        asked(config)
    assert asked(config.changed(episodes=2, overwrite=True)).summary.overall.n == 2
    assert len((config.out / "reason.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
def test_answers_are_not_written_through_a_link(config, tmp_path, link):
    theirs = tmp_path / "theirs"
    theirs.write_text("precious")
    config.out.mkdir(parents=True)
    link(config.out / "reason.jsonl", theirs)
    asked(config.changed(episodes=2, overwrite=True))
    assert theirs.read_text() == "precious"
    assert len((config.out / "reason.jsonl").read_text().splitlines()) == 2


def test_ctrl_c_keeps_the_answers(config):
    with pytest.raises(Interrupted, match=r"stopped after 2 answers, all kept in .*reason\.jsonl"):
        asked(config.changed(reasoner="reason_fakes:Interrupted"))
    assert len((config.out / "reason.jsonl").read_text().splitlines()) == 2
    assert not (config.out / "reason.json").exists()


def test_the_table_names_suite_and_reasoner_and_fits_into_a_terminal(config):
    text = text_of(asked(config))
    assert "open-v1:smoke: reasoner oracle" in text
    assert "…" not in text
    assert "answers that report the gate's index: 6, of them right: 6" in text
    assert "(median)" in text
    assert "expected calibration error of 6 confidences: 0.0 %" in text


def test_nothing_asked_nothing_scored():
    summary = summarize_answers([])
    assert (summary.overall.rate, summary.overall.ci95, summary.median_s) == (None, None, None)
    assert (summary.rated, summary.calibration_error) == (0, None)


def test_confidences_that_mean_what_they_say_have_no_calibration_error():
    assert calibration_error([0.75] * 4, [True, True, True, False]) == pytest.approx(0)
    assert calibration_error([1.0, 1.0], [True, False]) == pytest.approx(0.5)
    # Each interval of probability is judged alone: too high in one does not make up for too low in another.
    assert calibration_error([0.95] * 2 + [0.5] * 2, [True, False, True, True]) == pytest.approx((0.45 + 0.5) / 2)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"reasoner": "none"}, PolicyError, "none gives no answers to score; name a reasoner"),
        ({"out": Path(__file__)}, RunError, "is a file; give a folder as --out"),
    ],
)
def test_what_cannot_be_asked_is_reported(config, change, error, message):
    with pytest.raises(error, match=message):
        asked(config.changed(**change))


def test_the_reasoner_of_the_docs_answers(config, tmp_path, monkeypatch):
    docs = Path(__file__).parents[3] / "docs"
    (code,) = re.findall(
        r"```python title=\"my_reasoner.py\"\n(.*?)```", (docs / "tutorials" / "extend.md").read_text(), flags=re.DOTALL
    )
    (tmp_path / "my_reasoner.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    results = asked(config.changed(reasoner="my_reasoner:LargestPatch", episodes=3))
    assert all(answer.right.color is not None for answer in results.answers)
    assert all(f"`{kind}`" in (docs / "r1.md").read_text() for kind in get_args(ReasonerFault))


def test_of_a_mission_it_is_asked_about_the_gates_and_not_about_the_landing(config):
    suite = load_suite("open-v3:missions")
    assert [task.landing for task in suite.tracks[1]] == [False, False, False, True]
    answers = asked(config.changed(suite=suite.name, episodes=2)).answers
    tasks = [task for track in suite.tracks[:2] for task in track]
    assert [answer.task for answer in answers] == [task.id for task in tasks if not task.landing]
    assert [answer.instruction for answer in answers] == [task.instruction for task in tasks if not task.landing]
