"""Scores of missions: whole flights, path lengths, collisions, clearance, forbidden zones."""

from dataclasses import replace

import numpy as np
import pytest

from cognitivedrone.benchmark.scores.results import encode
from cognitivedrone.benchmark.scores.scoring import summarize
from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.track_runner import FORBIDDEN_M, forbidden_gates
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.families.mission_tasks import GENERATED, typed_missions
from cognitivedrone.types import EpisodeResult, StageResult

MISSIONS = load_suite("open-v3:missions")
DONE = StageResult(
    "x/0", "symbol_understanding", "animals", 0, "passed", 0, 5.0, 8.0, 1.25, 0.3, 0.1, forbidden_s=0.0
)  # fmt: skip


def episode(*stages):
    return EpisodeResult(0, 0, stages, 50)


def missions(*flights):
    return summarize([episode(*flight) for flight in flights]).missions


def test_a_whole_mission_counts_with_its_path_and_any_other_not():
    landed = replace(DONE, path_m=12.0, path_ratio=1.0, clearance_m=0.2)
    hit = replace(DONE, outcome="collision", path_ratio=None, clearance_m=None, obstacle_m=0.0, forbidden_s=0.4)
    never = replace(DONE, outcome="not_reached", path_m=0.0, path_ratio=None, clearance_m=None)
    found = missions((DONE, landed), (DONE, hit, never))
    assert (found.n, found.whole, found.sub_goals, found.done) == (2, 1, 5, 3)
    assert found.spl == pytest.approx((8 / 1.25 + 12) / 20 / 2)
    assert (found.collisions, found.per_100_m) == (1, pytest.approx(100 / 36))
    assert (found.smallest_m, found.forbidden_s, found.forbidden) == (0.0, 0.4, 1)


def test_flights_that_are_no_missions_or_diverged_are_not_counted():
    plain = replace(DONE, forbidden_s=None)
    assert missions((plain, plain)) is None
    assert "missions" not in encode(summarize([episode(plain)]))
    assert "forbidden_s" not in encode(plain)
    assert missions((replace(DONE, outcome="invalid"),)) is None


def test_every_gate_that_a_mission_of_the_suite_forbids_is_known():
    """The second panel of a stage with a forbidden colour fits, too, and is above the gate of that colour."""
    for (_, *stages), track in zip(typed_missions(), MISSIONS.tracks[GENERATED:], strict=True):
        for stage, task in zip(stages, track, strict=True):
            color = stage.partition("!")[2].partition(" ")[0]
            if color:
                assert [task.gates[number].color for number in forbidden_gates(task)] == [color], task.mission
    assert forbidden_gates(MISSIONS.tracks[1][0]) == ()


def test_the_time_near_a_forbidden_gate_is_counted():
    env = CognitiveDroneEnv("open-v3:missions")
    _, info = env.reset(options={"episode": 0, "seed": 0})
    (gate,) = forbidden_gates(info["task"])
    centers = env.track_runner.world.gate_monitor.centers
    assert info["task"].gates[gate].color == "green"
    over, near = False, 0
    while not over:
        aim = centers[gate] - env.truth().state().position
        _, _, terminated, truncated, info = env.step(np.array([*(1.2 * aim / np.linalg.norm(aim)), 0], np.float32))
        over = bool(info["results"]) or terminated or truncated
        near += bool(np.linalg.norm(centers[gate] - env.truth().state().position) < FORBIDDEN_M)
    (result, *_) = info["results"]
    env.close()
    assert result.chosen == gate
    assert result.forbidden_s == pytest.approx(0.1 * near)
    assert result.forbidden_s >= 0.5
