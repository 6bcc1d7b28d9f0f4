"""Gate monitor: detects gates flown through, missed or hit, and leaving the stage. Does not know the right gate.

A gate is flown through if the drone's centre crosses its plane, outward, inside the opening. A landing is contact
with the floor on a pad. Contact means that the hull sphere touches a frame, a panel, an obstacle or the floor. Crossing
the nearest gate's plane outside its opening is a miss. A gate that stands alone, without a panel, is always the
nearest: flying past it at any distance is a miss.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cognitivedrone.layout.obstacles import solids_of
from cognitivedrone.types import Stage, Vector, Vectors
from cognitivedrone.world import geometry

GateEventKind = Literal["gate", "missed", "collision", "out_of_bounds"]

BOUNDS_LOW = np.array([-5.0, -8.0, -1.0])
"""Corner of the box a flight must stay in, m, in the stage frame."""
BOUNDS_HIGH = np.array([9.0, 8.0, 5.0])
NEAR_M = 1.5
"""Events happen only within this distance of a gate's plane."""
REACH_M = 2.0
"""A plane extends this far from its gate's centre: about half way to the next gate, if there is one."""
NEAR_GATE_M = 3.5
"""Beyond this distance from every gate's centre, a path of one control period cannot touch anything."""
ASTRAY_M = 4.0
"""Within this distance of the stage's origin, a path of one control period cannot leave the bounds."""
FAVOUR_M = 2.5
"""A flight that ends within this distance of a gate counts as having chosen it."""


@dataclass(frozen=True, slots=True)
class GateEvent:
    """The first decisive event of a stretch of path."""

    kind: GateEventKind
    gate: int | None
    """The gate where it happened, 0 to 2."""
    sample: int
    """Index into the judged path."""
    clearance_m: float | None = None
    """Between hull and frame at the plane, for a gate flown through; to the edge of the pad, for a landing."""


def judge(
    stage: Stage,
    path: Vectors,
    hull_radius: float,
    aspects: tuple[float, float, float],
    touched: int | None = None,
    centers: Vectors | None = None,
) -> GateEvent | None:
    """The first event along `path` ((k, 3) world, m; its first sample was judged before), or None.

    `aspects` are width over height of the three panels; `touched` is the first sample that touches an obstacle;
    `centers` (k, 3, 3) are those of gates that move, world, m.
    """
    if centers is None:
        centers = geometry.gate_centers(stage)
    yaws = geometry.gate_yaws(stage)
    first: GateEvent | None = None

    def consider(gate_event: GateEvent) -> None:
        nonlocal first
        if first is None or gate_event.sample < first.sample:
            first = gate_event

    local = to_stage_frame(stage, path)
    if touched is not None:
        consider(GateEvent("collision", None, touched))
    outside = np.any((local < BOUNDS_LOW) | (local > BOUNDS_HIGH), axis=1)
    if outside.any():
        consider(GateEvent("out_of_bounds", None, int(np.argmax(outside))))
    grounded = path[:, 2] < hull_radius
    if grounded.any():
        consider(_touch_down(stage, centers, path, int(np.argmax(grounded))))
    alone = stage.only is not None
    for index in geometry.standing(stage):
        gate = stage.gates[index]
        points = geometry.to_gate_frame(path, centers[..., index, :], float(yaws[index]))
        along, lateral, vertical = points[:, 0], points[:, 1], points[:, 2]
        if np.abs(along).min() > NEAR_M:
            continue
        room = geometry.frame_distance(gate, along, lateral, vertical)
        if index in geometry.panelled(stage):
            room = np.minimum(room, geometry.panel_distance(aspects[index], along, lateral, vertical))
        touching = room < hull_radius
        if touching.any():
            consider(GateEvent("collision", index, int(np.argmax(touching))))
        crossings = np.flatnonzero((along[:-1] <= 0) & (along[1:] > 0))
        for before in crossings:
            part = along[before] / (along[before] - along[before + 1])
            side, rise = (float(v[before] + part * (v[before + 1] - v[before])) for v in (lateral, vertical))
            if abs(side) > REACH_M and not alone:
                continue
            margin = float(geometry.opening_margin(gate, np.float64(side), np.float64(rise)))
            if margin > 0:
                consider(GateEvent("gate", index, int(before) + 1, margin - hull_radius))
            else:
                consider(GateEvent("missed", index, int(before) + 1))
    return first


def _touch_down(stage: Stage, pads: Vectors, path: Vectors, sample: int) -> GateEvent:
    """What contact with the floor is: a landing on a pad, with the distance to its edge, or a collision."""
    if stage.landing:
        room = geometry.PAD_RADIUS - np.linalg.norm(pads[:, :2] - path[sample, :2], axis=1)
        pad = int(room.argmax())
        if room[pad] > 0:
            return GateEvent("gate", pad, sample, float(room[pad]))
    return GateEvent("collision", None, sample)


def to_stage_frame(stage: Stage, points: Vectors) -> Vectors:
    """World points (..., 3) in the frame of the stage's origin and heading."""
    c, s = np.cos(stage.yaw), np.sin(stage.yaw)
    x, y = points[..., 0] - stage.origin[0], points[..., 1] - stage.origin[1]
    return np.stack([c * x + s * y, c * y - s * x, points[..., 2]], axis=-1)


class GateMonitor:
    """Monitors one drone in one stage: judges its path and measures it."""

    def __init__(
        self, stage: Stage, start: Vector, hull_radius: float, aspects: tuple[float, float, float], began: float = 0.0
    ) -> None:
        """The stage begins at `start` (3,), world, m, `began` s after the flight."""
        self.stage = stage
        self.start = np.array(start, dtype=np.float64)
        self.hull_radius = hull_radius
        self.aspects = aspects
        self.centers = geometry.gate_centers(stage, began)
        """(3, 3) the gates' centres at the end of the path so far, world, m."""
        self.path_m = 0.0
        self.closest_m = np.linalg.norm(self.centers - self.start, axis=1)
        """(3,) closest approach to each gate's centre so far, m."""
        self.obstacle_m: float | None = None
        """Smallest distance between hull and obstacles so far, m; none where nothing is in the way."""
        cluttered = bool(stage.obstacles) or stage.landmark is not None
        self._swaying = geometry.gate_motion(stage) is not None
        self._solids = solids_of(stage.obstacles, stage.landmark) if cluttered else None
        self._last = self.start

    def follow(self, path: Vectors, began: float = 0.0, ended: float = 0.0) -> GateEvent | None:
        """Judge the next part of the path, (k, 3) world, m, flown from `began` to `ended`, s since the flight began."""
        whole = np.concatenate([self._last[None], path])
        rooms = centers = None
        if self._swaying:
            centers = geometry.gate_centers(self.stage, np.linspace(began, ended, len(whole)))
            self.centers = centers[-1]
        if self._solids is not None:
            solids = self._solids.at(np.linspace(began, ended, len(whole)))
            rooms = solids.distance(to_stage_frame(self.stage, whole)).min(axis=1)
        touched = None
        if rooms is not None and rooms.min() < self.hull_radius:
            touched = int(np.argmax(rooms < self.hull_radius))
        gate_event = None
        if touched is not None or self._near(whole):
            gate_event = judge(self.stage, whole, self.hull_radius, self.aspects, touched, centers)
        if gate_event is not None:
            whole = whole[: gate_event.sample + 1]
        if centers is not None:
            centers = centers[: len(whole)]
            self.centers = centers[-1]
        if rooms is not None:
            room = max(float(rooms[: len(whole)].min()) - self.hull_radius, 0.0)
            self.obstacle_m = room if self.obstacle_m is None else min(self.obstacle_m, room)
        steps = np.diff(whole, axis=0)
        self.path_m += float(np.sqrt((steps * steps).sum(axis=1)).sum())
        to_gates = whole[:, None] - (self.centers if centers is None else centers)
        np.minimum(self.closest_m, np.sqrt((to_gates * to_gates).sum(axis=2)).min(axis=0), out=self.closest_m)
        self._last = whole[-1]
        return gate_event

    def resume(self, position: Vector) -> None:
        """Follow the drone from a position (3,) on, world, m: after an event that does not end its flight."""
        self._last = np.array(position, dtype=np.float64)

    def favoured(self) -> int | None:
        """The gate nearest to the drone now, if it is near enough to count as a choice."""
        distances = np.linalg.norm(self.centers - self._last, axis=1)
        nearest = min(geometry.choices(self.stage), key=lambda index: float(distances[index]))
        return nearest if distances[nearest] < FAVOUR_M else None

    def _near(self, path: Vectors) -> bool:
        """Whether an event is possible: a cheap check that skips the full judgement in free flight."""
        last = path[-1]
        astray = max(abs(last[0] - self.stage.origin[0]), abs(last[1] - self.stage.origin[1]), last[2])
        if astray > ASTRAY_M or path[:, 2].min() < self.hull_radius:
            return True
        offsets = self.centers - last
        return bool((offsets * offsets).sum(axis=1).min() < NEAR_GATE_M**2)
