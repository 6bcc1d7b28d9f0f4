"""The values that travel between rooms: frozen, without behaviour, with shapes, units and frames in the docstrings.

Frames and units (converted in `frames.py` alone):

- World: ENU, metres. Body: FLU (x forward, y left, z up). Heading frame: the body frame turned level, yaw only.
- Quaternions are (w, x, y, z), body to world. Angles in radians, yaw positive to the left. Time in seconds.
- Images are uint8 (H, W, 3) RGB.

The names of arrays say shape and kind of number; the tests check both in every call (`tests/support/typechecked.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Float32, UInt8

from cognitivedrone.choices import EventKind

# Not NumPy's NDArray: of some versions that is an alias that jaxtyping cannot look into.
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
    """One number for each member of a batch; a NumPy scalar where there is no batch."""
else:  # NumPy gives a scalar for an array without axes, and its stubs call that an array
    FloatArray = Float[np.ndarray | np.floating, "..."]
    Scalars = Float[np.ndarray | np.floating, "..."]
Vector: TypeAlias = Float[_Floats, "3"]
"""(3,) x, y, z."""
Vectors: TypeAlias = Float[_Floats, "... 3"]
"""(..., 3), with the axes of the batch in front."""
Quaternion: TypeAlias = Float[_Floats, "4"]
"""(4,) w, x, y, z."""
Quaternions: TypeAlias = Float[_Floats, "... 4"]
"""(..., 4)."""
Commands: TypeAlias = Float[_Floats, "... 4"]
"""(..., 4) vx, vy, vz and yaw rate, of whatever kind of number."""
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

Category = Literal["human_recognition", "symbol_understanding", "reasoning", "racing"]
Size = Literal["big", "small"]
Shape = Literal["round", "square", "triangle"]
Color = Literal["red", "green", "blue"]
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
]

CATEGORIES: tuple[Category, ...] = ("human_recognition", "symbol_understanding", "reasoning")
"""The three of the paper, which ask for a choice."""
ALL_CATEGORIES: tuple[Category, ...] = (*CATEGORIES, "racing")
"""And that of gates that stand alone, where there is nothing to choose."""
SIZES: tuple[Size, ...] = ("big", "small")
SHAPES: tuple[Shape, ...] = ("round", "square", "triangle")
COLORS: tuple[Color, ...] = ("red", "green", "blue")

ACTION_LIMITS = (3.0, 3.0, 1.5, 1.0)
"""Largest magnitude of each action component that is flown, m/s and rad/s; what lies beyond is clipped."""
CONTROL_HZ = 10
"""Rate of the policy's commands."""
IMAGE_SIZE = 256
"""Height and width of the first-person view, pixels."""


@dataclass(frozen=True, slots=True)
class Gate:
    """What a gate looks like; where it stands is the stage's matter."""

    size: Size
    shape: Shape
    color: Color


@dataclass(frozen=True, slots=True)
class Task:
    """An instruction, three labelled gates and the one that is right."""

    id: str
    """Unique in its suite, for example "open-v1:test/0007"."""
    category: Category
    family: str
    instruction: str
    """What the user says; `prompt` in task files."""
    directive: str
    """The plain rewrite that names the right gate; `prompt_simpler` in task files."""
    options: tuple[str, str, str]
    """What the panels show, as published task files name it."""
    labels: tuple[str, str, str]
    """Label references `kind/concept@style`, one above each gate, left to right as gates 1, 2, 3."""
    target: int
    """Index of the right gate, 0 to 2; `correct` in task files is this plus one."""
    gates: tuple[Gate, Gate, Gate]
    board: str | None = None
    """Label reference of the sum that hangs in the scene, where the family has one."""
    background: str = "room"
    only: int | None = None
    """Index of the gate that stands alone, 0 to 2, always the target; none where all three stand. Without panels: those
    of `labels` are not shown."""


Track: TypeAlias = tuple[Task, ...]
"""Tasks flown one after the other in one episode; a single task is a track of one."""


@dataclass(frozen=True, slots=True)
class Stage:
    """A task placed in the world, without its question: what the simulator and the renderer know."""

    gates: tuple[Gate, Gate, Gate]
    labels: tuple[str, str, str]
    """Label references, one a gate."""
    board: str | None = None
    """Label reference of the board, or none."""
    origin: tuple[float, float] = (0.0, 0.0)
    """World x, y of the stage origin, m."""
    yaw: float = 0.0
    """Heading of the stage's x axis in the world, rad."""
    only: int | None = field(default=None, metadata={"json": "where set"})
    """Index of the only gate that stands, 0 to 2, without a panel; none where all three stand with theirs."""


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
    """What a policy may see: no position, no gate, no truth."""

    image: Image
    """(256, 256, 3) first-person view."""
    instruction: str
    """What to do: the instruction or, behind a reasoner, its directive."""
    velocity: Vector
    """(3,) float32, heading frame, m/s."""
    height: float
    """Above ground, m."""
    yaw_rate: float
    """Positive to the left, rad/s."""
    time: float
    """Since the start of the flight, s."""


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """What only a simulator knows of the stage at hand."""

    task: Task
    stage: Stage
    state: Callable[[], DroneState]
    """The drone's true state now."""


@dataclass(frozen=True, slots=True)
class EpisodeContext:
    """What a policy or reasoner is given at the start of every stage."""

    instruction: str
    """The user's. Behind a reasoner a policy's observations hold the directive in its place."""
    seed: int = 0
    """To draw random numbers from in this episode, the same at every stage of it; 0 unless `needs_seed` is declared."""
    stage: int = 0
    """0 where a new flight begins; larger at each later stage of it."""
    ground_truth: GroundTruth | None = None
    """In a simulator, where `needs_ground_truth` is declared."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """A reasoner's answer."""

    directive: str
    """Plain sentence for the policy, such as "Fly through the small red round gate"."""
    gate: int | None
    """Index of the gate that is meant, 0 to 2 from left to right, where the reasoner can tell."""
    confidence: float
    """0 to 1."""
    age: float = 0.0
    """Seconds between the frame it was read from and now."""
    present: float | None = None
    """How likely what is asked for is shown at any gate, 0 to 1; none where the reasoner cannot tell."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened in a flight."""

    time: float
    """Since the start of the flight, s."""
    kind: EventKind
    text: str = ""
    """An instruction, a directive, or what went wrong."""
    age_s: float | None = None
    """Between the frame of an answer and its arrival, or between a deadline and now."""


@dataclass(frozen=True, slots=True)
class ReasonerReport:
    """What a reasoner did in one stage."""

    answers: int
    """That could be used."""
    faults: Mapping[str, int]
    """Answers that could not be used, by `ReasonerFault`."""
    changes: int
    """Directives that replaced another one."""
    age_s: float | None
    """Mean age of the frames behind the directives, when the policy flew by them."""
    rate_hz: float | None
    """Answers and faults a second."""
    size: bool | None
    """Whether the last directive's size is the right gate's; none where it does not say, or there was no directive."""
    color: bool | None
    shape: bool | None
    gate: bool
    """Whether the last directive fits the right gate and no other."""


@dataclass(frozen=True, slots=True)
class StageResult:
    """How one stage of an episode ended."""

    task_id: str
    category: Category
    family: str
    target: int
    """Index of the right gate, 0 to 2."""
    outcome: Outcome
    chosen: int | None
    """Index of the gate flown at, 0 to 2; none where the flight favoured no gate."""
    time_s: float
    """Duration of the stage."""
    path_m: float
    """Length flown."""
    path_ratio: float | None
    """Length flown over the straight line from the stage's start to the gate; for gates flown through."""
    clearance_m: float | None
    """Room between the drone's hull and the frame when its centre crossed the gate plane."""
    gate_distance_m: float | None
    """Closest approach of the drone's centre to the right gate's centre (the published rule asks for 1 m); none where
    the stage was not reached."""
    directive: str | None = None
    """The last directive of the reasoner, if one flew along."""
    reasoner: ReasonerReport | None = field(default=None, metadata={"json": "where set"})
    """What the reasoner did, if one flew along and the stage was reached."""


@dataclass(frozen=True, slots=True)
class GuardReport:
    """How many commands of a flight the rules of safety changed, by what changed them."""

    touched: int = 0
    """Commands that were changed at all; by several of what follows, perhaps."""
    speed: int = 0
    """Beyond the largest speed."""
    slew: int = 0
    """A jump from the command before."""
    fence: int = 0
    """Outwards at the fence, its floor and its ceiling included."""


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
    """Why the episode is invalid or the policy failed, in one sentence."""
    guard: GuardReport | None = field(default=None, metadata={"json": "where set"})
    """What the rules of safety changed, where they flew along."""
