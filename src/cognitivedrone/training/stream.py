"""Training data made while it is used: drones flown, disturbed and looked at in many scenes at once.

Each world of a `Rehearsal` flies toward one gate, by the expert with wandering wrong commands on top, or by the network
itself as it was a while ago (DAgger, all the time). Some moments of every flight become samples: a rendered frame,
everything that is true of it, and several sentences that ask for this gate or that one. What is flown tells nothing
about what is asked, except where the panels cannot be read: there a drone can only go on where it is going.

A stream is a pure function of recipe, seed and the weights that fly along: the same batches on every machine of a kind.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.envs.course import draw_start, scenery_of, stage_of
from cognitivedrone.envs.drone import clip_action
from cognitivedrone.frames import rotate_yaw
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.labels import load_pack
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.policies.expert import ExpertConfig, intent
from cognitivedrone.sim.airframe import RACER
from cognitivedrone.sim.simulator import Simulator, Start
from cognitivedrone.tasks import BASE_FAMILIES, train_task
from cognitivedrone.tasks.racing import race_task
from cognitivedrone.training.facets import board_facets, gate_facets, panel_facets
from cognitivedrone.training.questions import ask, families
from cognitivedrone.training.truth import Poses, Truths, truths
from cognitivedrone.types import CONTROL_HZ, FloatArray, Image, Stage, Task
from cognitivedrone.world import geometry
from cognitivedrone.world.look import PLAIN, varied_look

Batch: TypeAlias = dict[str, NDArray[np.generic]]
"""Named arrays, all with the sample as their first axis, but for the `text_` ones; see `Rehearsal.batches`."""

NONE_IN_VIEW = 3
"""The choice where the gate asked for is not in view."""
_TOO_LONG = 14 * CONTROL_HZ  # control steps of a flight, after which it is hopeless
_BOUND_M = 9.0  # nor is there anything to learn further than this from the stage's origin

_TEXT_SHARES = {"math": 0.3, "association": 0.25, "food": 0.08, "math_board": 0.12}
"""How often families are trained without an image; the others share the rest."""


class Learner(Protocol):
    """What flies along: actions for images (n, 256, 256, 3), states (n, 5) and sentences."""

    def act(self, images: Image, states: NDArray[np.float32], texts: list[str]) -> FloatArray:
        """Actions (n, 4), m/s and rad/s."""
        ...


@dataclass(frozen=True, slots=True)
class StreamRecipe:
    """How training flights go and what is taken from them."""

    batch: int = 16
    """Frames in a batch."""
    sentences: int = 6
    """Asked of each frame."""
    texts: int = 96
    """Sentences in a batch that are trained without a frame."""
    chunk: int = 1
    suite: str = "train"
    """`train`, or `race`: single gates without panels."""
    directives: bool = True
    """Whether directives are among the sentences."""
    varied: float = 0.5
    """Share of flights in a varied look."""
    rolling: float = 0.2
    """Share of flights that begin behind the start box and in motion, as behind a gate of a track."""
    off_track: float = 0.35
    """Share of flights that begin on the way, aside and turned."""
    wander: float = 0.6
    """Share of the expert's flights that are disturbed by wandering commands."""
    wind_m_s: float = 1.0
    """Largest steady wind."""
    learner: float = 0.25
    """Share of worlds that the network flies, once there is one."""
    worlds: int = 16
    """Flown together by each generating process."""
    sampled: float = 0.3
    """Share of moments that become samples."""
    pool: int = 8
    """Batches among which samples are shuffled."""
    expert: ExpertConfig = field(default_factory=ExpertConfig)
    """The teacher."""


class _World:
    """One flight."""

    def __init__(self, task: Task, stage: Stage, flown: int, *, learner: bool, wander: float, speed: float) -> None:
        self.task = task
        self.stage = stage
        self.flown = flown
        self.learner = learner
        self.wander = wander
        self.speed = speed
        self.wrong = np.zeros(4)
        self.steps = 0
        self.panels = np.stack([panel_facets(label) for label in stage.labels])
        self.gates = np.stack([gate_facets(gate) for gate in stage.gates])
        self.board = board_facets(stage.board) if stage.board else np.full(3, -1)


class Rehearsal:
    """Worlds in which training flights are flown."""

    def __init__(self, recipe: StreamRecipe, vocabulary: Vocabulary, text_length: int) -> None:
        self.recipe = recipe
        self.vocabulary = vocabulary
        self.text_length = text_length
        self._simulator = Simulator(recipe.worlds)
        self._labels: LabelPack = load_pack("open-v1")
        self._rng = np.random.default_rng()
        self._learner: Learner | None = None
        self._flights: list[_World] = []

    def close(self) -> None:
        """Free the renderer."""
        self._simulator.close()

    def batches(self, seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
        """Batches without end, B frames each, from flights that all begin now; `learner` flies some where given.

        image (B, 256, 256, 3) uint8; state (B, 5); the fields of `Truths`; panel_facets (B, 3, 10), gate_facets
        (B, 3, 3), board_facets (B, 3), indices into `FACETS` or -1; flown (B,) the gate flown at; tokens
        (B, K, L), asked (B, K) the gate asked for, choice (B, K) the same, or 3 where it is not in view. And
        text_tokens (T, L), text_panels (T, 3, 10), text_gates (T, 3, 3), text_board (T, 3), text_asked (T,).
        """
        self._rng, self._learner = np.random.default_rng(seed), learner
        self._flights = [self._begin(world) for world in range(self.recipe.worlds)]
        pool: list[Batch] = []
        size = self.recipe.batch * self.recipe.pool
        while True:
            while sum(len(part["flown"]) for part in pool) < size:
                pool.extend(self._step())
            together = {name: np.concatenate([part[name] for part in pool]) for name in pool[0]}
            order = self._rng.permutation(len(together["flown"]))
            for first in range(0, size, self.recipe.batch):
                chosen = order[first : first + self.recipe.batch]
                yield {name: values[chosen] for name, values in together.items()} | self._texts()
            pool = [{name: values[order[size:]] for name, values in together.items()}]

    def _begin(self, world: int) -> _World:
        rng, recipe = self._rng, self.recipe
        make = race_task if recipe.suite == "race" else train_task
        task = make(int(rng.integers(2**31)), 0)
        stage = stage_of(task)
        look = varied_look(rng) if rng.random() < recipe.varied else PLAIN
        start, velocity = self._draw_start()
        self._simulator.begin(world, stage, scenery_of(stage, self._labels, look), start)
        self._simulator.flight.reset(
            world, np.array(start.position), start.yaw, rotate_yaw(velocity, start.yaw), wind=np.array(start.wind)
        )
        others = [gate for gate in self._askable(task) if gate != task.target and stage.only is None]
        learner = self._learner is not None and world < recipe.learner * recipe.worlds
        flown = task.target if learner or not others or rng.random() < 0.5 else int(rng.choice(others))
        wander = float(rng.uniform(0.3, 1.2)) if rng.random() < recipe.wander else 0.0
        speed = float(rng.uniform(1.3, 1.8))
        return _World(task, stage, flown, learner=learner, wander=wander, speed=speed)

    def _draw_start(self) -> tuple[Start, FloatArray]:
        """Where a flight begins, and its velocity then, heading frame, m/s."""
        rng, recipe = self._rng, self.recipe
        published = draw_start(rng, RACER.hull_radius, recipe.wind_m_s * float(rng.random()))
        kind = float(rng.random())
        if kind < recipe.rolling:
            x, y, z = rng.uniform((-3.0, -0.6, 0.4), (-1.0, 0.6, 1.6))
            velocity = rng.uniform((0.6, -0.4, -0.3), (2.0, 0.4, 0.3))
            return Start((x, y, z), float(rng.uniform(-0.35, 0.35)), published.wind), velocity
        if kind < recipe.rolling + recipe.off_track:
            x, y, z = rng.uniform((-2.0, -2.5, 0.35), (2.6, 2.5, 2.2))
            velocity = rng.uniform((-0.5, -0.8, -0.5), (1.8, 0.8, 0.5))
            return Start((x, y, z), float(rng.uniform(-0.7, 0.7)), published.wind), velocity
        return published, np.zeros(3)

    def _poses(self, worlds: NDArray[np.intp]) -> Poses:
        flight = self._simulator.flight
        return Poses(
            flight.position[worlds], flight.quaternion[worlds], flight.velocity[worlds], flight.body_rates[worlds, 2]
        )

    def _step(self) -> list[Batch]:
        """One control step of all worlds; the samples taken before it."""
        taken = np.flatnonzero(self._rng.random(self.recipe.worlds) < self.recipe.sampled)
        led = np.array([w for w, flight in enumerate(self._flights) if flight.learner], dtype=np.intp)
        shown = np.union1d(taken, led)
        frames = self._simulator.frames(worlds=shown.tolist())
        samples = [self._sample(taken, frames[np.isin(shown, taken)])] if len(taken) else []
        self._command(led, frames[np.isin(shown, led)])
        verdicts = self._simulator.advance()
        flight = self._simulator.flight
        far = (np.abs(flight.position[:, :2]) > _BOUND_M).any(axis=1) | flight.diverged
        for world, verdict in enumerate(verdicts):
            if verdict is not None or far[world] or self._flights[world].steps > _TOO_LONG:
                self._flights[world] = self._begin(world)
        return samples

    def _command(self, led: NDArray[np.intp], frames: Image) -> None:
        """Send every drone on its way."""
        flight, flights = self._simulator.flight, self._flights
        centers = np.stack([geometry.gate_centers(each.stage)[each.flown] for each in flights])
        yaws = np.array([geometry.gate_yaws(each.stage)[each.flown] for each in flights])
        actions = intent(flight.position, flight.velocity, flight.yaw, centers, yaws, self.recipe.expert)
        kicks = self._rng.standard_normal((len(flights), 4)) * (1.0, 1.0, 0.6, 0.8)
        for world, each in enumerate(flights):
            each.steps += 1
            actions[world, :3] *= each.speed / self.recipe.expert.speed_m_s
            # A wrong command that wanders: half a second of memory, `wander` as its spread.
            each.wrong = 0.82 * each.wrong + 0.57 * each.wander * kicks[world]
            actions[world] += each.wrong
        if self._learner is not None and len(led):
            texts = [flights[world].task.instruction for world in led]
            actions[led] = self._learner.act(frames, self._poses(led).state(), texts)
        flight.command(clip_action(actions))

    def _sample(self, worlds: NDArray[np.intp], frames: Image) -> Batch:
        poses = self._poses(worlds)
        flights = [self._flights[world] for world in worlds]
        known = truths(poses, [each.stage for each in flights], self.recipe.chunk, self.recipe.expert)
        tokens = np.zeros((len(worlds), self.recipe.sentences, self.text_length), dtype=np.int64)
        asked = np.zeros((len(worlds), self.recipe.sentences), dtype=np.int64)
        for row, each in enumerate(flights):
            for column, (text, gate) in enumerate(self._questions(row, each, known)):
                tokens[row, column] = self.vocabulary.encode(text, self.text_length)
                asked[row, column] = gate
        seen = np.take_along_axis(known.in_view, asked, axis=1)
        return {
            "image": frames,
            "state": poses.state(),
            **known._asdict(),
            "panel_facets": np.stack([each.panels for each in flights]),
            "gate_facets": np.stack([each.gates for each in flights]),
            "board_facets": np.stack([each.board for each in flights]),
            "flown": np.array([each.flown for each in flights]),
            "tokens": tokens,
            "asked": asked,
            "choice": np.where(seen, asked, NONE_IN_VIEW),
        }

    def _questions(self, row: int, each: _World, known: Truths) -> Iterator[tuple[str, int]]:
        """Sentences about a frame, each with the gate that is right; half of them about the gate that is flown at."""
        rng, task = self._rng, each.task
        readable = [g for g in self._askable(task) if known.in_view[row, g] and known.legible[row, g]]
        visible = [g for g in range(3) if known.in_view[row, g] and known.ahead[row, g]]
        for _ in range(self.recipe.sentences):
            if task.family == "race":
                yield task.instruction, task.target
                continue
            plain = self.recipe.directives and rng.random() < 0.25
            among = visible if plain else readable
            target = each.flown if rng.random() < 0.35 or not among else int(rng.choice(among))
            if not plain and target == task.target and rng.random() < 0.5:
                text, family = task.instruction, task.family
            else:
                family_wanted = "directive" if plain else None
                question = ask(rng, each.stage.labels, task.board, task.gates, target, family_wanted)
                text, family = question.text, question.family
            if family == "math_board" and not known.legible[row, 3] and target != each.flown:
                # Nobody can know: ask for something that can be seen.
                text = ask(rng, each.stage.labels, None, task.gates, target, None).text
            yield text, target

    def _askable(self, task: Task) -> tuple[int, ...]:
        """The gates that can be asked for; without directives not those about whose panels there is nothing to say."""
        gates = (0, 1, 2)
        if self.recipe.directives or task.family == "race":
            return gates
        return tuple(gate for gate in gates if families(task.labels, None, task.gates, gate))

    def _texts(self) -> Batch:
        """Sentences with what the panels and gates show, told instead of seen."""
        rng, count = self._rng, self.recipe.texts
        rest = (1 - sum(_TEXT_SHARES.values())) / (len(BASE_FAMILIES) - len(_TEXT_SHARES))
        shares = np.array([_TEXT_SHARES.get(family, rest) for family in BASE_FAMILIES])
        families = rng.choice(len(BASE_FAMILIES), count, p=shares / shares.sum())
        numbers = rng.integers(2**27, size=count) * len(BASE_FAMILIES) + families
        tasks = [train_task(int(number), 0) for number in numbers]
        plain = rng.random(count) < (0.1 if self.recipe.directives else 0.0)
        texts = [task.directive if p else task.instruction for task, p in zip(tasks, plain, strict=True)]
        boards = [board_facets(task.board) if task.board else np.full(3, -1) for task in tasks]
        return {
            "text_tokens": np.stack([self.vocabulary.encode(text, self.text_length) for text in texts]),
            "text_panels": np.stack([[panel_facets(label) for label in task.labels] for task in tasks]),
            "text_gates": np.stack([[gate_facets(gate) for gate in task.gates] for task in tasks]),
            "text_board": np.stack(boards),
            "text_asked": np.array([task.target for task in tasks]),
        }
