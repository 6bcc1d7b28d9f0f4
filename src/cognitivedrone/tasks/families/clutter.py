"""Random obstacles between the start and the gates of a task, of which one is in the way to the right gate.

From every start there is a way to every gate that keeps `CLEAR_M` from all of them, and most of every panel is seen.
What moves counts as everywhere on its way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cognitivedrone.layout import EYE, PANEL_HEIGHT, PANEL_RISE, STARTS, draw_layout
from cognitivedrone.layout.obstacles import Solids, solids_of
from cognitivedrone.layout.path_planning import JOIN_M, gate_places, ways_to
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.families.hard import PLAIN_THINGS
from cognitivedrone.tasks.generate import TRAIN, Draw
from cognitivedrone.tasks.validate import occupied, right_gate
from cognitivedrone.types import FloatArray, Landmark, Layout, Obstacle, ObstacleKind, Task, Vector, Vectors

CLEAR_M: Final = 0.45
"""Between the drone's centre and every obstacle on the way, m: the larger airframe has a hull of 0.28 m."""
SEEN: Final = 0.6
"""Least share of a panel that is seen from a start."""
IN_THE_WAY_M: Final = 0.2
"""The straight way from the middle of the start box to the right gate comes nearer to an obstacle than this."""
_APPROACH: Final = ((-1.9, 1.0), 0.6, 2.4)
"""Free space on every gate's axis: along it, half its width and its height, m."""
_PANEL_GRID: Final = np.linspace(-0.8, 0.8, 3)
_TRIES: Final = 60
KINDS: Final[tuple[ObstacleKind, ...]] = ("pillar", "wall", "beam", "frame")
MOVERS: Final[tuple[ObstacleKind, ...]] = ("person", "pillar", "person", "wall", "person", "beam")
"""What moves: a person every second time."""
ROWS_M: Final = 1.6
"""Between the nearest and the farthest gate of two rows, along the stage's x axis."""


def several(rng: np.random.Generator, task: Task, count: int) -> Task:
    """The task with `count` gates, 2 to 6: two or three with a panel, and for the others empty frames in the way."""
    two = count == 2 or (count < 6 and bool(rng.integers(2)))
    wrong = [gate for gate in range(3) if gate != right_gate(task)]
    missing = wrong[rng.integers(2)] if two else None
    return cluttered(rng, replace(task, missing=missing), "frame", count - (2 if two else 3), ("frame",))


def cluttered(
    rng: np.random.Generator, task: Task, kind: ObstacleKind, count: int, kinds: Sequence[ObstacleKind] = KINDS
) -> Task:
    """The task with `count` obstacles of these kinds, the first of `kind` and in the way.

    Two of three get a gate layout of their own, and half of those without a board a landmark. In one of a thousand
    layouts there is no room: a task that has such a one gets another.
    """
    new_layout, marked = rng.random() < 2 / 3, rng.random() < 0.5 and task.board is None
    attempts = 0
    while True:
        laid_out, attempts = task, attempts + 1
        if new_layout or (task.layout is not None and attempts > _TRIES):
            laid_out = replace(task, layout=draw_layout(rng, task.gates, board=task.board is not None))
        found = _with_landmark(rng, laid_out) if marked else laid_out
        for number in range(count):
            shape = kinds[int(rng.integers(len(kinds)))] if number else kind
            found = found and _with_obstacle(rng, found, shape, first=number == 0)
        if found is not None and has_ways(found):
            return found


def crossed(rng: np.random.Generator, task: Task, kind: ObstacleKind, count: int) -> Task:
    """The task with gates in two rows and `count` obstacles, of which the first, of this kind, moves to and fro across
    the way; a second one is as likely to move as not.
    """
    while True:
        layout = draw_layout(rng, task.gates, board=task.board is not None)
        depths = [place.x for place in layout]
        if max(depths) - min(depths) < ROWS_M:
            continue
        found: Task | None = replace(task, layout=layout)
        for number in range(count):
            moves = number == 0 or (number == 1 and bool(rng.integers(2)))
            kinds = MOVERS if moves else KINDS
            shape = kinds[rng.integers(len(kinds))] if number else kind
            found = found and _with_obstacle(rng, found, shape, first=number == 0, moves=moves)
        if found is not None and has_ways(found):
            return found


def _with_obstacle(
    rng: np.random.Generator, task: Task, kind: ObstacleKind, *, first: bool, moves: bool = False
) -> Task | None:
    """The task with one more obstacle; none if no place for it is found."""
    for _ in range(_TRIES):
        obstacle = _draw(rng, kind, _before_gate(rng, task) if first else rng.uniform([0.7, -4.0], [5.5, 4.0]))
        if moves:
            obstacle = _moving(rng, obstacle)
        found = replace(task, obstacles=(*task.obstacles, obstacle))
        if (not first or is_in_the_way(found)) and _apart(obstacle, task) and is_free(found):
            return found
    return None


def _before_gate(rng: np.random.Generator, task: Task) -> FloatArray:
    """A place near the straight way from the start to the right gate, (2,) m."""
    start, join = STARTS[0], _join(task.layout, right_gate(task))
    along = join - start
    aside = np.array([-along[1], along[0]]) / np.hypot(along[0], along[1])
    place: FloatArray = (start + rng.uniform(0.4, 0.85) * along)[:2] + rng.uniform(-0.35, 0.35) * aside
    return place


def _draw(rng: np.random.Generator, kind: ObstacleKind, place: FloatArray) -> Obstacle:
    """An obstacle of random sizes; numbers are rounded, so that a file holds them exactly."""

    def of(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 2)

    x, y = (round(float(value), 2) for value in place)
    yaw = round(float(rng.uniform(-0.6, 0.6)), 2)
    if kind == "pillar":
        return Obstacle(kind, x, y, of(0.15, 0.45), of(1.2, 3.0))
    if kind == "person":
        return Obstacle(kind, x, y, of(0.4, 0.55), of(1.5, 1.9))
    if kind == "wall":
        return Obstacle(kind, x, y, of(0.7, 2.0), of(0.5, 1.4), of(0.06, 0.2), yaw)
    if kind == "beam":
        return Obstacle(kind, x, y, of(1.0, 3.0), of(0.08, 0.2), of(0.08, 0.2), yaw, of(0.5, 1.7))
    return Obstacle(kind, x, y, of(1.0, 1.9), of(1.0, 1.7), 0.05, yaw, of(0.0, 0.5))


def _moving(rng: np.random.Generator, obstacle: Obstacle) -> Obstacle:
    """The obstacle moving to and fro, at 0.3 to 0.7 m/s where it is fastest."""
    sway, fastest, phase, yaw = rng.uniform([0.4, 0.3, 0.0, -0.6], [1.3, 0.7, 2 * np.pi, 0.6]).round(2).tolist()
    period = round(2 * float(np.pi) * sway / fastest, 2)
    return replace(obstacle, sway=sway, period=period, phase=phase, yaw=yaw)


def _with_landmark(rng: np.random.Generator, task: Task) -> Task | None:
    """The task with a thing that is on no gate's panel, facing the start; none if no place for it is found."""
    draw = Draw(rng, TRAIN, 0)
    shown = {label.partition("@")[0] for label in task.labels}
    name = draw.pick([name for name in PLAIN_THINGS if f"{KIND_OF[name]}/{name}" not in shown])
    label = draw.drawing(KIND_OF[name], name).label
    for _ in range(_TRIES):
        x, y = rng.uniform([2.0, -5.5], [6.0, 5.5]).round(2).tolist()
        yaw = round(float(np.arctan2(y, x + 1.0) + rng.uniform(-0.4, 0.4)), 2)
        found = replace(task, landmark=Landmark(label, x, y, round(float(rng.uniform(1.5, 2.6)), 2), yaw))
        if is_free(found):
            return found
    return None


def _apart(obstacle: Obstacle, task: Task) -> bool:
    """Whether an obstacle touches no other one of the task, and not its landmark."""
    own, others = solids_of((obstacle,)).swept(), solids_of(task.obstacles, task.landmark).swept()
    parts = zip(own.centers, own.yaws, own.halves, strict=True)
    return not any(others.meets(center, float(yaw), half).any() for center, yaw, half in parts)


def is_free(task: Task) -> bool:
    """Whether obstacles leave start, gates and panels as free as this module promises."""
    solids = solids_of(task.obstacles, task.landmark).swept()
    if occupied(task, solids) or _blocks_approach(solids, task.layout):
        return False
    return seen_share(solids, task.layout) >= SEEN


def is_in_the_way(task: Task) -> bool:
    """Whether an obstacle is on the straight way from the middle of the start box to the right gate."""
    join = _join(task.layout, right_gate(task))
    return bool(solids_of(task.obstacles).swept().blocked(STARTS[0], join, IN_THE_WAY_M).any())


def has_ways(task: Task) -> bool:
    """Whether there is a way from every start to every gate that keeps `CLEAR_M`."""
    for gate in range(3):
        ways = ways_to(gate, task.obstacles, task.landmark, task.layout, CLEAR_M)
        near = ways.solids.blocked(STARTS, STARTS, CLEAR_M).any()
        if near or any(ways.ahead(start) is None for start in STARTS):
            return False
    return True


def seen_share(solids: Solids, layout: Layout | None) -> float:
    """The least share of a panel that obstacles leave to be seen from a start."""
    centers, yaws = gate_places(layout)
    sides = np.stack([-np.sin(yaws), np.cos(yaws), np.zeros(3)], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    rise, aside = (each.reshape(-1, 1) * PANEL_HEIGHT / 2 for each in np.meshgrid(_PANEL_GRID, _PANEL_GRID))
    panels = centers[:, None] + (PANEL_RISE + rise) * up + aside * sides[:, None]  # (3, points, 3)
    eyes = np.broadcast_to(STARTS + EYE, (3, panels.shape[1], len(STARTS), 3))
    hidden = solids.blocked(eyes, np.broadcast_to(panels[:, :, None], eyes.shape), 0.0)
    return 1.0 - float(hidden.mean(axis=1).max())


def _blocks_approach(solids: Solids, layout: Layout | None) -> bool:
    (before, behind), half, top = _APPROACH
    for center, yaw in zip(*gate_places(layout), strict=True):
        normal = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        middle = np.array([*center[:2], top / 2]) + (before + behind) / 2 * normal
        if solids.meets(middle, float(yaw), np.array([(behind - before) / 2, half, top / 2])).any():
            return True
    return False


def _join(layout: Layout | None, gate: int) -> Vector:
    centers, yaws = gate_places(layout)
    join: Vectors = centers[gate] - JOIN_M * np.array([np.cos(yaws[gate]), np.sin(yaws[gate]), 0.0])
    return join
