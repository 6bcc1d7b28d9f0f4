"""Flies at the gate that a directive names, by colour alone: segmentation and visual servoing, no privileged state.

With the gold directive it is the upper bound of flying; with a raw instruction, which names no gate, it picks a colour
by chance. It knows what a pilot of the published stage may know: the sizes of the gates, that their centres are 0.9 m
above ground, and the camera's field of view and place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cognitivedrone.policies.guidance import Pursuit, pursue
from cognitivedrone.sim.camera import FIELD_OF_VIEW, MOUNT
from cognitivedrone.tasks.directives import parse_directive
from cognitivedrone.types import COLORS, IMAGE_SIZE, ActionChunk, Color, FloatArray, Image, Observation, Shape, Size
from cognitivedrone.world.geometry import BAR_WIDTH, GATE_HEIGHT

FOCAL_PX = IMAGE_SIZE / 2 / np.tan(FIELD_OF_VIEW / 2)
CONTRAST = 40
"""A pixel has a gate's colour where that channel exceeds both others by this much."""
MIN_PIXELS = 12
SMALLEST_HEIGHT_PX = 7
SEARCH_RATE = 0.7
"""rad/s."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """A gate's ring in the image."""

    u: float
    """Column of the opening's centre, pixels from the image's middle, right is positive."""
    height_px: float
    """Of the whole ring."""
    ratio: float
    """Height of the ring over the height of its hole."""
    whole: bool
    """Whether it lies inside the image on all sides."""


def segment(image: Image, color: Color) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """(H, W) mask of the pixels of one gate colour."""
    pixels = image.astype(np.int16)
    channel = COLORS.index(color)
    others = [pixels[..., c] for c in range(3) if c != channel]
    return np.asarray(pixels[..., channel] - np.maximum(*others) > CONTRAST)


def find_gate(image: Image, color: Color, shape: Shape | None) -> Sighting | None:
    """The ring of one colour: hollow, and lower in the image than the panels that may show the same colour."""
    mask = segment(image, color)
    labelled, _ = ndimage.label(mask, structure=np.ones((3, 3)))
    best: Sighting | None = None
    lowest = -1.0
    for index, box in enumerate(ndimage.find_objects(labelled), start=1):
        rows, columns = box
        height, width = rows.stop - rows.start, columns.stop - columns.start
        if height < SMALLEST_HEIGHT_PX:
            continue
        part = labelled[box] == index
        if int(part.sum()) < MIN_PIXELS:
            continue
        whole = rows.start > 0 and columns.start > 0 and rows.stop < mask.shape[0] and columns.stop < mask.shape[1]
        middle = int(height * (2 / 3 if shape == "triangle" else 1 / 2))
        hole = _hole_height(part[:, width // 2], middle)
        if whole and (hole is None or not 0.4 < width / height < 1.6):
            continue
        if rows.stop > lowest:
            lowest = rows.stop
            u = (columns.start + columns.stop) / 2 - mask.shape[1] / 2
            best = Sighting(u, float(height), height / hole if hole else 1.0, whole)
    return best


def _hole_height(column: np.ndarray[tuple[int], np.dtype[np.bool_]], middle: int) -> int | None:
    """Free pixels around `middle` of the ring's middle column; none where the ring is filled or open there."""
    if column[middle]:
        return None
    above, below = np.flatnonzero(column[:middle]), np.flatnonzero(column[middle:])
    if not len(above) or not len(below):
        return None
    return int(middle + below[0] - above[-1] - 1)


def ring_height(size: Size, shape: Shape) -> float:
    """Height of a gate's frame from edge to edge, m."""
    opening = 1.5 if size == "big" else 0.75
    if shape == "triangle":
        return opening * np.sqrt(3) / 2 + 3 * BAR_WIDTH
    return opening + 2 * BAR_WIDTH


class ColourSeeker:
    """Keeps an estimate of where the gate is, corrects it by every good sighting, and flies through it."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self.config = Pursuit(speed_m_s=1.4, slow_m_s=0.6)
        self.reset("")

    def seed(self, seed: int) -> None:
        """Draw the colour of uninformed choices from `seed` from now on."""
        self._rng = np.random.default_rng(seed)

    def reset(self, instruction: str) -> None:
        """Forget the last gate."""
        self._text = instruction
        self._choice: tuple[Size | None, Color, Shape | None] | None = None
        self._gate: FloatArray | None = None
        self._normal = np.array([1.0, 0.0, 0.0])
        self._time: float | None = None
        self._turned = 0.0
        self._direction = 1.0

    def act(self, observation: Observation) -> ActionChunk:
        """Look, correct the estimate, steer."""
        if self._choice is None or observation.instruction != self._text:
            self._choice = self._choose(observation.instruction)
        size, color, shape = self._choice
        self._carry_on(observation)
        sighting = find_gate(observation.image, color, shape)
        if sighting is not None and sighting.whole:
            self._correct(sighting, size, shape)
        if self._gate is None:
            return self._search(observation, sighting)
        gate = np.array([*self._gate, GATE_HEIGHT - observation.height])
        command = pursue(gate, self._normal, np.asarray(observation.velocity, dtype=np.float64), self.config)
        return command[None].astype(np.float32)

    def _choose(self, text: str) -> tuple[Size | None, Color, Shape | None]:
        """The gate that the text names; a colour by chance where it names none."""
        self._text, self._gate = text, None
        size, color, shape = parse_directive(text)
        return size, color or COLORS[int(self._rng.integers(3))], shape

    def _carry_on(self, observation: Observation) -> None:
        """Move the estimate by the drone's own motion since the last look."""
        elapsed = 0.0 if self._time is None else observation.time - self._time
        self._time = observation.time
        turn = observation.yaw_rate * elapsed
        self._turned += turn
        back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        if self._gate is not None:
            self._gate = back @ (self._gate - np.asarray(observation.velocity[:2], dtype=np.float64) * elapsed)
        self._normal[:2] = back @ self._normal[:2]

    def _correct(self, sighting: Sighting, size: Size | None, shape: Shape | None) -> None:
        """Blend a sighting in: bearings are sharp, ranges are not."""
        if size is None:
            size = "big" if sighting.ratio < 1.31 else "small"
        depth = FOCAL_PX * ring_height(size, shape or "square") / sighting.height_px
        seen = np.array([depth + MOUNT[0], -sighting.u * depth / FOCAL_PX])
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
        """Turn toward what is half in sight, or sweep."""
        if sighting is not None:
            self._direction = -1.0 if sighting.u > 0 else 1.0
        elif abs(self._turned) > 1.2 and self._turned * self._direction > 0:
            self._direction = -self._direction
        rise = 1.0 * (GATE_HEIGHT - observation.height)
        return np.array([[0.0, 0.0, np.clip(rise, -0.5, 0.5), SEARCH_RATE * self._direction]], dtype=np.float32)
