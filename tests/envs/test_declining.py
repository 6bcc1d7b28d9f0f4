"""How a stage ends when the pilot says that what is asked for is not there."""

from typing import cast

import numpy as np
import pytest

from cognitivedrone.benchmark.runs.episode import FlightLog
from cognitivedrone.envs.track_runner import DECLINED_S, TrackConfig, TrackRunner
from cognitivedrone.labels import load_pack
from cognitivedrone.policies.expert import Expert
from cognitivedrone.reasoners.oracle import Oracle
from cognitivedrone.sim.gate_monitor import GateEvent, GateMonitor
from cognitivedrone.sim.simulator import DroneWorld
from cognitivedrone.tasks import load_suite, train_task
from cognitivedrone.types import DroneState, EpisodeContext, Event

ABSENT = load_suite("open-v2:absent").tracks[0][0]
ORDINARY = train_task(0)


class World:
    """A drone that stays at the start, in a world with a clock."""

    hull_radius, diverged = 0.1, False

    def __init__(self):
        self.now = 0.0

    def begin(self, stage, scenery, start):
        self.now, self.position = 0.0, np.array(start.position)
        self.place(stage, scenery)

    def place(self, stage, scenery):
        self.gate_monitor = GateMonitor(stage, self.position, self.hull_radius, scenery.aspects)

    def state(self):
        return DroneState(self.position, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))

    def time(self):
        return self.now


def runner(*track, limit=30.0):
    made = TrackRunner(cast(DroneWorld, World()), load_pack(), TrackConfig(time_limit_s=limit))
    made.begin(track, np.random.default_rng(0))
    return made


def wait(made, seconds):
    """The result within this time, if there is one."""
    for _ in range(round(seconds * 10)):
        made.world.now += 0.1
        if (result := made.update(None)) is not None:
            return result
    return None


def test_declining_for_three_seconds_passes_an_absent_task_and_ends_it():
    made = runner(ABSENT)
    made.decline(True)
    result = wait(made, 30)
    assert (result.outcome, result.chosen, result.target) == ("passed", None, None)
    assert result.time_s == pytest.approx(DECLINED_S)
    assert result.gate_distance_m is None
    assert made.finished


def test_only_declining_without_interruption_counts():
    made = runner(ABSENT)
    for _ in range(4):
        made.decline(True)
        assert wait(made, 2.5) is None
        made.decline(False)
        assert wait(made, 0.5) is None
    made.decline(True)
    assert wait(made, 2.0) is None
    made.decline(True)
    assert wait(made, 30).time_s == pytest.approx(15.0)


@pytest.mark.parametrize(
    ("first", "last", "outcome"), [(False, False, "hesitated"), (True, False, "hesitated"), (True, True, "passed")]
)
def test_declining_before_is_not_enough_at_the_time_limit_but_declining_then_is(first, last, outcome):
    made = runner(ABSENT, limit=2.0)
    made.decline(first)
    assert wait(made, 1.0) is None
    made.decline(last)
    result = wait(made, 2.0)
    assert (result.outcome, result.time_s) == (outcome, pytest.approx(2.0))


def test_a_gate_flown_through_is_a_wrong_one_where_none_is_right():
    made = runner(ABSENT)
    made.decline(True)
    result = made.update(GateEvent("gate", 1, 3, 0.2))
    assert (result.outcome, result.chosen) == ("wrong_gate", 1)
    assert runner(ABSENT).update(GateEvent("collision", 0, 3)).outcome == "collision"


@pytest.mark.parametrize("limit", [2.0, 30.0])
def test_declining_an_ordinary_task_is_a_false_alarm(limit):
    made = runner(ORDINARY, limit=limit)
    made.decline(True)
    result = wait(made, 30)
    assert result.outcome == "false_alarm"
    assert result.time_s == pytest.approx(min(limit, DECLINED_S))


def test_on_a_track_the_stage_after_an_absent_one_is_at_the_same_place():
    made = runner(ABSENT, ORDINARY, ABSENT)
    made.decline(True)
    assert wait(made, 5).outcome == "passed"
    assert (made.index, made.stage.origin, made.stage.labels) == (1, (0.0, 0.0), ORDINARY.labels)
    made.update(GateEvent("gate", ORDINARY.target, 3, 0.2))
    assert wait(made, 5) is None
    made.decline(True)
    assert wait(made, 5).outcome == "passed"
    assert [result.outcome for result in made.results] == ["passed"] * 3


def test_a_false_alarm_ends_the_track():
    made = runner(ORDINARY, ABSENT)
    made.decline(True)
    wait(made, 5)
    assert [result.outcome for result in made.results] == ["false_alarm", "not_reached"]


def test_the_benchmark_hears_the_pilot_through_its_log():
    made = runner(ABSENT)
    log = FlightLog(made, keep_frames=False)
    log.note(Event(0.0, "segment", "go"))
    log.note(Event(0.0, "adopted", "Hold position"))
    log.note(Event(0.0, "declined", "go"))
    assert wait(made, 1.0) is None
    log.note(Event(1.0, "resumed", "go"))
    assert wait(made, 4.0) is None
    log.note(Event(5.0, "declined", "go"))
    assert wait(made, 4.0).outcome == "passed"


def test_the_oracles_decline_where_nothing_is_right():
    for task, right in ((ABSENT, True), (ORDINARY, False)):
        context = EpisodeContext(task.instruction, ground_truth=runner(task).truth())
        expert, oracle = Expert(), Oracle()
        expert.reset(context)
        oracle.reset(context)
        guidance = oracle.refine(np.zeros((256, 256, 3), np.uint8), task.instruction)
        assert expert.declines == right
        assert bool(np.abs(expert.command()).max() < 1e-6) == right
        assert (guidance.directive, guidance.gate) == (
            ("Hold position", None) if right else (task.directive, task.target)
        )
