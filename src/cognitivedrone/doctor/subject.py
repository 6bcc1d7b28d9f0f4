"""The policy under examination, what is asked of it and found, and the faults that are looked for.

Views of known answers: what the drone sees on the expert's flights, and the commands that lead to each gate.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.control.calls import begin_stage
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.envs.worlds import SimulatedDrone, Worlds, clip_action
from cognitivedrone.frames import yaw_of
from cognitivedrone.interfaces import Policy
from cognitivedrone.labels import load_pack
from cognitivedrone.policies.expert import Expert, ExpertConfig, intent
from cognitivedrone.tasks import TRAIN_NAME, open_suite
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.types import (
    ACTION_LIMITS,
    ActionChunk,
    Commands,
    DroneState,
    EpisodeContext,
    GroundTruth,
    Image,
    Observation,
    Stage,
    Task,
)
from cognitivedrone.world.geometry import gate_centers, gate_yaws

TASKS = 9
"""Flights; a third for each gate."""
STEPS = (0, 8, 16)
"""Control steps of a flight at which it is looked around."""
_CANDIDATES = 60
_SWAY = (0.0, 0.35, 0.2, 0.15)  # of the commands, so that heights, velocities and turns differ


@dataclass(frozen=True, slots=True)
class LabelledView:
    """What the drone sees at a moment of a flight, and what the expert would do."""

    task: Task
    stage: Stage
    state: DroneState
    observation: Observation
    """With the task's own instruction."""
    commands: Commands
    """(3, 4) the expert's command towards each of the three gates."""
    flying: bool
    """Whether the drone moves already; it hovers at the start."""

    def directive(self, gate: int) -> str:
        """The sentence that names a gate."""
        return write_directive(self.task.gates[gate])

    def truth(self, gate: int) -> GroundTruth:
        """Ground truth in which that gate is right."""
        return GroundTruth(replace(self.task, target=gate), self.stage, lambda: self.state)


def look_around(tasks: int = TASKS, seed: int = 0) -> list[LabelledView]:
    """The views of the expert's flights, as many to the left gate as ahead and to the right; raises `RenderError`."""
    with Worlds(1, load_pack(), TrackConfig()) as worlds:
        suite = open_suite(TRAIN_NAME, None, size=_CANDIDATES, seed=seed)
        chosen: dict[int, list[int]] = {0: [], 1: [], 2: []}
        for episode, (task, *_) in enumerate(suite.tracks):
            if task.target is not None and task.only is None and len(chosen[task.target]) < tasks // 3:
                chosen[task.target].append(episode)
        episodes = sorted(episode for part in chosen.values() for episode in part)
        return [
            view
            for episode in episodes
            for view in _flight(worlds.runners[0], suite.tracks[episode][0], episode_rng(suite.digest, episode, seed))
        ]


def _flight(runner: TrackRunner, task: Task, rng: np.random.Generator) -> Iterator[LabelledView]:
    runner.begin((task,), rng)
    drone, expert = SimulatedDrone(runner, down=True), Expert()
    expert.reset(EpisodeContext(task.instruction, ground_truth=runner.truth()))
    for step in range(STEPS[-1] + 1):
        if step in STEPS:
            seen = drone.observe()
            seen = replace(seen, image=seen.image.copy(), down=None if seen.down is None else seen.down.copy())
            yield LabelledView(task, runner.stage, deepcopy(runner.world.state()), seen, _commands(runner), step > 0)
        runner.world.command(clip_action(expert.command() + rng.normal(size=4) * _SWAY))
        runner.world.advance()


def _commands(runner: TrackRunner) -> Commands:
    state, stage = runner.world.state(), runner.stage
    centers, yaws = gate_centers(stage, runner.world.time()), gate_yaws(stage)
    position, velocity = np.tile(state.position, (3, 1)), np.tile(state.velocity, (3, 1))
    yaw = np.full(3, float(yaw_of(state.quaternion)))
    return clip_action(intent(position, velocity, yaw, centers, yaws, ExpertConfig()))


Verdict = Literal["good", "wrong", "unknown"]
Answer: TypeAlias = tuple[Verdict, str]


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found by one question."""

    question: str
    verdict: Verdict
    sentence: str


Numbers = NDArray[np.float64]
ImageChange = Callable[[Image], Image]
StateChange = Callable[[Numbers], Numbers]
SEED = 7
LIMITS = np.array(ACTION_LIMITS)


@dataclass(frozen=True, slots=True)
class Question:
    """A view with an instruction, and maybe something that is not as in flight."""

    view: LabelledView
    gate: int
    """The gate that is meant."""
    instruction: str
    image: Image | None = None
    """In place of the view's."""
    state: Numbers | None = None
    """(5,) in place of the view's: velocity, height, yaw rate."""
    reset_instruction: str | None = None
    """What `reset` gets, where that differs from the observation's instruction."""

    @property
    def seen(self) -> Image:
        """The image."""
        return self.view.observation.image if self.image is None else self.image

    @property
    def numbers(self) -> Numbers:
        """(5,) the state."""
        seen = self.view.observation
        given = np.array([*seen.velocity, seen.height, seen.yaw_rate], np.float64)
        return given if self.state is None else self.state

    @property
    def expected(self) -> Numbers:
        """(4,) the expert's command."""
        return np.asarray(self.view.commands[self.gate], np.float64)


@dataclass
class Subject:
    """A policy and what was seen of it; `clock` returns seconds."""

    policy: Policy
    clock: Callable[[], float] = time.perf_counter
    seconds: list[float] = field(default_factory=list)
    """Of every answer."""
    lengths: set[int] = field(default_factory=set)
    """Of the chunks."""
    largest: Numbers = field(default_factory=lambda: np.zeros(4))
    """(4,) largest magnitude of each component of a command."""
    changes_image: bool = False
    """Whether it has written into an observation's image."""
    reuses_array: bool = False
    """Whether an answer changed after it was given."""
    _last: tuple[ActionChunk, ActionChunk] | None = None

    def __post_init__(self) -> None:
        self._timed = TimedPolicy(self.policy)

    def start(self, question: Question) -> None:
        """Tell it that a flight begins."""
        reset_instruction = question.instruction if question.reset_instruction is None else question.reset_instruction
        seed = SEED if self.policy.needs_seed else 0
        begin_stage(self._timed, EpisodeContext(reset_instruction, seed, 0, question.view.truth(question.gate)))

    def answer(self, question: Question) -> ActionChunk:
        """Its commands (k, 4), without a new start. Raises `PolicyError` for what it raises, and for wrong answers."""
        state, image = question.numbers, question.seen
        seen = replace(
            question.view.observation,
            image=image.copy(),
            instruction=question.instruction,
            velocity=state[:3].astype(np.float32),
            height=float(state[3]),
            yaw_rate=float(state[4]),
            time=0.0,
        )
        begin = self.clock()
        given = self._timed.act(seen)
        self.seconds.append(self.clock() - begin)
        if self._last is not None and not np.array_equal(*self._last):
            self.reuses_array = True
        chunk = given.copy()
        self._last = given, chunk
        self.changes_image |= not np.array_equal(seen.image, image)
        self.lengths.add(len(chunk))
        self.largest = np.maximum(self.largest, np.abs(chunk).max(axis=0))
        return chunk

    def ask(self, question: Question) -> ActionChunk:
        """Its commands (k, 4) at the start of a flight; raises as `answer`."""
        self.start(question)
        return self.answer(question)

    def first(self, questions: Sequence[Question]) -> Numbers:
        """(n, 4) the first command for each question, each at the start of a flight."""
        return np.array([self.ask(question)[0] for question in questions], np.float64)


def agreement(answers: Numbers, expected: Numbers) -> float:
    """How well answers (n, 4) turn to where they should, -1 to 1: mean correlation of sideways and yaw commands."""
    return (correlation(answers[:, 1], expected[:, 1]) + correlation(answers[:, 3], expected[:, 3])) / 2


def correlation(a: Numbers, b: Numbers) -> float:
    """Cosine of two arrays of equal shape; 0 where one is zero."""
    size = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def distance(answers: Numbers, others: Numbers) -> float:
    """Root mean square difference of commands (n, 4), as a share of the limits."""
    return float(np.sqrt((((answers - others) / LIMITS) ** 2).mean()))


def unchanged(value: Any) -> Any:
    """The same value."""
    return value


def expected_of(questions: list[Question]) -> Numbers:
    """(n, 4) the expert's commands."""
    return np.array([question.expected for question in questions])


def with_image(questions: list[Question], change: ImageChange) -> list[Question]:
    """The questions, each with its image changed."""
    return [
        replace(question, image=np.ascontiguousarray(change(question.view.observation.image))) for question in questions
    ]


def with_images(
    questions: list[Question], images: list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]
) -> list[Question]:
    """The questions, each with another image."""
    return [replace(question, image=image) for question, image in zip(questions, images, strict=True)]


def size(answers: Numbers) -> float:
    """Root mean square of commands (n, 4), as a share of the limits."""
    return max(distance(answers, np.zeros_like(answers)), 1e-9)


def percent(share: float) -> str:
    """A share in per cent."""
    return f"{100 * share:.2g} %"


STATE = ("vx", "vy", "vz", "height", "yaw_rate")
IMAGES: Mapping[str, ImageChange] = {
    "its red and blue channels are exchanged (it expects BGR; images are RGB)": lambda x: x[..., ::-1],
    "its colour channels are rotated (images are RGB)": lambda x: x[..., [1, 2, 0]],
    "its colour channels are rotated the other way (images are RGB)": lambda x: x[..., [2, 0, 1]],
    "its red and green channels are exchanged (images are RGB)": lambda x: x[..., [1, 0, 2]],
    "its green and blue channels are exchanged (images are RGB)": lambda x: x[..., [0, 2, 1]],
    "it is mirrored left to right": lambda x: x[:, ::-1],
    "it is upside down (row 0 is the top)": lambda x: x[::-1],
    "it is turned by 180 degrees": lambda x: x[::-1, ::-1],
    "its rows and columns are exchanged (images are height x width x 3)": lambda x: x.transpose(1, 0, 2),
    "it is turned by 90 degrees to the left": lambda x: np.rot90(x, 1),
    "it is turned by 90 degrees to the right": lambda x: np.rot90(x, -1),
    "its channels come first (images are height x width x 3)": lambda x: x.reshape(3, *x.shape[:2]).transpose(1, 2, 0),
    "its brightness is inverted": lambda x: 255 - x,
}
"""What undoes each fault of the image."""


def _states() -> Iterator[tuple[str, StateChange]]:
    for i, j in itertools.combinations(range(5), 2):
        order = [*range(5)]
        order[i], order[j] = j, i
        yield f"{STATE[i]} and {STATE[j]} are exchanged", partial(np.take, indices=order)
    rolled = (np.roll(range(5), n).tolist() for n in range(1, 5))
    others = ([1, 2, 0, 3, 4], [2, 0, 1, 3, 4], [1, 2, 3, 0, 4], [3, 0, 1, 2, 4], [2, 3, 4, 0, 1], [4, 3, 2, 1, 0])
    for order in (*others, *rolled):
        shown = ", ".join(STATE[i] for i in np.argsort(order))
        yield f"it is read in the order {shown}", partial(np.take, indices=order)
    for i in range(5):
        signs = np.where(np.arange(5) == i, -1.0, 1.0)
        yield f"the sign of {STATE[i]} is inverted", partial(np.multiply, signs)


STATES: Mapping[str, StateChange] = dict(_states())
"""What undoes each fault of the state: numbers exchanged, in another order, or negated."""
RANGES: Mapping[str, ImageChange] = {
    "every image looks black to it": np.zeros_like,
    "all pixels below 255 look black to it": lambda x: np.where(x == 255, 255, 0).astype(np.uint8),
    "all pixels above 0 look white to it": lambda x: np.where(x > 0, 255, 0).astype(np.uint8),
}
"""What does not change the answers of a policy with that fault."""
