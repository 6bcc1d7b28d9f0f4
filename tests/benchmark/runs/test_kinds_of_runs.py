"""Runs with the guard, of races, filmed, and of the models that come with the install; in the real simulator."""

import json
from typing import cast

import numpy as np
import pytest
from benchmark_fakes import text_of
from rich.console import Group

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reasoning.reason import ReasonPlan, score_reasoner
from cognitivedrone.benchmark.reports.report import render_report
from cognitivedrone.benchmark.reports.tables import results_table
from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.benchmark.runs.records import read_records
from cognitivedrone.benchmark.runs.runner import command_of, run
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.benchmark.scores.scoring import summarize
from cognitivedrone.errors import RunError
from cognitivedrone.policies.baselines import Hover
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.format import write_tasks
from cognitivedrone.types import (
    ACTION_LIMITS,
    CATEGORIES,
    ActionChunk,
    EpisodeResult,
    GuardReport,
    Observation,
    StageResult,
)


@pytest.mark.parametrize("reasoner", ["none", "oracle"])
def test_a_film_holds_what_every_step_was_flown_by(reasoner):
    config = Plan.of(policy="colour_seeker", reasoner=reasoner, suite="open-v1:smoke")
    job = resolve(config)
    runner = PilotRunner(job)
    try:
        flown, plain = runner.fly(0, film=True), runner.fly(0, film=False)
    finally:
        runner.close()
    # Filming changes nothing of the flight.
    assert flown.result == plain.result
    assert plain.film is None
    film = flown.film
    assert len(film) == flown.result.steps
    task = job.suite.tracks[0][0]
    output = task.instruction if reasoner == "none" else task.directive
    assert {frame.instruction for frame in film} == {output}
    assert all((frame.guidance is None) == (reasoner == "none") for frame in film)
    assert np.diff([frame.time for frame in film]) == pytest.approx(0.1)
    actions = np.array([frame.action for frame in film])
    assert (np.abs(actions) <= ACTION_LIMITS).all()
    assert actions[:, 0].max() > 0.5
    # Frames are copies: the first is not overwritten by the last.
    assert (film[0].image != film[-1].image).any()


class Wild(Hover):
    """Asks for more than any vehicle gets, to the left and to the right in turn."""

    def act(self, observation: Observation) -> ActionChunk:
        side = 9.0 if round(observation.time * 10) % 2 else -9.0
        return np.array([[0.0, side, 0.0, 0.0]], dtype=np.float32)


class Rising(Hover):
    """Leaves the room upwards, slowly enough for every limit."""

    def act(self, observation: Observation) -> ActionChunk:
        return np.array([[0.0, 0.0, min(0.5, observation.time / 2), 0.0]], dtype=np.float32)


@pytest.fixture
def plan(tmp_path) -> Plan:
    return Plan.of(
        policy=f"{__name__}:Wild", reasoner="none", suite="open-v1:smoke", episodes=1, workers=0, clips=0,
        out=tmp_path / "run",
    )  # fmt: skip


def test_the_guard_is_part_of_a_run_and_what_it_changed_is_in_its_rows(plan, tmp_path):
    plain, guarded = plan.changed(out=tmp_path / "plain"), plan.changed(guard=True)
    results = run(guarded, progress=False)
    (episode,) = results.episodes
    assert episode.guard.touched == episode.guard.speed == episode.steps
    assert episode.guard.slew == episode.steps
    assert "--guard" in command_of(guarded)
    assert read_results(guarded.out) == results
    document = json.loads((guarded.out / "results.json").read_text())
    assert document["options"]["guard"] is True
    assert document["episodes"][0]["guard"]["touched"] == episode.steps
    output = [str(row) for row in cast(Group, results_table(results)).renderables]
    assert (
        f"guard: changed {episode.steps} commands in 1 of 1 episodes"
        f" (speed {episode.steps}, slew {episode.steps}, fence 0)"
    ) in output

    unguarded = run(plain, progress=False)
    assert unguarded.episodes[0].guard is None
    document = json.loads((plain.out / "results.json").read_text())
    assert "guard" not in document["options"]
    assert "guard" not in document["episodes"][0]
    assert "--guard" not in command_of(plain)
    # Slewed, it does not swing as wildly.
    assert unguarded.episodes[0].stages[0].path_m > episode.stages[0].path_m
    with pytest.raises(RunError, match="guard"):
        run(plain.changed(guard=True, resume=True), progress=False)


def test_a_policy_that_flies_within_the_limits_flies_as_without_the_guard(plan, tmp_path):
    calm = plan.changed(policy=f"{__name__}:Rising")
    without, guarded = (
        run(calm.changed(guard=guard, out=tmp_path / name), progress=False)
        for guard, name in ((False, "without"), (True, "with"))
    )
    assert guarded.episodes[0].guard == GuardReport()
    assert guarded.episodes[0].stages == without.episodes[0].stages


@pytest.fixture(scope="module")
def raced(tmp_path_factory):
    """Results and records of a race that the oracle flew."""
    out = tmp_path_factory.mktemp("race") / "run"
    config = Plan.of(policy="oracle", suite="open-v1:race", episodes=1, workers=0, out=out, clips=0)
    return run(config, progress=False), read_records(out)


def test_the_oracle_passes_and_the_stages_are_recorded_as_they_stood(raced):
    results, records = raced
    assert results.summary().overall.passed == 5
    (track, *_) = load_suite("open-v1:race").tracks
    assert [stage.only for stage in records[0].trace.stages] == [task.target for task in track]


def test_table_and_report_have_the_race_and_no_chance_of_guessing_right(raced):
    results, records = raced
    table = text_of(results_table(results), 100)
    page = render_report(results, [records[0].trace], [])
    assert "pass|choice" in table
    for text in (table, page):
        assert "racing" in text
        assert "100.0 %" in text
        for word in ("mean of", "random choice"):
            assert word not in text
    assert 'class="chance"' not in page
    assert "Beside the published scores" not in page


def result(category, outcome="passed", chosen=1):
    return StageResult("x", category, category, 1, outcome, chosen, 5.0, 6.0, 1.0, 0.1, 0.1)


def test_races_stand_behind_the_papers_categories_and_outside_their_mean():
    stages = [result("racing")] * 3 + [result("racing", "collision"), result("racing", "timeout", None)]
    stages += [result(category, "wrong_gate", 0) for category in CATEGORIES]
    summary = summarize([EpisodeResult(0, 0, tuple(stages), 1)])
    assert list(summary.categories) == [*CATEGORIES, "racing"]
    assert list(summary.families) == [*CATEGORIES, "racing"]
    assert summary.overall.n == 8
    assert (summary.mean_of_categories.categories, summary.mean_of_categories.rate) == (3, 0.0)
    assert summary.categories["racing"].rate == 0.6
    assert summary.categories["racing"].pass_given_choice == 0.75


def test_the_small_reasoner_knows_the_gate_from_the_first_frame(tmp_path):
    scored = score_reasoner(
        ReasonPlan.of(reasoner="small", suite="open-v1:smoke", out=tmp_path / "answers"), progress=False
    )
    assert len(scored.answers) == 30
    answered = [answer for answer in scored.answers if answer.fault is None]
    assert len(answered) >= 24
    named = [answer for answer in answered if answer.gate is not None]
    assert len(named) >= 20
    assert sum(bool(answer.right.gate) for answer in named) >= 0.95 * len(named)


@pytest.mark.slow
def test_policy_and_reasoner_fly_what_the_policy_alone_does_not_understand(tmp_path):
    tasks = tmp_path / "relations.json"
    every = (task for track in load_suite("open-v1:hard").tracks for task in track)
    write_tasks(tasks, (task for task in every if task.family == "relations"))
    rates = {}
    for reasoner in ("none", "small"):
        plan = Plan.of(policy="small", reasoner=reasoner, tasks=tasks, out=tmp_path / reasoner, clips=0)
        rates[reasoner] = run(plan, progress=False).summary().overall.rate
    assert rates["small"] >= 0.8
    assert rates["small"] - rates["none"] >= 0.2


def test_policy_and_reasoner_pass(tmp_path):
    plan = Plan.of(
        policy="small", reasoner="small", suite="open-v1:smoke", episodes=2, out=tmp_path / "run", clips=0, workers=0
    )
    assert run(plan, progress=False).summary().overall.passed == 2


def test_the_racer_races(tmp_path):
    race = Plan.of(
        policy="race", reasoner="none", suite="open-v1:race", episodes=1, out=tmp_path / "race", clips=0, workers=0
    )
    assert run(race, progress=False).summary().overall.pass_given_choice >= 0.8
