"""Scores of stages, runs and whole missions."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from cognitivedrone.benchmark.scores.comparison import Paired, mcnemar, pair
from cognitivedrone.benchmark.scores.results import encode
from cognitivedrone.benchmark.scores.scoring import (
    OUTCOMES,
    RULES,
    choices_of,
    mean_of,
    obstacles_of,
    score,
    summarize,
    wilson,
)
from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.track_runner import FORBIDDEN_M, forbidden_gates
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.families.mission_tasks import GENERATED, typed_missions
from cognitivedrone.types import EpisodeResult, StageResult


def stage(outcome="passed", *, category="reasoning", family="math", target=0, chosen=0, distance=0.1, time_s=5.0):
    return StageResult(
        task_id="t", category=category, family=family, target=target, outcome=outcome, chosen=chosen,
        time_s=time_s, path_m=6.0, path_ratio=1.1 if outcome in ("passed", "wrong_gate") else None,
        clearance_m=0.2 if outcome in ("passed", "wrong_gate") else None, gate_distance_m=distance,
    )  # fmt: skip


def test_a_stage_is_one_point_and_only_invalid_physics_is_not_counted():
    ended = [stage(), stage("wrong_gate", chosen=1), stage("policy_error", chosen=None), stage("invalid", chosen=None)]
    result = score([*ended, stage("not_reached", chosen=None, distance=None)])
    assert (result.n, result.passed, result.rate) == (4, 1, 0.25)
    assert result.outcomes["invalid"] == 1
    assert result.outcomes["policy_error"] == 1
    assert result.outcomes["not_reached"] == 1


def test_choice_is_distinguished_from_flying():
    ended = [stage(), stage("collision", chosen=0), stage("wrong_gate", chosen=2), stage("timeout", chosen=None)]
    result = score(ended)
    assert result.choice_accuracy == 0.5
    assert result.pass_given_choice == 0.5


def test_times_and_clearances_are_those_of_passed_stages():
    result = score([stage(time_s=4.0), stage(time_s=5.0), stage(time_s=9.0), stage("timeout", time_s=30.0)])
    assert result.mean_time_s == 6.0
    assert result.median_time_s == 5.0
    assert result.mean_path_ratio == pytest.approx(1.1)
    assert result.mean_clearance_m == pytest.approx(0.2)


def test_the_published_rule_asks_for_one_metre_whatever_ended_the_flight():
    ended = [
        stage("collision", distance=1.0),
        stage("wrong_gate", chosen=1, distance=1.01),
        stage("policy_error", distance=0.2),
        stage("not_reached", chosen=None, distance=None),
    ]
    assert score(ended, "within_1m").passed == 1
    assert score(ended, "through").passed == 0


def test_the_mean_of_categories_weighs_them_equally():
    results = [stage(category="reasoning")] * 9 + [stage("timeout", category="human_recognition", family="people")]
    summary = summarize([EpisodeResult(0, 0, tuple(results), 1)])
    assert summary.overall.rate == 0.9
    assert summary.mean_of_categories.rate == 0.5
    assert summary.mean_of_categories.categories == 2
    for parts in (summary.categories, summary.families):
        assert [(part.n, part.passed) for part in parts.values()] == [(1, 0), (9, 9)]
    assert summary.overall.outcomes["passed"] == 9


def test_choices_stand_by_right_gate_and_gate_flown_at():
    ended = [stage(), stage("wrong_gate", target=2, chosen=0), stage("collision", target=2, chosen=0)]
    ended += [stage("timeout", target=1, chosen=None), stage("policy_error", target=1, chosen=1)]
    uncounted = [stage("invalid", chosen=None), stage("not_reached", chosen=None, distance=None)]
    assert choices_of(ended + uncounted) == ((1, 0, 0, 0), (0, 1, 0, 1), (2, 0, 0, 0))


def test_nothing_to_count_gives_no_rate():
    result = score([stage("invalid")])
    assert (result.n, result.rate, result.ci95, result.choice_accuracy, result.mean_time_s) == (
        0, None, None, None, None,
    )  # fmt: skip
    assert mean_of([result]).rate is None
    assert summarize([]).overall.n == 0


@given(st.integers(1, 2000), st.data())
def test_wilson_is_that_of_scipy(n, data):
    passed = data.draw(st.integers(0, n))
    expected = binomtest(passed, n).proportion_ci(0.95, method="wilson")
    assert wilson(passed, n) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_mcnemar_is_the_exact_binomial():
    # Both tails of a fair coin thrown ten times that shows two heads or fewer.
    assert mcnemar(2, 8) == pytest.approx(2 * sum(math.comb(10, k) for k in range(3)) / 2**10)
    assert mcnemar(8, 2) == mcnemar(2, 8)
    assert mcnemar(0, 0) == 1.0
    assert mcnemar(5, 5) == pytest.approx(1.0)


def test_the_table_of_pairs():
    table = pair([(True, True), (True, False), (False, True), (False, True), (False, False)])
    assert table == Paired(both=1, only_a=1, only_b=2, neither=1)
    assert table.difference == pytest.approx(0.2)


@given(*[st.integers(0, 200)] * 4)
def test_the_interval_of_a_difference_holds_it_and_mirrors(both, only_a, only_b, neither):
    table = Paired(both, only_a, only_b, neither)
    if table.n == 0:
        assert table.ci95 is None
        return
    low, high = table.ci95
    assert -1 - 1e-12 <= low <= table.difference + 1e-12
    assert table.difference - 1e-12 <= high <= 1 + 1e-12
    mirrored = Paired(both, only_b, only_a, neither).ci95
    assert mirrored == pytest.approx((-high, -low), abs=1e-12)


def test_the_interval_of_a_difference_is_the_usual_one_for_many_pairs():
    table = Paired(both=40_000, only_a=10_000, only_b=20_000, neither=30_000)
    n = table.n
    spread = 1.959964 * math.sqrt((table.only_a + table.only_b) / n - table.difference**2) / math.sqrt(n)
    assert table.ci95 == pytest.approx((0.1 - spread, 0.1 + spread), abs=1e-4)


# ---- what is asked for is not there


def absent(outcome, chosen=None):
    return stage(outcome, category="absent", family="absent", target=None, chosen=chosen, distance=None)


def test_an_absent_task_is_passed_by_saying_so_by_either_rule():
    part = [absent("passed"), absent("hesitated"), absent("wrong_gate", 1), absent("collision", 2)]
    for rule in RULES:
        result = score(part, rule)
        assert (result.n, result.passed, result.chosen_right) == (4, 1, 1)
    assert result.outcomes["hesitated"] == 1


def test_absent_is_a_category_beside_the_three_and_not_in_their_mean():
    ordinary = [stage(), stage("wrong_gate", chosen=1)]
    summary = summarize([EpisodeResult(0, 0, (one,), 5) for one in [*ordinary, absent("passed"), absent("hesitated")]])
    alone = summarize([EpisodeResult(0, 0, (one,), 5) for one in ordinary])
    assert summary.mean_of_categories == alone.mean_of_categories
    assert summary.categories["reasoning"] == alone.categories["reasoning"]
    assert summary.categories["absent"].rate == 0.5
    assert summary.choices == alone.choices


def test_false_alarms_are_counted_over_the_stages_whose_answer_is_there():
    flown = [stage(), stage("false_alarm", chosen=None), stage("invalid", chosen=None), absent("passed")]
    summary = summarize([EpisodeResult(0, 0, (one,), 5) for one in flown])
    assert (summary.false_alarms.n, summary.false_alarms.alarms) == (2, 1)
    assert summary.false_alarms.ci95 == wilson(1, 2)
    assert summary.overall.outcomes["false_alarm"] == 1
    assert summarize([EpisodeResult(0, 0, (absent("passed"),), 5)]).false_alarms is None


def test_results_without_any_of_it_are_encoded_as_before():
    written = encode(summarize([EpisodeResult(0, 0, (stage(), stage("timeout", chosen=None)), 5)]))
    assert "false_alarms" not in written
    assert set(written["overall"]["outcomes"]) == set(OUTCOMES) - {"hesitated", "false_alarm"}


def test_obstacles_are_scored_where_there_are_some():
    assert obstacles_of([stage()]) is None
    assert summarize([EpisodeResult(0, 0, (stage(),), 50)]).obstacles is None
    ended = [
        replace(stage(), obstacle_m=0.3), replace(stage("collision"), obstacle_m=0.0),
        replace(stage("collision"), obstacle_m=0.2), replace(stage("invalid"), obstacle_m=0.0), stage("not_reached"),
    ]  # fmt: skip
    found = obstacles_of(ended)
    assert (found.n, found.collisions, found.touched) == (3, 2, 1)
    assert found.per_100_m == pytest.approx(100 * 2 / 18)
    assert (found.smallest_m, found.smallest_passed_m) == (0.0, 0.3)
    assert found.spl == pytest.approx(1 / 1.1 / 3)


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
