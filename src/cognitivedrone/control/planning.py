"""What a mission adds to a flight: its plan, and its landing.

The plan is the reasoner's own, asked for on the ground, or else the sentence read by its words. A coloured pad is
landed on by the drone's own camera: a command of the control loop, not of a network. The pad's colour is found in the
image and its place on the floor follows from the camera's geometry; once the pad has left the view below the drone, its
place is carried on by the measured velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from cognitivedrone.control.async_reasoner import asking
from cognitivedrone.control.calls import NO_WATCH, Watch
from cognitivedrone.errors import ReasonerError
from cognitivedrone.frames import rotate_yaw
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.layout import PAD_RADIUS
from cognitivedrone.sim.drawing.views import FOCAL_PX, MOUNT
from cognitivedrone.tasks.missions import forbidden, forbidding, parts_of, problem_of, read, sub_goals, way
from cognitivedrone.types import COLORS, IMAGE_SIZE, Action, Color, FloatArray, Image, Observation, SubGoal

_LEAST_PX: Final = 12  # of a pad that is seen
_BELOW_PX: Final = 6  # a pad is lower than the horizon by this
_DOMINANT: Final = 1.75  # a pad's colour over the other two; painted floors stay below 1.6
_APART: Final = 45  # of 255, for dark floors


@dataclass(frozen=True, slots=True)
class LandingRule:
    """How it approaches and comes down."""

    speed_m_s: float = 1.2
    gain: float = 0.7
    """Of the distance to the pad, 1/s."""
    least_height_m: float = 0.5
    """Until it is above the pad."""
    slope: float = 0.4
    """Height over distance on the way to it: low enough that the camera still sees it."""
    above_m: float = 0.18
    """Nearer than this it is above the pad, and comes down."""
    sink_m_s: float = 0.4
    search_rad_s: float = 0.5
    """Turns at this rate until it sees the pad."""
    newest: float = 0.5
    """Weight of the newest sight of the pad."""


class Lander:
    """Flies to a pad and down onto it. One for each landing."""

    def __init__(self, rule: LandingRule | None = None) -> None:
        self.rule = rule or LandingRule()
        self._place: FloatArray | None = None
        """(2,) of the pad, forward and left of the drone, m."""
        self._time = 0.0

    def act(self, observation: Observation, color: Color | None) -> Action:
        """The command (4,) for this view; without a colour it is the nearest pad."""
        rule, height = self.rule, observation.height
        self._carry_on(observation)
        seen = pad_in(observation.image, height, color)
        if seen is not None:
            before = self._place
            self._place = seen if before is None else before + rule.newest * (seen - before)
        if self._place is None:
            climb = float(np.clip(1.0 - height, -0.3, 0.3))
            return np.array([0.0, 0.0, climb, rule.search_rad_s], dtype=np.float32)
        x, y = (float(value) for value in self._place)
        distance = math.hypot(x, y)
        speed = min(rule.speed_m_s, rule.gain * distance)
        turn = float(np.clip(1.2 * math.atan2(y, x), -0.8, 0.8)) if distance > 1.0 else 0.0
        wanted = max(rule.least_height_m, rule.slope * distance)
        sink = -rule.sink_m_s if distance < rule.above_m else float(np.clip(wanted - height, -0.6, 0.4))
        share = speed / max(distance, 1e-6)
        return np.array([share * x, share * y, sink, turn], dtype=np.float32)

    def _carry_on(self, observation: Observation) -> None:
        """Move the pad's place as the drone has moved since the last call."""
        passed, self._time = observation.time - self._time, observation.time
        if self._place is not None and 0 < passed < 1:
            moved = self._place - passed * np.asarray(observation.velocity[:2], dtype=np.float64)
            self._place = rotate_yaw(np.array([*moved, 0.0]), -observation.yaw_rate * passed)[:2]


def pad_in(image: Image, height: float, color: Color | None) -> FloatArray | None:
    """The place (2,) of a pad, forward and left of the drone, m, as a level camera sees it; none if it is not in view.

    `height` is the drone's above the floor, m.
    """
    found = [_place(image, height, COLORS.index(name)) for name in (COLORS if color is None else (color,))]
    places = [place for place in found if place is not None]
    return min(places, key=lambda place: float(np.hypot(*place)), default=None)


def _place(image: Image, height: float, channel: int) -> FloatArray | None:
    rows, columns = np.nonzero(_mask(image, channel))
    if len(rows) < _LEAST_PX:
        return None
    down = (rows - IMAGE_SIZE / 2 + 0.5) / FOCAL_PX
    aside = (columns - IMAGE_SIZE / 2 + 0.5) / FOCAL_PX
    # The middle of its edges: a disc's nearer half covers more of the image than the other one.
    along = (height + MOUNT[2]) / down
    far, near = float(along.max()), float(along.min())
    cut = rows.max() == IMAGE_SIZE - 1  # the nearer half is below the image
    forward = (far - PAD_RADIUS if cut else (far + near) / 2) + MOUNT[0]
    lateral = -(aside * along)
    return np.array([forward, (lateral.min() + lateral.max()) / 2])


def _mask(image: Image, channel: int) -> NDArray[np.bool_]:
    """The largest spot (h, w) below the horizon in which one channel dominates."""
    wide = image.astype(np.float32)
    others = np.delete(wide, channel, axis=2).max(axis=2)
    mask: NDArray[np.bool_] = (wide[..., channel] > _DOMINANT * others) & (wide[..., channel] - others > _APART)
    mask[: IMAGE_SIZE // 2 + _BELOW_PX] = False
    parts, count = ndimage.label(mask)
    if count < 2:
        return mask
    found: NDArray[np.bool_] = parts == 1 + np.bincount(parts.ravel())[1:].argmax()
    return found


Plans = Callable[[str], tuple[SubGoal, ...]]
"""The sub-goals of a sentence; at least one."""


def plans_with(reasoner: Reasoner | None, mission: str, watch: Watch = NO_WATCH) -> Plans:
    """The plan of `mission`, made now by a reasoner that plans, and of any other sentence read by its words.

    A plan of its own must keep to what the words forbid, and to their landing. Of conditions it can hold that another
    thing is flown to where one is not there; all others are left to the words. Raises `ReasonerError` if there is no
    plan that can be flown.
    """
    words = read(mission)
    judged = reasoner is not None and not reasoner.needs_ground_truth
    kept = any(goal.kind == "if" and not _is_plain(goal) for goal in words.goals)
    own = None if reasoner is None or kept else _plan_of(reasoner, mission, watch)
    if judged and own is None and words.problem:
        raise ReasonerError("schema", f"the mission {words.problem}")
    if own is not None and not words.problem:
        if lost := _lost(words.goals, own):
            raise ReasonerError("schema", f"the reasoner's plan leaves out {lost}")
        own = tuple(forbidding(goal, forbidden(mission)) for goal in own)
        if problem := problem_of(own):
            raise ReasonerError("schema", f"the reasoner's plan {problem}")
    return lambda sentence: own if own is not None and sentence == mission else sub_goals(sentence)


def _is_plain(goal: SubGoal) -> bool:
    """Whether a choice is between flying to a thing and, where that is not there, to another one."""
    return goal.then == (SubGoal("fly", goal.instruction, avoid=goal.avoid),) and [
        part.kind for part in parts_of(goal.otherwise)
    ] == ["fly"]


def _lost(words: tuple[SubGoal, ...], own: tuple[SubGoal, ...]) -> str:
    """What the words say and a plan, which knows no other prohibition, does not: a colour, or the landing."""
    colors = frozenset(COLORS).intersection(each for goal in words for each in goal.avoid)
    if any(goal.kind != "land" and not goal.avoid >= colors for goal in own):
        return f"what is forbidden, {' and '.join(sorted(colors))}"
    landings = [[goal.instruction for goal in goals if goal.kind == "land"] for goals in (words, own)]
    return "" if landings[0] == landings[1] else f"the landing, {(landings[0] or ['none'])[0].lower()}"


def _plan_of(reasoner: Reasoner, mission: str, watch: Watch) -> tuple[SubGoal, ...] | None:
    with asking(watch):
        plan: object = reasoner.plan(mission)
    if plan is None:
        return None
    if not isinstance(plan, tuple) or not all(isinstance(goal, SubGoal) for goal in plan):
        raise ReasonerError("schema", f"the reasoner's plan is {repr(plan)[:80]}; expected a tuple of SubGoal")
    if not plan:
        raise ReasonerError("schema", "the reasoner's plan is empty; there is nothing to fly")
    if problem := problem_of(plan):
        raise ReasonerError("schema", f"the reasoner's plan {problem}")
    return plan


class Route:
    """A mission as far as it is flown: the way through its choices, by what was seen when they were reached."""

    def __init__(self, goals: Sequence[SubGoal], began: int = 0) -> None:
        self._goals, self._stage, self._last = tuple(goals), began, goals[-1]
        self.seen: tuple[bool, ...] = ()
        """As `Guidance.seen`, of the stage of now."""

    def at(self, stage: int) -> SubGoal:
        """The sub-goal of a stage; the last one where none is left. Stages are asked about in their order."""
        while self._stage < stage:
            if self._goals:
                self._last, rest = way(self._goals, self.seen)
                self._goals = (self._last,) if self._last.kind == "land" else rest
            self._stage, self.seen = self._stage + 1, ()
        return self._goals[0] if self._goals else self._last

    def over(self, stage: int) -> bool:
        """Whether nothing but a landing is left at a stage."""
        self.at(stage)
        return all(goal.kind == "land" for goal in self._goals)
