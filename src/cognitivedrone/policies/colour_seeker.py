"""Colour segmentation and visual servoing to the gate that a directive names, without privileged state.

With the gold directive it is the upper bound of flying without learning; for a raw instruction, which names no gate, it
picks a random colour. It uses the known geometry of the published stage: the gate sizes, their centres 0.9 m above the
ground, and the camera's field of view and mounting.

Pursuit of a point on a gate's axis, compensating for the autopilot's lag.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from cognitivedrone.interfaces import Policy
from cognitivedrone.sim.drawing.views import FOCAL_PX, MOUNT
from cognitivedrone.tasks.directives import parse_directive
from cognitivedrone.types import (
    COLORS,
    ActionChunk,
    Color,
    Commands,
    EpisodeContext,
    FloatArray,
    Image,
    Observation,
    Shape,
    Size,
    Vector,
)
from cognitivedrone.world.geometry import BAR_WIDTH, GATE_HEIGHT


@dataclass(frozen=True, slots=True)
class Pursuit:
    """Parameters of a gate approach."""

    speed_m_s: float = 1.6
    """On a straight approach."""
    slow_m_s: float = 0.7
    """Off the gate's axis and close to its plane."""
    lag_s: float = 0.45
    """Effective delay between a velocity command and the velocity; the path starts at the position after this time."""
    lookahead_m: float = 0.9
    """Distance to the target point on the path."""
    straight_m: float = 0.7
    """The path joins the gate's axis this far before its plane."""
    yaw_gain: float = 1.6
    """1/s."""
    yaw_rate_max: float = 1.0
    """rad/s."""


def pursue(gate: Vector, normal: Vector, velocity: Vector, config: Pursuit) -> Commands:
    """Velocity command (4,) toward and through a gate; all vectors in the heading frame.

    `gate` (3,) is the gate's centre relative to the drone, m; `normal` (3,) the level unit direction in which to cross
    it; `velocity` (3,) the drone's velocity, m/s.
    """
    seen = gate - velocity * config.lag_s
    along = float(seen @ normal)
    offset = along * normal - seen
    carrot_along = along - config.lookahead_m
    if carrot_along > config.straight_m and along > config.straight_m:
        share = (carrot_along - config.straight_m) / (along - config.straight_m)
        beside = offset * share**1.5
    else:
        beside = np.zeros(3)
    aim = (along - carrot_along) * normal - offset + beside
    aim = aim / max(float(np.linalg.norm(aim)), 1e-6)
    bearing = float(np.arctan2(aim[1], aim[0]))
    far_off = float(np.linalg.norm(offset)) / max(along, 0.3)
    ease = np.clip(1.25 - far_off * 1.5, 0.0, 1.0) * np.clip(1.4 - abs(bearing), 0.0, 1.0)
    speed = config.slow_m_s + (config.speed_m_s - config.slow_m_s) * ease
    face = seen + normal
    turn = float(np.arctan2(face[1], face[0]))
    yaw_rate = np.clip(config.yaw_gain * turn, -config.yaw_rate_max, config.yaw_rate_max)
    return np.array([*(aim * speed), yaw_rate])


CONTRASTS = (180, 40)
"""A pixel has a gate's colour if that channel exceeds both others by this much. The stricter value is tried first: it
separates a well-lit gate from paler shades of its colour on the panel behind it."""
RATIO_BETWEEN_SIZES = 1.31
"""Height of a ring over that of its hole; below this ratio the gate is big."""
PITCH_ALLOWANCE_PX = 20
"""How far above the image's middle a gate's lower edge may be when the nose is down."""
TILT_ALLOWANCE = 0.2
"""Height error per metre of depth due to a tilted camera, m/m."""
MIN_PIXELS = 12
SMALLEST_HEIGHT_PX = 7
SEARCH_RATE = 0.7
"""rad/s."""

Mask: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Wanted:
    """The gate to look for; none for parts that the directive does not name."""

    size: Size | None
    color: Color
    shape: Shape | None


@dataclass(frozen=True, slots=True)
class Sighting:
    """A gate's ring in the image."""

    bearing: float
    """Slope of the opening's centre, metres to the left per metre of depth."""
    depth_m: float | None
    """Along the camera's axis; none if the image's edge cuts the ring."""


def segment(image: Image, color: Color, contrast: int) -> Mask:
    """(H, W) mask of the pixels of one gate colour."""
    pixels = image.astype(np.int16)
    channel = COLORS.index(color)
    others = [pixels[..., c] for c in range(3) if c != channel]
    return np.asarray(pixels[..., channel] - np.maximum(*others) > contrast)


def find_gate(image: Image, wanted: Wanted, camera_height_m: float) -> Sighting | None:
    """The hollow ring of the wanted colour at gate height; panels above may show the same colour."""
    best: Sighting | None = None
    for contrast in CONTRASTS:
        sighting = _lowest_ring(segment(image, wanted.color, contrast), wanted, camera_height_m)
        if sighting is not None and sighting.depth_m is not None:
            return sighting
        best = best or sighting
    return best


def _lowest_ring(mask: Mask, wanted: Wanted, camera_height_m: float) -> Sighting | None:
    """The lowest patch of the mask that can be the wanted gate."""
    labelled, _ = ndimage.label(mask, structure=np.ones((3, 3)))
    best: Sighting | None = None
    lowest = mask.shape[0] / 2 - PITCH_ALLOWANCE_PX
    for index, box in enumerate(ndimage.find_objects(labelled), start=1):
        if box[0].stop > lowest and box[0].stop - box[0].start >= SMALLEST_HEIGHT_PX:
            sighting = _read_ring(labelled[box] == index, box, mask.shape, wanted, camera_height_m)
            if sighting is not None:
                best, lowest = sighting, box[0].stop
    return best


def _read_ring(
    ring: Mask, box: tuple[slice, slice], shape: tuple[int, int], wanted: Wanted, camera_height_m: float
) -> Sighting | None:
    """A connected patch as a sighting; none if it cannot be the wanted gate."""
    if int(ring.sum()) < MIN_PIXELS:
        return None
    rows, columns = box
    height, width = ring.shape
    bearing = (shape[1] - columns.start - columns.stop) / 2 / FOCAL_PX
    if rows.start == 0 or columns.start == 0 or rows.stop == shape[0] or columns.stop == shape[1]:
        return Sighting(bearing, None)
    part = 2 / 3 if wanted.shape == "triangle" else 1 / 2
    hole = _hole_height(ring[:, width // 2], int(height * part))
    if hole is None or not 0.4 < width / height < 1.6:
        return None
    size = wanted.size or ("big" if height / hole < RATIO_BETWEEN_SIZES else "small")
    depth = FOCAL_PX * ring_height(size, wanted.shape or "square") / height
    drop = (rows.start + part * height - shape[0] / 2) / FOCAL_PX * depth
    if abs(camera_height_m - drop - GATE_HEIGHT) > 0.35 + TILT_ALLOWANCE * depth:
        return None
    return Sighting(bearing, depth)


def _hole_height(column: Mask, middle: int) -> int | None:
    """Free pixels around `middle` in the ring's middle column; none if the ring is filled or open there."""
    if column[middle]:
        return None
    above, below = np.flatnonzero(column[:middle]), np.flatnonzero(column[middle:])
    if not len(above) or not len(below):
        return None
    return int(middle + below[0] - above[-1] - 1)


def ring_height(size: Size, shape: Shape) -> float:
    """Outer height of a gate's frame, m."""
    opening = 1.5 if size == "big" else 0.75
    if shape == "triangle":
        return opening * math.sqrt(3) / 2 + 3 * BAR_WIDTH
    return opening + 2 * BAR_WIDTH


class ColourSeeker(Policy):
    """Estimates the gate's position, corrects it with every good sighting, and flies through it."""

    reads_english_only = True

    needs_seed = True

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self.config = Pursuit(speed_m_s=1.4, slow_m_s=0.6)
        self._forget("")

    def reset(self, context: EpisodeContext) -> None:
        """Forget the last gate; a new flight reseeds the generator of random colours."""
        if context.stage == 0:
            self._rng = np.random.default_rng(context.seed)
        self._forget(context.instruction)

    def _forget(self, instruction: str) -> None:
        self._text = instruction
        self._choice: Wanted | None = None
        self._gate: FloatArray | None = None
        self._normal = np.array([1.0, 0.0, 0.0])
        self._time: float | None = None
        self._turned = 0.0
        self._direction = 1.0

    def act(self, observation: Observation) -> ActionChunk:
        """Find the gate, correct the estimate, and command a velocity."""
        if self._choice is None or observation.instruction != self._text:
            self._choice = self._choose(observation.instruction)
        self._carry_on(observation)
        sighting = find_gate(observation.image, self._choice, observation.height + MOUNT[2])
        if sighting is not None and sighting.depth_m is not None:
            self._correct(sighting.bearing, sighting.depth_m)
        if self._gate is None:
            return self._search(observation, sighting)
        gate = np.array([*self._gate, GATE_HEIGHT - observation.height])
        command = pursue(gate, self._normal, np.asarray(observation.velocity, dtype=np.float64), self.config)
        return command[None].astype(np.float32)

    def _choose(self, text: str) -> Wanted:
        """The gate that the text names; a random colour if it names none."""
        self._text, self._gate = text, None
        size, color, shape = parse_directive(text)
        return Wanted(size, color or COLORS[int(self._rng.integers(3))], shape)

    def _carry_on(self, observation: Observation) -> None:
        """Move the estimate by the drone's own motion since the last frame."""
        elapsed = 0.0 if self._time is None else observation.time - self._time
        self._time = observation.time
        turn = observation.yaw_rate * elapsed
        self._turned += turn
        back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        if self._gate is not None:
            self._gate = back @ (self._gate - np.asarray(observation.velocity[:2], dtype=np.float64) * elapsed)
        self._normal[:2] = back @ self._normal[:2]

    def _correct(self, slope: float, depth_m: float) -> None:
        """Blend in a sighting: bearings are accurate, ranges are not."""
        seen = np.array([depth_m + MOUNT[0], slope * depth_m])
        if self._gate is None:
            self._gate = seen
            self._normal = np.array([*(seen / np.linalg.norm(seen)), 0.0])
            return
        if self._gate[0] < 0.3:
            return
        reach, reach_seen = np.linalg.norm(self._gate), np.linalg.norm(seen)
        reach += 0.3 * (reach_seen - reach)
        bearing, bearing_seen = np.arctan2(self._gate[1], self._gate[0]), np.arctan2(seen[1], seen[0])
        bearing += 0.6 * (bearing_seen - bearing)
        self._gate = reach * np.array([np.cos(bearing), np.sin(bearing)])

    def _search(self, observation: Observation, sighting: Sighting | None) -> ActionChunk:
        """Turn toward a partly visible gate, or sweep."""
        if sighting is not None:
            self._direction = 1.0 if sighting.bearing > 0 else -1.0
        elif abs(self._turned) > 1.2 and self._turned * self._direction > 0:
            self._direction = -self._direction
        rise = 1.0 * (GATE_HEIGHT - observation.height)
        return np.array([[0.0, 0.0, np.clip(rise, -0.5, 0.5), SEARCH_RATE * self._direction]], dtype=np.float32)
