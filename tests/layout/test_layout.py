"""Random layouts: within their limits, seen and reachable from every start, and one for one seed."""

import itertools
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from cognitivedrone.envs.track_runner import draw_start, stage_of
from cognitivedrone.errors import TaskError
from cognitivedrone.layout import (
    ASIDE_M,
    GATE_HEIGHT,
    GATE_XY,
    GATE_YAWS,
    HIGHEST_M,
    LOWEST_M,
    SWAYS,
    TURNED_RAD,
    draw_layout,
    draw_swaying,
    is_clear,
)
from cognitivedrone.sim.drawing.views import first_person_view
from cognitivedrone.sim.gate_monitor import BOUNDS_HIGH, BOUNDS_LOW, REACH_M, judge
from cognitivedrone.tasks import train_task
from cognitivedrone.tasks.format import task_from_json, task_to_json
from cognitivedrone.types import COLORS, DroneState, Gate, GatePlace, Size, Stage
from cognitivedrone.world import geometry

PUBLISHED: Any = tuple(
    GatePlace(float(x), float(y), GATE_HEIGHT, float(yaw)) for (x, y), yaw in zip(GATE_XY, GATE_YAWS, strict=True)
)
CASES: Any = [
    (tuple(Gate(cast(Size, size), "round", color) for size, color in zip(sizes, COLORS, strict=True)), board, seed)
    for seed, (sizes, board) in enumerate(
        itertools.product(itertools.product(("big", "small"), repeat=3), (False, True))
    )
]


def drawn(case):
    gates, board, seed = case
    return draw_layout(np.random.default_rng(seed), gates, board=board)


def state_at(position):
    position = np.array(position, dtype=np.float64)
    return DroneState(position, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))


def starts(count=12):
    rng = np.random.default_rng(5)
    return [draw_start(rng, 0.16).position for _ in range(count)]


@pytest.mark.parametrize("case", CASES)
def test_a_layout_depends_on_its_seed_alone_and_stays_within_its_limits(case):
    layout = drawn(case)
    assert layout == drawn(case)
    assert layout != draw_layout(np.random.default_rng([case[2], 1]), case[0], board=case[1])
    for gate, place, home, facing in zip(case[0], layout, GATE_XY, GATE_YAWS, strict=True):
        assert np.hypot(place.x - home[0], place.y - home[1]) <= ASIDE_M + 0.01
        assert abs(place.yaw - facing) <= TURNED_RAD + 0.001
        assert LOWEST_M[gate.size] <= place.height <= HIGHEST_M
        assert round(place.x, 2) == place.x


@pytest.mark.parametrize("case", CASES)
def test_panels_are_in_view_side_by_side_and_do_not_hide_the_board(case):
    gates, board, _ = case
    stage = Stage(gates, ("", "", ""), "board" if board else None, layout=drawn(case))
    panels, yaws = geometry.panel_centers(stage), geometry.gate_yaws(stage)
    half = geometry.PANEL_HEIGHT / 2
    for start in starts():
        view = first_person_view(state_at(start))
        boxes = []
        for center, yaw in zip(panels, yaws, strict=True):
            side = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
            corners = [center + a * side + [0, 0, b] for a in (half, -half) for b in (half, -half)]
            boxes.append(view.project(np.array(corners), (256, 256)))
            assert (view.project(center[None], (256, 256)) >= 0).all()
            assert (view.project(center[None], (256, 256)) < 256).all()
        lows, highs = (np.array([edge(box[:, 0]) for box in boxes]) for edge in (np.min, np.max))
        assert lows[1] > highs[0]
        assert lows[2] > highs[1]
        if board:
            x, y, z = geometry.BOARD_CENTER
            low = z - geometry.BOARD_HEIGHT / 2
            edges = view.project(np.array([[x, y + 1.4, low], [x, y - 1.4, low]]), (256, 256))
            for box, first, last in zip(boxes, lows, highs, strict=True):
                hidden = last > edges[0, 0] and first < edges[1, 0] and box[:, 1].min() < edges[0, 1]
                assert not hidden


@pytest.mark.parametrize("case", CASES)
def test_straight_ways_to_a_gate_meet_no_other_gate(case):
    gates, _, _ = case
    stage = Stage(gates, ("", "", ""), layout=drawn(case))
    for target, start in itertools.product(range(3), starts(4)):
        center, yaw = geometry.gate_centers(stage)[target], geometry.gate_yaws(stage)[target]
        axis = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        corners = [np.array(start), center - 0.8 * axis, center + 0.2 * axis]
        path = np.concatenate([a + (b - a) * np.linspace(0, 1, 60)[:, None] for a, b in itertools.pairwise(corners)])
        event = judge(stage, path, 0.05, (1.0, 1.0, 1.0))
        assert (event.kind, event.gate) == ("gate", target)
        assert ((path > BOUNDS_LOW) & (path < BOUNDS_HIGH)).all()
    assert REACH_M == 2.0


def ends_of(layout):
    """The layout with every gate at either end of its way, standing still."""
    for sides in itertools.product((1.0, -1.0), repeat=3):
        a, b, c = (
            replace(p, x=p.x - side * p.sway * np.sin(p.yaw), y=p.y + side * p.sway * np.cos(p.yaw), sway=0.0)
            for p, side in zip(layout, sides, strict=True)
        )
        yield a, b, c


@pytest.mark.parametrize("case", CASES[::4])
def test_gates_that_move_are_slow_and_clear_of_each_other_wherever_they_are(case):
    gates, board, seed = case
    layout = draw_swaying(np.random.default_rng(seed), gates, board=board)
    assert layout == draw_swaying(np.random.default_rng(seed), gates, board=board)
    for place in layout:
        assert SWAYS[0][0] <= place.sway <= SWAYS[1][0]
        assert 2 * np.pi * place.sway / place.period <= SWAYS[1][1] + 0.01
    assert all(is_clear(ends, board=board) for ends in ends_of(layout))


def test_gates_and_panels_move_to_their_left_and_right_in_the_world():
    layout = (PUBLISHED[0], replace(PUBLISHED[1], sway=0.6, period=8.0, phase=0.3), PUBLISHED[2])
    stage = Stage(CASES[0][0], ("", "", ""), None, (1.0, 2.0), 0.7, layout=layout)
    times = np.linspace(0.0, 20.0, 41)
    moved = geometry.gate_centers(stage, times) - geometry.gate_centers(stage)
    assert (moved[:, [0, 2]] == 0.0).all()
    left = np.array([-np.sin(0.7), np.cos(0.7), 0.0])
    np.testing.assert_allclose(moved[:, 1], 0.6 * np.sin(2 * np.pi * times / 8.0 + 0.3)[:, None] * left, atol=1e-12)
    apart = np.diff(geometry.gate_centers(stage, np.array([2.999, 3.001])), axis=0)[0] / 0.002
    np.testing.assert_allclose(geometry.gate_velocities(stage, 3.0), apart, atol=1e-5)
    assert not geometry.gate_velocities(replace(stage, layout=None), 3.0).any()
    names, motion = geometry.moving_parts(stage)
    assert names == ("gate1", "panel1")
    np.testing.assert_allclose(motion.offset(3.0)[0], motion.offset(3.0)[1])
    assert geometry.moving_parts(replace(stage, missing=1)) is None
    assert geometry.moving_parts(replace(stage, only=1))[0] == ("gate1",)
    assert geometry.half_way(stage, 1) == pytest.approx(geometry.half_width(stage, 1) + 0.6)
    assert geometry.half_way(stage, 0) == 0.0


def test_the_published_places_are_clear_and_a_layout_of_them_is_the_published_stage():
    gates = CASES[0][0]
    assert is_clear(PUBLISHED, board=True)
    usual, laid = (Stage(gates, ("", "", ""), None, (1.0, 2.0), 0.7, layout=layout) for layout in (None, PUBLISHED))
    for function in (geometry.gate_centers, geometry.gate_yaws, geometry.panel_centers):
        np.testing.assert_allclose(function(laid), function(usual), atol=1e-12)
    assert (geometry.panel_centers(usual)[:, 2] == geometry.PANEL_CENTER_HEIGHT).all()


@pytest.mark.parametrize(
    "change",
    [
        {"x": 4.5, "y": 2.2, "height": 1.0, "yaw": 0.7},  # before the panel of the gate in the middle
        {"x": 2.9, "y": 5.1, "height": 1.0, "yaw": 0.7},  # out of view
        {"x": 5.5, "y": 1.8, "height": 1.0, "yaw": 0.3},  # too near to it
    ],
)
def test_what_is_not_clear(change):
    assert not is_clear((GatePlace(**change), *PUBLISHED[1:]), board=False)


def test_a_high_panel_before_the_board_hides_it():
    high = (PUBLISHED[0], GatePlace(5.0, 0.0, 1.6, 0.0), PUBLISHED[2])
    assert is_clear(high, board=False)
    assert not is_clear(high, board=True)


def test_the_next_stage_begins_behind_a_gate_of_the_layout():
    layout = (*PUBLISHED[:2], GatePlace(4.5, -3.5, 1.5, -1.0))
    (x, y), yaw = geometry.next_stage_origin(Stage(CASES[0][0], ("", "", ""), layout=layout), 2)
    assert yaw == pytest.approx(-1.0)
    assert (x, y) == pytest.approx((4.5 + 2 * np.cos(1.0), -3.5 - 2 * np.sin(1.0)))


# ---- in tasks


def laid_out(index=0, **change):
    task = task_to_json(train_task(index))
    layout = {str(n): {"x": p.x, "y": p.y, "height": 1.2, "yaw": p.yaw} for n, p in enumerate(PUBLISHED, 1)}
    layout["2"] |= change
    return task | {"layout": layout}


def test_a_task_without_a_layout_is_written_as_before_and_one_with_it_is_read_again():
    assert "layout" not in task_to_json(train_task(0))
    assert train_task(0).layout is None
    task = task_from_json(laid_out(), where="here")
    assert task.layout[1] == GatePlace(5.0, 0.0, 1.2, 0.0)
    assert task_from_json(task_to_json(task), where="here") == task
    assert stage_of(task, (1.0, 2.0), 0.5).layout == task.layout


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"height": 0.3}, r"height of gate 2 is 0.3; it must be from 0\.\d to 3 for a (big|small) gate"),
        ({"x": float("nan")}, "x of gate 2 is nan"),
        ({"x": "5"}, "the place of gate 2 must be x, y, height, yaw and, if it moves, sway"),
        ({"z": 5}, "the place of gate 2 must be"),
        ({"y": 6.0}, "from left to right"),
        ({"yaw": 3.0}, "yaw of gate 2 is 3"),
    ],
)
def test_malformed_layouts(change, message):
    with pytest.raises(TaskError, match=message):
        task_from_json(laid_out(**change), where="here")


def test_a_layout_has_three_places():
    for layout in ({}, [], {"1": {}, "2": {}}):
        with pytest.raises(TaskError, match="layout must describe the places of gate 1, 2 and 3"):
            task_from_json(task_to_json(train_task(0)) | {"layout": layout}, where="here")
