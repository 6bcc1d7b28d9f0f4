"""The values that packages exchange: frozen, without behaviour; shapes, units and frames are in the docstrings.

Frames and units (converted only in `frames.py`):

- World: ENU, metres. Body: FLU (x forward, y left, z up). Heading frame: the body frame turned level, yaw only.
- Quaternions are (w, x, y, z), body to world. Angles in radians, yaw positive to the left. Time in seconds.
- Images are uint8 (H, W, 3) RGB.

The array types give shape and dtype; the tests check both in every call (`tests/support/typechecked.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Float32, UInt8

from cognitivedrone.choices import EventKind

# Not NumPy's NDArray: in some versions it is an alias that jaxtyping cannot inspect.
_Floats: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.floating[Any]]]
_Bytes: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.uint8]]
Float32Array: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.float32]]
"""Of any shape."""
Float64Array: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.float64]]
"""Of any shape."""
if TYPE_CHECKING:
    FloatArray: TypeAlias = _Floats
    """Of any shape."""
    Scalars: TypeAlias = _Floats
    """One number per member of a batch; a NumPy scalar without a batch."""
else:  # NumPy returns a scalar for an array without axes, and its stubs call that an array
    FloatArray = Float[np.ndarray | np.floating, "..."]
    Scalars = Float[np.ndarray | np.floating, "..."]
Vector: TypeAlias = Float[_Floats, "3"]
"""(3,) x, y, z."""
Vectors: TypeAlias = Float[_Floats, "... 3"]
"""(..., 3), batch axes first."""
Quaternion: TypeAlias = Float[_Floats, "4"]
"""(4,) w, x, y, z."""
Quaternions: TypeAlias = Float[_Floats, "... 4"]
"""(..., 4)."""
Commands: TypeAlias = Float[_Floats, "... 4"]
"""(..., 4) vx, vy, vz and yaw rate, of any float dtype."""
Rotations: TypeAlias = Float[_Floats, "... 3 3"]
"""(..., 3, 3) matrices."""
Image: TypeAlias = UInt8[_Bytes, "_height _width 3"]
"""(H, W, 3) RGB."""
Images: TypeAlias = UInt8[_Bytes, "images _height _width 3"]
"""(n, H, W, 3) RGB."""
Action: TypeAlias = Float32[Float32Array, "4"]
"""(4,): vx, vy, vz in m/s and yaw rate in rad/s, in the heading frame."""
ActionChunk: TypeAlias = Float32[Float32Array, "steps 4"]
"""(k, 4) actions for the next k control steps, k >= 1."""

Category = Literal["human_recognition", "symbol_understanding", "reasoning", "racing", "absent"]
Size = Literal["big", "small"]
Shape = Literal["round", "square", "triangle"]
Color = Literal["red", "green", "blue"]
ObstacleKind = Literal["pillar", "wall", "beam", "frame", "person"]
"""What is in the way: an upright cylinder, a wall on the floor, a beam above it, or an empty frame without a panel."""
Outcome = Literal[
    "passed",
    "wrong_gate",
    "collision",
    "missed",
    "out_of_bounds",
    "timeout",
    "invalid",
    "policy_error",
    "not_reached",
    "hesitated",
    "false_alarm",
]
"""How a stage ended. `hesitated`: no gate matches the instruction, and the pilot flew through none but did not
report so. `false_alarm`: the pilot reported that no gate matches the instruction, but one does."""

CATEGORIES: tuple[Category, ...] = ("human_recognition", "symbol_understanding", "reasoning")
"""The paper's three categories, each a choice among gates."""
ALL_CATEGORIES: tuple[Category, ...] = (*CATEGORIES, "racing", "absent")
"""All categories: also racing, with single gates and no choice, and absent, where no gate is right."""
SIZES: tuple[Size, ...] = ("big", "small")
SHAPES: tuple[Shape, ...] = ("round", "square", "triangle")
COLORS: tuple[Color, ...] = ("red", "green", "blue")

ACTION_LIMITS = (3.0, 3.0, 1.5, 1.0)
"""Largest magnitude of each action component, m/s and rad/s; larger values are clipped."""
CONTROL_HZ = 10
"""Rate of the policy's commands."""
REASONER_HZ = 2
"""Rate of the questions to a reasoner, at most; it divides `CONTROL_HZ`."""
IMAGE_SIZE = 256
"""Height and width of the first-person view, pixels."""


@dataclass(frozen=True, slots=True)
class Gate:
    """A gate's appearance; its position belongs to the stage."""

    size: Size
    shape: Shape
    color: Color


@dataclass(frozen=True, slots=True)
class GatePlace:
    """Where a gate is, in the frame of its stage."""

    x: float
    """Centre, m."""
    y: float
    height: float
    """Of the opening's centre above ground, m."""
    yaw: float
    """Heading of the outward normal, rad."""
    sway: float = field(default=0.0, metadata={"json": "where set"})
    """How far it moves with its panel to its left and right, as a pendulum does, m; 0 stands still. Centre is then the
    middle of its way."""
    period: float = field(default=8.0, metadata={"json": "where set"})
    """From one end of its way and back, s."""
    phase: float = field(default=0.0, metadata={"json": "where set"})
    """Of that movement when the flight begins, rad: at pi / 2 it is farthest left."""


Layout: TypeAlias = tuple[GatePlace, GatePlace, GatePlace]
"""The gate layout of a stage, left to right as seen from the start."""


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Something in the way, in the frame of its stage: m, rad, s."""

    kind: ObstacleKind
    x: float
    """Of its centre; of the middle between the ends of its way, if it moves."""
    y: float
    width: float
    """To its left and right; the diameter of a pillar or a person."""
    height: float
    """From its lower to its upper edge."""
    depth: float = 0.1
    """Along its heading, of all but pillars and persons."""
    yaw: float = 0.0
    """Its heading."""
    above: float = 0.0
    """Of its lower edge above ground."""
    sway: float = field(default=0.0, metadata={"json": "where set"})
    """How far it moves to its left and right, as a pendulum does; 0 stands still."""
    period: float = field(default=8.0, metadata={"json": "where set"})
    """From one end of its way and back."""
    phase: float = field(default=0.0, metadata={"json": "where set"})
    """Of that movement when the flight begins: at pi / 2 it is farthest left."""


@dataclass(frozen=True, slots=True)
class Landmark:
    """A panel on a post, without a gate, in the frame of its stage: m, rad."""

    label: str
    """Label reference."""
    x: float
    y: float
    height: float
    """Of the panel's centre above ground."""
    yaw: float
    """Heading that the panel's back faces, as a gate's outward normal."""


@dataclass(frozen=True, slots=True)
class Task:
    """An instruction, three labelled gates and which of them is right."""

    id: str
    """Unique in its suite, for example "open-v1:test/0007"."""
    category: Category
    family: str
    instruction: str
    """The user's instruction; `prompt` in task files."""
    directive: str
    """Plain rewrite that names the right gate; `prompt_simpler` in task files."""
    options: tuple[str, str, str]
    """What the panels show, named as in the published task files."""
    labels: tuple[str, str, str]
    """Label references `kind/concept@style`, one above each gate, left to right as gates 1, 2, 3."""
    target: int | None
    """Index of the right gate, 0 to 2; `correct` in task files is this plus one. None in the family `absent`: no gate
    matches the instruction."""
    gates: tuple[Gate, Gate, Gate]
    board: str | None = None
    """Label reference of the sum on the board in the scene, for families that have one."""
    background: str = "room"
    only: int | None = None
    """Index of the only gate in the scene, 0 to 2, always the target; none if all three are present. A single gate has
    no panel: `labels` are not shown."""
    layout: Layout | None = None
    """Where the gates are; none for the published places."""
    landing: bool = False
    """Whether there are pads on the floor instead of gates, in the gates' colours: the right end is on the right
    one."""
    mission: str | None = None
    """One sentence for the whole track, the same at all its stages: what the pilot gets instead of the
    instruction, which is this stage's part of it."""
    obstacles: tuple[Obstacle, ...] = ()
    """What is in the way."""
    landmark: Landmark | None = None
    """A panel that is no gate's; never together with a board."""
    missing: int | None = None
    """Index of a gate that does not stand, 0 to 2, never the target: two are left to choose from; none if all do."""


Track: TypeAlias = tuple[Task, ...]
"""Tasks flown in sequence in one episode; a single task is a track of one."""


@dataclass(frozen=True, slots=True)
class Stage:
    """A task placed in the world, without its instruction: what simulator and renderer need."""

    gates: tuple[Gate, Gate, Gate]
    labels: tuple[str, str, str]
    """Label references, one per gate."""
    board: str | None = None
    """Label reference of the board, or none."""
    origin: tuple[float, float] = (0.0, 0.0)
    """World x, y of the stage origin, m."""
    yaw: float = 0.0
    """Heading of the stage's x axis in the world, rad."""
    only: int | None = field(default=None, metadata={"json": "where set"})
    """Index of the only gate in the scene, 0 to 2, without a panel; none if all three are present, with panels."""
    layout: Layout | None = field(default=None, metadata={"json": "where set"})
    """Where the gates are; none for the published places."""
    landing: bool = field(default=False, metadata={"json": "where set"})
    """Whether there are pads on the floor instead of gates, in their colours, without panels."""
    obstacles: tuple[Obstacle, ...] = field(default=(), metadata={"json": "where set"})
    """What is in the way."""
    landmark: Landmark | None = field(default=None, metadata={"json": "where set"})
    """A panel that is no gate's; its picture takes the place of the board's."""
    missing: int | None = field(default=None, metadata={"json": "where set"})
    """Index of a gate that does not stand, 0 to 2; none if all do."""


@dataclass(frozen=True, slots=True)
class DroneState:
    """True rigid-body state."""

    position: Vector
    """(3,) world, m."""
    velocity: Vector
    """(3,) world, m/s."""
    quaternion: Quaternion
    """(4,) w, x, y, z, body to world."""
    body_rates: Vector
    """(3,) body FLU, rad/s."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Input of a policy: no position, no gate, no ground truth."""

    image: Image
    """(256, 256, 3) first-person view."""
    instruction: str
    """The user's instruction or, with a reasoner, its directive."""
    velocity: Vector
    """(3,) float32, heading frame, m/s."""
    height: float
    """Above ground, m."""
    yaw_rate: float
    """Positive to the left, rad/s."""
    time: float
    """Since the start of the flight, s."""
    down: Image | None = None
    """(256, 256, 3) what a camera under the drone sees, straight down in its body's frame, its top to the front; only
    for policies with `needs_down_camera`."""


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """Privileged information about the current stage, which only a simulator has."""

    task: Task
    stage: Stage
    state: Callable[[], DroneState]
    """Returns the drone's current true state."""
    hull_radius: float = 0.13
    """Of the drone's bounding sphere, m."""
    time: Callable[[], float] = lambda: 0.0
    """Returns the time since the flight began, s: gates that move are where they are then."""


@dataclass(frozen=True, slots=True)
class EpisodeContext:
    """What a policy or reasoner receives at the start of every stage."""

    instruction: str
    """The user's instruction. With a reasoner, a policy's observations contain the directive instead."""
    seed: int = 0
    """Random seed of this episode, the same at all its stages; 0 unless `needs_seed` is declared."""
    stage: int = 0
    """0 at the start of a flight; larger at each later stage."""
    ground_truth: GroundTruth | None = None
    """Only in a simulator, and only if `needs_ground_truth` is declared."""
    real_time: bool = False
    """Whether the drone flies on while the policy computes, on the wall clock; virtual time waits for it."""
    same_stage: bool = False
    """Whether this is another instruction in the middle of a stage: the gates stand where they stood."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """A reasoner's answer."""

    directive: str
    """Plain sentence for the policy, such as "Fly through the small red round gate". "Hold position" declines: no gate
    matches the instruction (`tasks.directives.HOLD`)."""
    gate: int | None
    """Index of the gate, 0 to 2 from left to right, if the reasoner reports it."""
    confidence: float
    """0 to 1."""
    age: float = 0.0
    """Seconds since the frame that it is based on."""
    present: float | None = None
    """Probability that a gate shows what the instruction asks for, 0 to 1; none if it is not estimated."""
    seen: tuple[bool, ...] = ()
    """Of a mission's choice, and of those in the branch that was taken: whether the thing is there."""


@dataclass(frozen=True, slots=True)
class SubGoal:
    """A part of a mission: a stage, the landing, or a choice between parts by what is seen when it is reached."""

    kind: Literal["fly", "land", "if"]
    instruction: str
    """A sentence about this stage alone; for the pad to land on its directive; of a choice, what is to be there."""
    then: tuple[SubGoal, ...] = ()
    """Of a choice: what is done where that is there."""
    otherwise: tuple[SubGoal, ...] = ()
    """Of a choice: what is done where it is not."""
    avoid: frozenset[str] = frozenset()
    """What is never flown through: gates by a look or several ("red", "red triangle"), and sentences that ask for a
    thing."""
    rejected: frozenset[Color] = frozenset()
    """Of gates that a person ruled out in flight: the next best one is meant, however little it fits."""


@dataclass(frozen=True, slots=True)
class SeenPanel:
    """What a reasoner has read of a gate's panel, in all frames of the stage so far; for people to look at."""

    color: Color
    """Of the gate."""
    box: tuple[float, float, float] | None
    """Centre u, v and height of the panel in the newest frame, pixels; none if that did not show it."""
    shown: str
    """What it takes the panel for, in a few words."""
    readings: tuple[tuple[str, float], ...]
    """The likeliest things on it with their probabilities, likeliest first."""
    right: float | None = None
    """Probability that the gate is the right one; none before an answer."""
    gate: Gate | None = None
    """How the gate looks, if that was read."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened in a flight."""

    time: float
    """Since the start of the flight, s."""
    kind: EventKind
    text: str = ""
    """An instruction, a directive, or what went wrong."""
    age_s: float | None = None
    """Between an answer's frame and its arrival, or since a missed deadline, s."""


@dataclass(frozen=True, slots=True)
class ReasonerReport:
    """What a reasoner did in one stage."""

    answers: int
    """Number of usable answers."""
    faults: Mapping[str, int]
    """Number of unusable answers, by `ReasonerFault`."""
    changes: int
    """Number of directives that replaced another one."""
    age_s: float | None
    """Mean age of the directives' frames while the policy followed them."""
    rate_hz: float | None
    """Answers and faults per second."""
    size: bool | None
    """Whether the last directive's size is the right gate's; none if it names no size, or there was no directive."""
    color: bool | None
    shape: bool | None
    gate: bool
    """Whether the last directive fits the right gate and no other; if none is right, whether it declines."""
    late: int = field(default=0, metadata={"json": "where set"})
    """Number of answers and faults that came after the next question was due."""


@dataclass(frozen=True, slots=True)
class StageResult:
    """How one stage of an episode ended."""

    task_id: str
    category: Category
    family: str
    target: int | None
    """Index of the right gate, 0 to 2; none if no gate matches the instruction."""
    outcome: Outcome
    chosen: int | None
    """Index of the gate flown at, 0 to 2; none if the flight favoured no gate."""
    time_s: float
    """Duration of the stage."""
    path_m: float
    """Path length."""
    path_ratio: float | None
    """Path length over the straight line from the stage's start to the gate; only for gates flown through."""
    clearance_m: float | None
    """Distance between the drone's hull and the frame when its centre crossed the gate plane."""
    gate_distance_m: float | None
    """Closest approach of the drone's centre to the right gate's centre (the published rule requires 1 m); none if the
    stage was not reached."""
    directive: str | None = None
    """The reasoner's last directive, if there was a reasoner."""
    reasoner: ReasonerReport | None = field(default=None, metadata={"json": "where set"})
    """What the reasoner did, if there was one and the stage was reached."""
    obstacle_m: float | None = field(default=None, metadata={"json": "where set"})
    """Smallest distance between the drone's hull and an obstacle, 0 on contact; none where nothing is in the way."""
    forbidden_s: float | None = field(default=None, metadata={"json": "where set"})
    """Time within 1 m of the centre of a gate of a colour that the mission forbids; none where no mission is flown."""


@dataclass(frozen=True, slots=True)
class GuardReport:
    """How many commands of a flight the guard changed, in all and by cause."""

    touched: int = 0
    """Commands that were changed; one may have several causes."""
    speed: int = 0
    """Speed limits."""
    slew: int = 0
    """Slew limits: a jump from the previous command."""
    fence: int = 0
    """The geofence, including its floor and ceiling."""


@dataclass(frozen=True, slots=True)
class EpisodeResult:
    """One flight: a stage, or the stages of a track in order."""

    episode: int
    """Index in the suite."""
    seed: int
    stages: tuple[StageResult, ...]
    steps: int
    """Control steps flown."""
    message: str = ""
    """One sentence: why the episode is invalid, or why the policy failed."""
    guard: GuardReport | None = field(default=None, metadata={"json": "where set"})
    """What the guard changed, if it was on."""
    repeated: tuple[float, float, float, float] | None = field(default=None, metadata={"json": "where set"})
    """The first action of the policy's answer, if it gave the same answer every time, and was asked at least twice."""
