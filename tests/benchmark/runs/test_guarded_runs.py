"""Runs with the guard: part of their identity, counted in their rows, and told below the table."""

import json
from typing import cast

import numpy as np
import pytest
from rich.console import Group

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports.tables import results_table
from cognitivedrone.benchmark.runs.runner import command_of, run
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.errors import RunError
from cognitivedrone.policies.baselines import Hover
from cognitivedrone.types import ActionChunk, GuardReport, Observation


class Wild(Hover):
    """Asks for more than any vehicle gets, to the left and to the right in turn."""

    def act(self, observation: Observation) -> ActionChunk:
        side = 9.0 if round(observation.time * 10) % 2 else -9.0
        return np.array([[0.0, side, 0.0, 0.0]], dtype=np.float32)


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
    calm = plan.changed(policy="hover")
    without, guarded = (
        run(calm.changed(guard=guard, out=tmp_path / name), progress=False)
        for guard, name in ((False, "without"), (True, "with"))
    )
    assert guarded.episodes[0].guard == GuardReport()
    assert guarded.episodes[0].stages == without.episodes[0].stages
