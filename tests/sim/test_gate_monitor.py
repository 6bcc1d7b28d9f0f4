"""The gate monitor sees passes, misses, contacts and strays as a marshal at the gate would."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cognitivedrone.sim.gate_monitor import GateEvent, GateMonitor, judge
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate, GatePlace, Landmark, Obstacle, Stage
from cognitivedrone.world import geometry

HULL = 0.13
SQUARE = (1.0, 1.0, 1.0)


def stage_with(gate: Gate, yaw: float = 0.0, origin: tuple[float, float] = (0.0, 0.0)) -> Stage:
    rest = [color for color in COLORS if color != gate.color]
    gates = (gate, Gate("big", "square", rest[0]), Gate("big", "square", rest[1]))
    return Stage(gates, ("letter/A@inter",) * 3, origin=origin, yaw=yaw)


def straight(stage: Stage, gate: int, side: float, rise: float, *, length: float = 2.0, samples: int = 101):
    """A path along the gate's normal, through the point (side, rise) of its plane."""
    yaw = geometry.gate_yaws(stage)[gate]
    normal = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    left = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    middle = geometry.gate_centers(stage)[gate] + side * left + rise * np.array([0.0, 0.0, 1.0])
    return middle + np.linspace(-length / 2, length / 2, samples)[:, None] * normal


gates = st.builds(Gate, st.sampled_from(SIZES), st.sampled_from(SHAPES), st.sampled_from(COLORS))


@given(gate=gates, yaw=st.floats(-3, 3), x=st.floats(-20, 20))
@settings(max_examples=60)
def test_the_centre_of_every_gate_can_be_flown_through(gate, yaw, x):
    stage = stage_with(gate, yaw, (x, -x))
    gate_event = judge(stage, straight(stage, 0, 0.0, 0.0), HULL, SQUARE)
    assert (gate_event.kind, gate_event.gate) == ("gate", 0)
    margin = float(geometry.opening_margin(gate, np.float64(0), np.float64(0)))
    assert gate_event.clearance_m == pytest.approx(margin - HULL)


@given(gate=gates, side=st.floats(-1.9, 1.9), rise=st.floats(-0.7, 0.5))
@settings(max_examples=150)
def test_a_straight_flight_ends_as_the_geometry_of_its_plane_says(gate, side, rise):
    stage = stage_with(gate)
    margin = float(geometry.opening_margin(gate, np.float64(side), np.float64(rise)))
    room = float(geometry.frame_distance(gate, 0.0, side, rise))
    gate_event = judge(stage, straight(stage, 0, side, rise), HULL, SQUARE)
    if margin > HULL + 0.01:
        assert gate_event.kind == "gate"
    elif room < HULL - 0.01:
        assert gate_event.kind == "collision"
    elif margin < 0 and room > HULL + 0.01 and rise < 0.4:
        assert gate_event.kind == "missed"


def ended(stage: Stage, path: np.ndarray) -> tuple[str, int | None] | None:
    event = judge(stage, path, HULL, SQUARE)
    return None if event is None else (event.kind, event.gate)


def test_floor_panel_and_bounds_end_a_flight_and_flying_back_through_a_gate_does_not():
    stage = stage_with(Gate("big", "round", "red"))
    assert ended(stage, straight(stage, 0, 0.0, 0.0)[::-1]) is None
    assert ended(stage, straight(stage, 1, 0.2, 2.0)) == ("collision", 1)
    assert ended(stage, np.column_stack([np.linspace(-1, -6, 80), np.zeros(80), np.ones(80)]))[0] == "out_of_bounds"
    fall = np.column_stack([np.zeros(50), np.zeros(50), np.linspace(1, 0.1, 50)])
    assert ended(stage, fall) == ("collision", None)
    sample = judge(stage, fall, HULL, SQUARE).sample
    assert fall[sample, 2] < HULL <= fall[sample - 1, 2]


@pytest.mark.parametrize("pieces", [1, 7, 25])
def test_following_in_pieces_finds_what_judging_at_once_finds(pieces):
    stage = stage_with(Gate("small", "triangle", "blue"), yaw=0.7, origin=(3.0, 2.0))
    path = straight(stage, 0, 0.01, 0.0, length=6.0, samples=301)
    whole = judge(stage, path, HULL, SQUARE)
    gate_monitor = GateMonitor(stage, path[0], HULL, SQUARE)
    found = None
    for piece in np.array_split(path[1:], pieces):
        found = found or gate_monitor.follow(piece)
    assert (found.kind, found.gate, found.clearance_m) == (whole.kind, whole.gate, whole.clearance_m)
    assert gate_monitor.closest_m[0] < 0.02


def alone(gate: Gate, index: int, yaw: float = 0.0) -> Stage:
    """A stage on which only gate `index` stands, with the looks of `gate`; the places of the others are empty."""
    first, *rest = stage_with(gate).gates
    looks = [*rest[:index], first, *rest[index:]]
    return Stage((looks[0], looks[1], looks[2]), ("number/1@inter",) * 3, yaw=yaw, only=index)


@given(gate=gates, index=st.integers(0, 2), other=st.integers(1, 2), yaw=st.floats(-3, 3))
@settings(max_examples=60)
def test_of_gates_that_are_not_there_nothing_is_seen_but_that_the_only_one_was_passed_by(gate, index, other, yaw):
    stage = alone(gate, index, yaw)
    assert ended(stage, straight(stage, index, 0.0, 0.0)) == ("gate", index)
    absent = (index + other) % 3
    # Along the bar of the absent gate, where a frame would be hit, and on beyond the plane of the only gate.
    path = straight(stage, absent, 0.8, 0.0, length=4.0)
    crosses = (to_only(stage, path)[[0, -1], 0] > 0).tolist() == [False, True]
    assert ended(stage, path) == (("missed", index) if crosses else None)


def to_only(stage: Stage, path: np.ndarray) -> np.ndarray:
    center, yaw = geometry.gate_centers(stage)[stage.only], float(geometry.gate_yaws(stage)[stage.only])
    return geometry.to_gate_frame(path, center, yaw)


def test_a_gate_alone_has_a_frame_to_touch_but_no_panel():
    stage = alone(Gate("big", "square", "red"), 1)
    assert ended(stage, straight(stage, 1, 0.8, 0.0)) == ("collision", 1)
    assert ended(stage, straight(stage, 1, 0.0, 1.85)) == ("missed", 1)


def test_flying_straight_past_a_gate_that_stands_alone_is_a_miss_however_far_beside():
    path = np.column_stack([np.linspace(-1, 8.9, 200), np.zeros(200), np.ones(200)])
    for index in (0, 2):
        gate_monitor = GateMonitor(alone(Gate("big", "round", "red"), index), path[0], HULL, SQUARE)
        event, *_ = filter(None, map(gate_monitor.follow, np.array_split(path[1:], 50)))
        assert (event.kind, event.gate) == ("missed", index)
        assert gate_monitor.favoured() is None


def test_only_the_gate_that_stands_can_be_favoured():
    for index in range(3):
        stage = alone(Gate("big", "round", "red"), index)
        for near, center in enumerate(geometry.gate_centers(stage)):
            gate_monitor = GateMonitor(stage, center - [0.5, 0.0, 0.0], HULL, SQUARE)
            assert gate_monitor.favoured() == (index if near == index else None)


def test_the_gate_monitor_measures_the_way():
    stage = stage_with(Gate("big", "round", "red"))
    gate_monitor = GateMonitor(stage, np.array([-1.0, 0.0, 1.0]), HULL, SQUARE)
    assert gate_monitor.favoured() is None
    assert gate_monitor.follow(np.column_stack([np.linspace(-1, 3.5, 50), np.zeros(50), np.ones(50)])) is None
    assert gate_monitor.path_m == pytest.approx(4.5)
    assert gate_monitor.favoured() == 1


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_contact_with_an_obstacle_ends_the_flight_and_the_smallest_room_is_kept(yaw):
    gates = (Gate("big", "round", "red"), Gate("big", "square", "green"), Gate("big", "square", "blue"))
    pillar, mark = Obstacle("pillar", 1.0, 0.0, 0.4, 2.0), Landmark("animal/cat@noto", 2.0, -2.0, 2.0, 0.0)
    stage = Stage(gates, ("letter/A@inter",) * 3, origin=(3.0, -1.0), yaw=yaw, obstacles=(pillar,), landmark=mark)

    def flown(side: float):
        x = np.linspace(-1.0, 2.5, 300)
        local = np.column_stack([x, np.full(300, side), np.ones(300)])
        path = geometry.rotate_yaw(local, yaw) + np.array([3.0, -1.0, 0.0])
        monitor = GateMonitor(stage, path[0], HULL, SQUARE)
        return monitor, [event for piece in np.array_split(path[1:], 30) if (event := monitor.follow(piece))]

    monitor, events = flown(0.5)
    assert events == []
    assert monitor.obstacle_m == pytest.approx(0.5 - 0.2 - HULL, abs=1e-3)
    monitor, events = flown(0.3)
    assert (events[0].kind, events[0].gate, monitor.obstacle_m) == ("collision", None, 0.0)
    _, events = flown(-2.0)
    assert events[0].kind == "collision"
    plain = GateMonitor(stage_with(gates[0]), np.zeros(3), HULL, SQUARE)
    plain.follow(np.ones((3, 3)))
    assert plain.obstacle_m is None


def test_what_moves_hits_a_drone_that_hovers_beside_it():
    gates = (Gate("big", "round", "red"), Gate("big", "square", "green"), Gate("big", "square", "blue"))
    pillar = Obstacle("pillar", 1.0, 0.0, 0.4, 2.0, sway=1.0, period=8.0)
    stage = Stage(gates, ("letter/A@inter",) * 3, origin=(3.0, -1.0), yaw=0.5, obstacles=(pillar,))
    hover = geometry.rotate_yaw(np.array([1.0, 0.8, 1.0]), 0.5) + np.array([3.0, -1.0, 0.0])
    monitor = GateMonitor(stage, hover, HULL, SQUARE)
    touches = 8.0 / (2 * np.pi) * np.arcsin(0.8 - 0.2 - HULL)  # when its surface reaches the hull
    steps = [(step, monitor.follow(np.tile(hover, (10, 1)), 0.1 * step, 0.1 * (step + 1))) for step in range(20)]
    (first, event), *_ = [(step, event) for step, event in steps if event is not None]
    assert event.kind == "collision"
    assert 0.1 * first + 0.01 * event.sample == pytest.approx(touches, abs=0.011)
    assert monitor.obstacle_m == 0.0


SWAYING = GatePlace(4.0, 0.0, 0.9, 0.3, sway=0.8, period=8.0, phase=0.5)


def swaying(place: GatePlace = SWAYING) -> Stage:
    """A stage whose middle gate moves."""
    gates = (Gate("big", "square", "green"), Gate("big", "round", "red"), Gate("big", "square", "blue"))
    layout = (GatePlace(4.0, 4.0, 0.9, 0.8), place, GatePlace(4.0, -4.0, 0.9, -0.8))
    return Stage(gates, ("letter/A@inter",) * 3, origin=(3.0, -1.0), yaw=0.5, layout=layout)


def through(stage: Stage, time: float) -> tuple[list[GateEvent | None], GateMonitor]:
    """What happens to a drone that flies at 1 m/s through where the middle gate is at a time, and is there then."""
    center, yaw = geometry.gate_centers(stage, time)[1], geometry.gate_yaws(stage)[1]
    normal = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    times = np.linspace(time - 2.0, time + 1.0, 301)
    path = center + (times - time)[:, None] * normal
    monitor = GateMonitor(stage, path[0], HULL, SQUARE, times[0])
    parts = [slice(begin, begin + 11) for begin in range(0, 300, 10)]
    return [monitor.follow(path[part][1:], times[part][0], times[part][-1]) for part in parts], monitor


@pytest.mark.parametrize("time", [2.5, 5.0, 7.0])
def test_a_gate_that_moves_is_flown_through_where_it_is_at_that_time(time: float) -> None:
    events, monitor = through(swaying(), time)
    (event,) = [event for event in events if event is not None]
    assert (event.kind, event.gate) == ("gate", 1)
    assert event.clearance_m == pytest.approx(0.75 - HULL, abs=0.02)
    assert monitor.closest_m[1] == pytest.approx(0.0, abs=0.02)


def test_a_gate_that_moves_is_missed_in_the_middle_of_its_way_while_it_is_at_an_end() -> None:
    stage = swaying(replace(SWAYING, phase=np.pi / 2, period=60.0))  # hardly moves
    monitor = GateMonitor(stage, straight(stage, 1, 0.0, 0.0)[0], HULL, SQUARE)
    event = monitor.follow(straight(stage, 1, 0.0, 0.0), 0.0, 2.0)
    assert event.kind != "gate"


def test_a_gate_that_moves_hits_a_drone_that_hovers_in_its_opening() -> None:
    stage = swaying(replace(SWAYING, phase=0.0))
    yaw = geometry.gate_yaws(stage)[1]
    hover = geometry.gate_centers(stage)[1] - 0.01 * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    monitor = GateMonitor(stage, hover, HULL, SQUARE)
    steps = [(step, monitor.follow(np.tile(hover, (10, 1)), 0.1 * step, 0.1 * (step + 1))) for step in range(30)]
    first, event = next((step, event) for step, event in steps if event is not None)
    assert (event.kind, event.gate) == ("collision", 1)
    touches = 8.0 / (2 * np.pi) * np.arcsin((0.75 - HULL) / 0.8)
    assert 0.1 * first + 0.01 * event.sample == pytest.approx(touches, abs=0.02)
