"""What moves across the view gets its speed; what stands still gets none, whatever the drone does."""

from __future__ import annotations

import numpy as np
import pytest

from cognitivedrone.models.eyes.obstacle_eye import PARTS
from cognitivedrone.policies.avoidance import Avoidance
from cognitivedrone.policies.movement import Movement
from cognitivedrone.sim.drawing.views import FOCAL_PX
from cognitivedrone.types import IMAGE_SIZE

EDGES = (IMAGE_SIZE / 2 - np.arange(PARTS + 1) * IMAGE_SIZE / PARTS) / FOCAL_PX
STEP_S = 0.1


def pillar(ahead: float, left: float, half: float = 0.25) -> tuple[np.ndarray, np.ndarray]:
    """What an eye sees of a pillar `ahead` m before it and `left` m beside: probabilities, depths (PARTS, PARTS)."""
    low, high = (left - half) / ahead, (left + half) / ahead
    share = np.clip(np.minimum(EDGES[:-1], high) - np.maximum(EDGES[1:], low), 0.0, None) / (EDGES[:-1] - EDGES[1:])
    return np.tile(share, (PARTS, 1)), np.full((PARTS, PARTS), ahead)


def followed(speed: float, own: tuple[float, float], turn: float = 0.0, seconds: float = 1.2) -> np.ndarray:
    """The last velocity found, (3,), of a pillar 3 m ahead that moves to the left at `speed` past a drone that flies at
    `own`, m/s, and turns by `turn`, rad/s.
    """
    movement = Movement()
    velocities: np.ndarray = np.zeros((1, 3))
    for step in range(round(seconds / STEP_S)):
        time = step * STEP_S
        yaw = turn * time
        away = np.array([3.0, -0.3 + speed * time]) - np.array(own) * time
        ahead, left = np.cos(yaw) * away[0] + np.sin(yaw) * away[1], -np.sin(yaw) * away[0] + np.cos(yaw) * away[1]
        chance, depth = pillar(ahead, left)
        row, column = np.nonzero(chance > 0.2)
        side = (EDGES[:-1] + EDGES[1:]) / 2
        points = np.stack([depth[row, column], side[column] * ahead, side[row] * ahead], axis=1)
        way = np.array([*own, 0.0]) * STEP_S if step else np.zeros(3)
        flown = np.array([np.cos(yaw) * way[0] + np.sin(yaw) * way[1], -np.sin(yaw) * way[0] + np.cos(yaw) * way[1], 0])
        movement.fly(flown, turn * STEP_S if step else 0.0, STEP_S if step else 0.0)
        velocities = movement.see(row, column, depth[row, column], points, chance[row, column])
    return velocities.mean(axis=0)


@pytest.mark.parametrize("own", [(0.0, 0.0), (1.2, 0.0), (0.8, 0.4), (1.0, -0.5)])
@pytest.mark.parametrize("speed", [-0.6, -0.4, 0.4, 0.6])
def test_what_moves_to_the_side_gets_its_speed(speed, own):
    found = followed(speed, own)
    assert np.sign(found[1]) == np.sign(speed)
    assert abs(found[1] - speed) < 0.25


@pytest.mark.parametrize("own", [(0.0, 0.0), (1.5, 0.0), (0.8, 0.4)])
@pytest.mark.parametrize("turn", [0.0, 0.3, -0.3])
def test_what_stands_still_gets_none_past_a_drone_that_flies_and_turns(own, turn):
    assert not followed(0.0, own, turn).any()


def test_nothing_moves_at_first_sight():
    assert not followed(0.6, (1.0, 0.0), seconds=0.3).any()


def test_a_command_leads_behind_what_crosses_the_way():
    """The thing is a little to the left of the way now, and will be to the right of it when the drone arrives."""
    commands = {}
    for speed in (0.0, -0.6):
        avoidance = Avoidance()
        for step in range(12):
            left = 0.75 + speed * step * STEP_S if speed else 0.1
            avoidance.see(*pillar(1.8, left), np.zeros(3), 0.0, step * STEP_S)
        commands[speed] = avoidance.around(np.array([1.2, 0.0, 0.0, 0.0], np.float32), np.zeros(3), 1.2)
    assert commands[0.0][1] < 0.0
    assert commands[-0.6][1] > 0.0
