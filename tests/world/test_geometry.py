import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.types import SHAPES, SIZES, Gate, Stage
from cognitivedrone.world import geometry

GATES = [Gate(size, shape, "red") for size in SIZES for shape in SHAPES]
THREE = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue"))

gates = st.sampled_from(GATES)
metres = st.floats(-6.0, 6.0)
angles = st.floats(-math.pi, math.pi)


def stage(origin: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0) -> Stage:
    return Stage(gates=THREE, labels=("number/1@inter",) * 3, origin=origin, yaw=yaw)


def test_published_stage():
    np.testing.assert_allclose(geometry.gate_centers(stage()), [[4, 4, 0.9], [5, 0, 0.9], [4, -4, 0.9]])
    np.testing.assert_allclose(np.degrees(geometry.gate_yaws(stage())), [45, 0, -45])


@pytest.mark.parametrize(
    ("gate", "low", "high", "wide"),
    [
        (Gate("big", "round", "red"), 0.15, 1.65, 1.5),
        (Gate("small", "round", "red"), 0.525, 1.275, 0.75),
        (Gate("big", "square", "red"), 0.15, 1.65, 1.5),
        (Gate("small", "square", "red"), 0.525, 1.275, 0.75),
        (Gate("big", "triangle", "red"), 0.467, 1.766, 1.5),
        (Gate("small", "triangle", "red"), 0.683, 1.333, 0.75),
    ],
)
def test_published_openings(gate, low, high, wide):
    outline = geometry.opening_outline(gate)
    heights = outline[:, 1] + geometry.GATE_HEIGHT
    assert heights.min() == pytest.approx(low, abs=1e-3)
    assert heights.max() == pytest.approx(high, abs=1e-3)
    assert np.ptp(outline[:, 0]) == pytest.approx(wide)


@given(origin=st.tuples(metres, metres), yaw=angles, index=st.integers(0, 2), ahead=metres, left=metres, up=metres)
def test_gate_frame_undoes_the_placement(origin, yaw, index, ahead, left, up):
    placed = stage(origin, yaw)
    center, heading = geometry.gate_centers(placed)[index], geometry.gate_yaws(placed)[index]
    outward = np.array([math.cos(heading), math.sin(heading), 0.0])
    sideways = np.array([-math.sin(heading), math.cos(heading), 0.0])
    point = center + ahead * outward + left * sideways + [0.0, 0.0, up]
    np.testing.assert_allclose(geometry.to_gate_frame(point, center, heading), [ahead, left, up], atol=1e-9)
    start = np.array([*origin, geometry.GATE_HEIGHT])
    assert geometry.to_gate_frame(start, center, heading)[0] < -4.9


@given(origin=st.tuples(metres, metres), yaw=angles, index=st.integers(0, 2))
def test_next_stage_starts_where_the_drone_leaves(origin, yaw, index):
    old = stage(origin, yaw)
    following = stage(*geometry.next_stage_origin(old, index))
    heading = geometry.gate_yaws(old)[index]
    leaving = geometry.gate_centers(old)[index] + [math.cos(heading), math.sin(heading), 0.0]
    local = geometry.to_gate_frame(leaving, np.array([*following.origin, 0.0]), following.yaw)
    np.testing.assert_allclose(local[:2], geometry.START[:2], atol=1e-9)
    assert -math.pi <= following.yaw <= math.pi


@given(gate=gates, lateral=metres, vertical=metres)
def test_margin_and_frame_agree_in_the_plane(gate, lateral, vertical):
    margin = float(geometry.opening_margin(gate, lateral, vertical))
    distance = float(geometry.frame_distance(gate, 0.0, lateral, vertical))
    if margin > 0:
        assert distance == pytest.approx(margin)
    elif -margin < geometry.BAR_WIDTH:
        assert distance == 0.0
    else:
        assert distance <= -margin - geometry.BAR_WIDTH + 1e-9 or gate.shape == "round"
        # A mitred corner reaches at most twice the bar's width from the opening's corner.
        assert distance >= -margin - 2 * geometry.BAR_WIDTH - 1e-9


@given(gate=gates, point=st.tuples(metres, metres, metres), step=st.tuples(metres, metres, metres))
def test_distances_never_change_faster_than_the_point_moves(gate, point, step):
    moved = tuple(a + b for a, b in zip(point, step, strict=True))
    reach = math.dist(point, moved) + 1e-9
    assert abs(geometry.frame_distance(gate, *moved) - geometry.frame_distance(gate, *point)) <= reach
    assert abs(geometry.panel_distance(1.5, *moved) - geometry.panel_distance(1.5, *point)) <= reach


@pytest.mark.parametrize("gate", GATES, ids=lambda g: f"{g.size}-{g.shape}")
def test_distance_to_the_frame_against_sampled_bars(gate):
    """Brute force: the nearest of many points of the solid bar, on a grid of query points."""
    reach = np.linspace(-1.3, 1.3, 201)
    y, z = (axis.ravel() for axis in np.meshgrid(reach, reach))
    margin = geometry.opening_margin(gate, y, z)
    corners = geometry.opening_outline(gate, geometry.BAR_WIDTH)
    edges = np.roll(corners, -1, axis=0) - corners
    inside_outer = np.all(
        [(y - c[0]) * e[1] - (z - c[1]) * e[0] <= 0 for c, e in zip(corners, edges, strict=True)], axis=0
    )
    solid = np.column_stack([y, z])[(margin <= 0) & inside_outer]
    rng = np.random.default_rng(0)
    queries = rng.uniform(-2, 2, (200, 2))
    sampled = np.min(np.linalg.norm(queries[:, None] - solid[None], axis=-1), axis=1)
    exact = geometry.frame_distance(gate, 0.0, queries[:, 0], queries[:, 1])
    np.testing.assert_allclose(exact, sampled, atol=0.02)


def test_frame_and_panel_have_depth():
    gate = Gate("big", "square", "red")
    assert geometry.frame_distance(gate, 0.5, 0.8, 0.0) == pytest.approx(0.5 - geometry.BAR_DEPTH / 2)
    middle = geometry.PANEL_CENTER_HEIGHT - geometry.GATE_HEIGHT
    assert geometry.panel_distance(1.0, 0.0, 0.0, middle) == 0.0
    assert geometry.panel_distance(1.0, -0.31, 0.9, middle) == pytest.approx(0.31 - geometry.PANEL_DEPTH / 2)
    assert geometry.panel_distance(1.0, 0.0, 1.4, middle) == pytest.approx(0.4)
    assert geometry.panel_distance(0.5, 0.0, 1.4, middle) == pytest.approx(0.9)
    assert geometry.panel_distance(1.0, 0.0, 0.0, middle - 1.25) == pytest.approx(0.25)
