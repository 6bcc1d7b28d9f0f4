"""The pilot's own estimate that it flew through a gate, for vehicles without ground truth.

A gate ahead surrounds the direction of flight, and its width in the image is inversely proportional to its distance.
Plotted over the distance flown, 1 / width is therefore a straight line that reaches zero at the gate's plane; neither
size nor distance of the gate need to be known. The estimate does not know which gate is right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from cognitivedrone.interfaces import Drone
from cognitivedrone.sim.drawing.views import FOCAL_PX
from cognitivedrone.types import COLORS, Action, FloatArray, Image, Observation

CONTRASTS = (180, 40)
"""A pixel has a colour where that channel exceeds both others by this much. The first parts a gate from a floor or a
picture that shows a paler shade of its colour; the second finds a gate in bad light."""
SLOWEST_M_S = 0.2
"""Slower than this forward there is no direction of flight."""


class Sighting(NamedTuple):
    """What surrounded the direction of flight in one colour."""

    flown_m: float
    """Distance flown until then, forward less backward."""
    turned_rad: float
    """Turned until then, to the left."""
    width_px: float


@dataclass(frozen=True, slots=True)
class PassageConfig:
    """When a gate counts as passed."""

    narrowest_px: int = 10
    """Minimum width of a patch of colour."""
    near_px: int = 60
    """Minimum width of the last sighting: a small gate is 1.7 m away then (106 degrees are 256 pixels)."""
    growth: float = 1.5
    """Minimum ratio of the last width to the first."""
    shrink: float = 0.75
    """A patch narrower than this times the previous one is another gate."""
    fitted: int = 12
    """Number of sightings, the last ones, that the line is fitted to."""
    beyond_m: float = 0.35
    """Distance behind the gate's plane at which the gate counts as passed."""
    lost_px: float = 128.0
    """Minimum width by the line where the gate is lost: it outgrew the image. A narrower one left it sideways."""
    forget_m: float = 3.0
    """The gate is forgotten this far after its last sighting,"""
    retreat_m: float = 0.3
    """or this far back from there,"""
    turn_rad: float = 0.6
    """or after turning by this since then."""


class Passage:
    """Counts the gates that were flown through. Feed it every observation."""

    def __init__(self, config: PassageConfig | None = None) -> None:
        self.config = config or PassageConfig()
        self.gates = 0
        """Flown through so far."""
        self._time: float | None = None
        self._flown_m = self._turned_rad = 0.0
        self._seen: tuple[list[Sighting], ...] = tuple([] for _ in COLORS)
        """By colour: the sightings of the gate ahead."""

    def update(self, observation: Observation) -> bool:
        """Whether this observation is the first behind a gate."""
        elapsed = 0.0 if self._time is None else observation.time - self._time
        self._time = observation.time
        velocity = np.asarray(observation.velocity, dtype=np.float64)
        self._flown_m += float(velocity[0]) * elapsed
        self._turned_rad += observation.yaw_rate * elapsed
        for seen in self._seen:
            if seen and self._is_left(seen[-1]):
                seen.clear()
        if velocity[0] < SLOWEST_M_S:
            return False
        point = direction_of_flight(observation.image, velocity)
        passed = False
        for seen, clear in zip(self._seen, colour_contrasts(observation.image), strict=True):
            passed |= self._follow(seen, self._width(clear, point))
        if passed:
            self.gates += 1
            for seen in self._seen:
                seen.clear()
        return passed

    def _follow(self, seen: list[Sighting], width: float | None) -> bool:
        """Take a sighting, or that there is none, of the gate of one colour; whether it has been passed."""
        if width is None:
            if seen and not self._outgrows(seen):
                seen.clear()
            return self._is_passed(seen)
        passed = False
        if seen and width < self.config.shrink * seen[-1].width_px:
            passed = self._is_passed(seen)
            seen.clear()
        seen.append(Sighting(self._flown_m, self._turned_rad, width))
        return passed

    def _is_left(self, last: Sighting) -> bool:
        """Whether the drone has left the gate that it saw last like that."""
        flown, turned = self._flown_m - last.flown_m, abs(self._turned_rad - last.turned_rad)
        return not -self.config.retreat_m <= flown <= self.config.forget_m or turned > self.config.turn_rad

    def _width(self, clear: NDArray[np.int16], point: tuple[float, float]) -> float | None:
        """Width in pixels of what surrounds a point (row, column) in one colour, if there is something."""
        for contrast in CONTRASTS:
            labelled, _ = ndimage.label(clear > contrast, structure=np.ones((3, 3)))
            widths = [
                float(columns.stop - columns.start)
                for rows, columns in ndimage.find_objects(labelled)
                if rows.start <= point[0] < rows.stop
                and columns.start <= point[1] < columns.stop
                # What an edge of the image cuts is wider than it looks.
                and columns.start > 0
                and columns.stop < clear.shape[1]
            ]
            if max(widths, default=0.0) >= self.config.narrowest_px:
                return max(widths)
        return None

    def _is_passed(self, seen: list[Sighting]) -> bool:
        """Whether the plane of the gate that was seen like that is behind the drone."""
        line = self._approach(seen)
        return line is not None and self._flown_m >= line.plane_m + self.config.beyond_m

    def _outgrows(self, seen: list[Sighting]) -> bool:
        """Whether the gate that was seen like that is too close by now to be in the image as a whole."""
        line = self._approach(seen)
        left_m = 0.0 if line is None else line.plane_m - self._flown_m
        return line is not None and (left_m <= 0 or line.width_at_1m_px / left_m >= self.config.lost_px)

    def _approach(self, seen: list[Sighting]) -> Approach | None:
        """The line through the last sightings, if they came as close as a gate does that is flown at."""
        if not seen or seen[-1].width_px < max(self.config.near_px, self.config.growth * seen[0].width_px):
            return None
        return approach(np.array([(one.flown_m, one.width_px) for one in seen[-self.config.fitted :]]))


class Approach(NamedTuple):
    """The line of 1 / width over the distance flown."""

    plane_m: float
    """Distance flown at which the camera reaches the gate's plane."""
    width_at_1m_px: float
    """Width, pixels, 1 m before."""


def approach(sightings: FloatArray) -> Approach | None:
    """The line through sightings (n, 2), distances flown in m and widths in pixels; none where they do not grow."""
    flown, inverse = sightings[:, 0], 1.0 / sightings[:, 1]
    spread = flown - flown.mean()
    if len(sightings) < 3 or not spread @ spread > 0:
        return None
    slope = float(spread @ inverse / (spread @ spread))
    return Approach(float(flown.mean() - inverse.mean() / slope), -1 / slope) if slope < 0 else None


def colour_contrasts(image: Image) -> tuple[NDArray[np.int16], ...]:
    """Three times (H, W): by how much each channel exceeds both others."""
    red, green, blue = (image[..., channel].astype(np.int16) for channel in range(3))
    return (
        red - np.maximum(green, blue),
        green - np.maximum(red, blue),
        blue - np.maximum(red, green),
    )


def direction_of_flight(image: Image, velocity: FloatArray) -> tuple[float, float]:
    """Row and column, pixels, of the point that a level camera flies at; `velocity` (3,) in the heading frame."""
    height, width = image.shape[:2]
    aside, up = velocity[1] / velocity[0], velocity[2] / velocity[0]
    return height / 2 - FOCAL_PX * float(up), width / 2 - FOCAL_PX * float(aside)


class WatchedDrone:
    """A drone whose observations are shown to a `Passage`."""

    def __init__(self, drone: Drone, passage: Passage) -> None:
        self._drone, self._passage = drone, passage

    def observe(self) -> Observation:
        """As the drone."""
        observation = self._drone.observe()
        self._passage.update(observation)
        return observation

    def send(self, action: Action) -> Action:
        """As the drone."""
        return self._drone.send(action)

    def close(self) -> None:
        """As the drone."""
        self._drone.close()
