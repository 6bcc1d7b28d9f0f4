"""Distances to obstacles, segments that meet them, and ways around them."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cognitivedrone.layout.obstacles import LANDMARK_SIDE, Solids, solids_of
from cognitivedrone.layout.path_planning import ways_to
from cognitivedrone.types import Landmark, Obstacle

PILLAR = Obstacle("pillar", 2.0, 0.0, 0.4, 2.0)
WALL = Obstacle("wall", 2.0, 1.0, 1.0, 0.8, 0.2, np.pi / 2)
BEAM = Obstacle("beam", 3.0, 0.0, 2.0, 0.2, 0.1, 0.0, 1.0)
FRAME = Obstacle("frame", 2.0, 0.0, 1.0, 1.2, 0.1, 0.0, 0.3)
MARK = Landmark("animal/cat@noto", 4.0, 2.0, 2.0, 0.0)
numbers = st.floats(-3, 3)


@pytest.mark.parametrize(
    ("obstacle", "point", "distance"),
    [
        (PILLAR, (1.0, 0.0, 1.0), 0.8),
        (PILLAR, (2.0, 0.0, 2.5), 0.5),
        (PILLAR, (2.3, 0.4, 2.4), 0.5),
        (PILLAR, (2.1, 0.1, 1.0), 0.0),
        (WALL, (3.0, 1.0, 0.4), 0.5),
        (WALL, (2.0, 2.0, 0.4), 0.9),
        (BEAM, (3.0, 0.5, 0.5), 0.5),
        (FRAME, (2.0, 0.0, 0.9), 0.35),
        (FRAME, (2.0, 0.9, 0.9), 0.4),
        (FRAME, (2.0, 0.0, 0.1), 0.2),
    ],
)
def test_distances(obstacle, point, distance):
    assert solids_of((obstacle,)).distance(np.array(point)).min() == pytest.approx(distance)


def test_a_landmark_is_a_post_with_a_panel():
    post, panel = solids_of((), MARK).distance(np.array([[4.0, 1.0, 1.0], [4.0, 1.0, 2.0]])).T
    assert post[0] == pytest.approx(0.95)
    assert panel[1] == pytest.approx(1.0 - LANDMARK_SIDE / 2)


@given(
    size=st.tuples(*[st.floats(0.1, 2)] * 3), yaw=numbers, a=st.tuples(numbers, numbers, numbers),
    b=st.tuples(numbers, numbers, numbers), rounded=st.booleans(),
)  # fmt: skip
@settings(max_examples=100)
def test_a_segment_meets_what_its_points_are_in(size, yaw, a, b, rounded):
    half = np.array([size])
    if rounded:
        half[:, 1] = half[:, 0]
    solid = Solids(np.zeros((1, 3)), np.array([yaw]), half, np.array([rounded]))
    points = np.array(a) + np.linspace(0, 1, 200)[:, None] * (np.array(b) - a)
    near = solid.distance(points).min()
    blocked = bool(solid.blocked(np.array(a), np.array(b), 0.2))
    if near < 0.15:
        assert blocked
    if near > 0.2 * np.sqrt(3) + 0.1 and not rounded:
        assert not blocked


@given(size=st.tuples(*[st.floats(0.1, 2)] * 3), yaw=numbers, at=st.tuples(numbers, numbers, numbers), turn=numbers)
@settings(max_examples=100)
def test_boxes_that_share_a_point_meet(size, yaw, at, turn):
    other = Solids(np.array([at]), np.array([turn]), np.array([[0.5, 1.0, 0.3]]), np.array([False]))
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 15)] * 3), axis=-1).reshape(-1, 3) * size
    points = np.column_stack([grid[:, 0] * np.cos(yaw) - grid[:, 1] * np.sin(yaw),
                              grid[:, 0] * np.sin(yaw) + grid[:, 1] * np.cos(yaw), grid[:, 2]])  # fmt: skip
    room = float(other.distance(points).min())
    met = bool(other.meets(np.zeros(3), yaw, np.array(size)).any())
    if room == 0.0:
        assert met
    if room > 0.6:  # further than points of the grid are apart
        assert not met


def walked(ways, start):
    """The points of a way from its start to its end."""
    path = [np.array(start)]
    while len(path) < 20:
        point = ways.points[ways.ahead(path[-1])]
        path.append(point)
        if np.allclose(point, ways.points[0]):
            return np.array(path)
        path[-1] = point + 1e-9
    raise AssertionError("the way does not end")


@pytest.mark.parametrize("obstacles", [(PILLAR,), (WALL, PILLAR), (BEAM, PILLAR), (FRAME,), ()])
def test_ways_lead_around_and_keep_their_margin(obstacles):
    ways = ways_to(1, obstacles, MARK, None, 0.3)
    path = walked(ways, (-1.0, 0.0, 0.9))
    assert path[-1] == pytest.approx([3.6, 0.0, 0.9])
    points = np.concatenate([a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in itertools.pairwise(path)])
    assert solids_of(obstacles, MARK).distance(points).min() > 0.29
    assert (len(path) > 2) == bool(obstacles)


def test_there_is_no_way_through_a_closed_wall():
    closed = tuple(Obstacle("wall", 2.0, float(y), 4.0, 5.0, 0.1) for y in (-6, -2, 2, 6))
    assert ways_to(1, closed, None, None, 0.3).ahead(np.array([-1.0, 0.0, 0.9])) is None


MOVING = Obstacle("pillar", 2.0, 0.0, 0.4, 2.0, yaw=np.pi / 2, sway=1.0, period=8.0)


def test_what_moves_is_at_its_left_end_after_a_quarter_of_its_period():
    solids = solids_of((MOVING, WALL))
    assert solids.at(0.0).centers[0] == pytest.approx([2.0, 0.0, 1.0])
    assert solids.at(2.0).centers[0] == pytest.approx([1.0, 0.0, 1.0])  # its left is where -x is
    assert solids.at(6.0).centers[0] == pytest.approx([3.0, 0.0, 1.0])
    assert (solids.at(2.0).centers[1] == solids_of((WALL,)).centers[0]).all()
    assert solids_of((PILLAR, WALL)).motion is None
    assert solids_of((PILLAR,)).at(3.0).centers[0] == pytest.approx([2.0, 0.0, 1.0])


def test_each_point_has_its_own_time():
    points, times = np.array([[1.0, 0.0, 1.0]] * 3), np.array([0.0, 2.0, 6.0])
    distance = solids_of((MOVING, WALL)).at(times).distance(points)
    assert distance[:, 0] == pytest.approx([0.8, 0.0, 1.8])
    assert len({*distance[:, 1]}) == 1


@pytest.mark.parametrize("kind", ["pillar", "person", "wall", "beam", "frame"])
def test_what_moves_stays_in_the_space_that_is_kept_for_it(kind):
    rng = np.random.default_rng(0)
    obstacle = Obstacle(kind, 2.0, 0.5, 0.8, 1.0, 0.2, 0.7, 0.3, sway=0.9, period=5.0, phase=1.0)
    solids, swept = solids_of((obstacle,)), solids_of((obstacle,)).swept()
    points = rng.uniform([0.0, -2.0, 0.0], [4.0, 3.0, 2.0], (4000, 3))
    touched = np.array([solids.at(time).distance(points) == 0 for time in np.linspace(0.0, 5.0, 41)])
    kept = swept.distance(points) == 0
    assert touched.any()
    assert not (touched & ~kept).any()
    assert (kept & ~touched.any(axis=0)).sum() < 0.4 * kept.sum()


def test_a_person_is_a_body_with_a_smaller_head():
    distance = solids_of((Obstacle("person", 2.0, 0.0, 0.5, 1.8),)).distance
    body, head = distance(np.array([[2.0, 1.0, 1.0], [2.0, 1.0, 1.7]])).min(axis=1)
    assert (body, head) == (pytest.approx(0.75), pytest.approx(np.hypot(0.75, 1.7 - 0.84 * 1.8)))
    assert distance(np.array([2.0, 0.0, 1.79])).min() == 0


def test_ways_lead_around_all_that_is_passed_by_what_moves():
    person = Obstacle("person", 2.5, 0.0, 0.5, 1.8, sway=1.2, period=10.0)
    ways = ways_to(1, (person,), None, None, 0.3)
    path, following = [np.array([-1.0, 0.0, 0.9])], ways.ahead(np.array([-1.0, 0.0, 0.9]))
    while following is not None and following >= 0:
        path.append(ways.points[following])
        following = int(ways.following[following])
    points = np.concatenate([np.linspace(a, b, 40) for a, b in itertools.pairwise(path)])
    for time in np.linspace(0.0, 10.0, 21):
        assert solids_of((person,)).at(time).distance(points).min() > 0.25
