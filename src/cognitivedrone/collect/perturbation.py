"""Deliberate perturbations, drawn from the episode's own generator. Pure functions.

A perturbed flight records the expert's clean action as the label, and beside it the command that was sent.
Perturbations act only through the command or the start, so a record suffices to repeat the flight bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cognitivedrone.collect.recipe import Recipe
from cognitivedrone.envs.track_runner import draw_start
from cognitivedrone.sim.simulator import Start
from cognitivedrone.types import CONTROL_HZ, Action
from cognitivedrone.world import geometry

OFF_TRACK_X_M = (-2.0, 2.0)
"""Off-track starts: range in the stage's direction, m. Every gate's plane is at least 2.4 m further."""
OFF_TRACK_Y_M = 2.5
"""Off-track starts: maximum lateral offset, m."""
OFF_TRACK_Z_M = (0.4, 2.2)
OFF_TRACK_YAW = 0.6
"""Maximum yaw offset to either side, rad."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A command that is sent instead of the policy's."""

    first: int
    """First control step."""
    last: int
    """Last control step."""
    action: tuple[float, float, float, float]
    """Heading frame, m/s and rad/s."""


def draw_beginning(rng: np.random.Generator, recipe: Recipe, hull_radius: float) -> Start:
    """Initial conditions of a flight: as published, or off track for the recipe's share of flights; and the wind."""
    published = draw_start(rng, hull_radius, recipe.wind_m_s * float(rng.random()))
    if rng.random() >= recipe.off_track_share:
        return published
    x, y, z = (rng.uniform(*OFF_TRACK_X_M), rng.uniform(-OFF_TRACK_Y_M, OFF_TRACK_Y_M), rng.uniform(*OFF_TRACK_Z_M))
    lowest = max(geometry.START_MIN_HEIGHT, 2 * hull_radius)
    yaw = float(rng.uniform(-OFF_TRACK_YAW, OFF_TRACK_YAW))
    return Start((float(x), float(y), max(float(z), lowest)), yaw, published.wind)


def draw_disturbances(rng: np.random.Generator, recipe: Recipe) -> tuple[Disturbance, ...]:
    """The kicks and the wrong commands of one flight, up to its time limit, in order of their start."""
    drawn = [
        *_draw(rng, recipe, recipe.kicks_per_s, recipe.kick_steps, _kick),
        *_draw(rng, recipe, recipe.wrongs_per_s, recipe.wrong_steps, _wrong),
    ]
    return tuple(sorted(drawn, key=lambda disturbance: (disturbance.first, disturbance.last)))


def disturb(action: Action, step: int, disturbances: tuple[Disturbance, ...]) -> Action:
    """The command sent instead of `action` (4,) at a control step: the active disturbance, or the action itself."""
    for disturbance in disturbances:
        if disturbance.first <= step <= disturbance.last:
            return np.array(disturbance.action, dtype=np.float32)
    return action


_Command = tuple[float, float, float, float]


def _draw(
    rng: np.random.Generator,
    recipe: Recipe,
    per_s: float,
    lengths: tuple[int, int],
    command: Callable[[np.random.Generator, Recipe], _Command],
) -> list[Disturbance]:
    """One kind of disturbance, at random times that average to `per_s`."""
    drawn: list[Disturbance] = []
    if per_s <= 0:
        return drawn
    time = float(rng.exponential(1 / per_s))
    while time < recipe.time_limit_s:
        first = int(time * CONTROL_HZ)
        last = first + int(rng.integers(lengths[0], lengths[1] + 1)) - 1
        drawn.append(Disturbance(first, last, command(rng, recipe)))
        time = (last + 1) / CONTROL_HZ + float(rng.exponential(1 / per_s))
    return drawn


def _kick(rng: np.random.Generator, recipe: Recipe) -> _Command:
    """A hard push in a random horizontal direction, slightly up or down."""
    direction = rng.uniform(-np.pi, np.pi)
    x, y = recipe.kick_m_s * np.cos(direction), recipe.kick_m_s * np.sin(direction)
    return (float(x), float(y), float(rng.uniform(-0.5, 0.5)), 0.0)


def _wrong(rng: np.random.Generator, recipe: Recipe) -> _Command:
    """A random slow velocity and yaw rate."""
    x, y, z = rng.uniform(-1, 1, 3) * (recipe.wrong_m_s, recipe.wrong_m_s, recipe.wrong_m_s / 3)
    return (float(x), float(y), float(z), float(rng.uniform(-recipe.wrong_yaw_rate, recipe.wrong_yaw_rate)))
