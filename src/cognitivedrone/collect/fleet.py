"""Batched flying and recording of episodes, many worlds in one simulator."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.adapters import as_policy
from cognitivedrone.choices import AppearanceName
from cognitivedrone.collect.recipe import Disturbance, Recipe, disturb, draw_beginning, draw_disturbances
from cognitivedrone.control.calls import begin_stage, check_chunk, seed_of
from cognitivedrone.data.episode import Conditions, Episode, encode_image
from cognitivedrone.envs.track_runner import TrackConfig, episode_rng
from cognitivedrone.envs.worlds import Worlds, clip_action, proprioception
from cognitivedrone.errors import CognitiveDroneError, DataError, NonFiniteAction, PolicyError
from cognitivedrone.interfaces import Policy, PolicyLike
from cognitivedrone.labels import load_pack
from cognitivedrone.policies.expert import Expert, ExpertConfig
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.system.interrupts import is_ctrl_c
from cognitivedrone.tasks import Suite
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, Action, EpisodeContext, FloatArray, Image, Observation, Outcome
from cognitivedrone.world.appearance import photo_appearance
from cognitivedrone.world.places import names

AIRFRAME = "racer"
WORLDS = 16
"""Number of worlds that one process flies together."""
MAX_ATTEMPTS = 20
"""After this many failures of the expert, a task counts as infeasible."""

Learner = Callable[[], PolicyLike]


@dataclass(frozen=True, slots=True)
class FlownEpisode:
    """One episode to store."""

    episode: Episode
    outcome: Outcome
    """Outcome; "passed" if the expert flew."""
    dropped: Mapping[str, int]
    """Dropped flights of its task, by outcome; each was followed by another attempt."""


@dataclass(slots=True)
class _Flight:
    """One flight in progress, and its record so far."""

    index: int
    attempt: int
    expert: Expert
    disturbances: tuple[Disturbance, ...]
    learner: Policy | None
    expert_flies: NDArray[np.bool_]
    """By control step, for a policy under training: whether the expert's command is sent instead of the policy's."""
    dropped: Counter[str]
    pending: list[Action] = field(default_factory=list)
    images: list[bytes] = field(default_factory=list)
    down: list[bytes] = field(default_factory=list)
    action: list[Action] = field(default_factory=list)
    sent: list[Action] = field(default_factory=list)
    proprioception: list[tuple[FloatArray, float, float]] = field(default_factory=list)
    position: list[FloatArray] = field(default_factory=list)
    quaternion: list[FloatArray] = field(default_factory=list)


def attempt_rng(suite_digest: str, index: int, seed: int, attempt: int) -> np.random.Generator:
    """The generator of one attempt at an episode; the first is the episode's own, the others are its children."""
    rng = episode_rng(suite_digest, index, seed)
    return rng if attempt == 0 else rng.spawn(attempt)[-1]


class Fleet:
    """Flies tasks of a suite with the expert, or with a policy under training whose flights the expert relabels.

    An episode depends only on suite, index, seed and recipe, to the last bit: not on the other worlds. A failed flight
    of the expert is dropped and its task flown again under new conditions until it passes, so a set has exactly the
    requested episodes. Flights of a policy under training are stored however they end, except those ended by diverged
    physics or by the policy's own numbers.
    """

    def __init__(
        self,
        suite: Suite,
        recipe: Recipe,
        seed: int,
        *,
        labels: Path | None = None,
        worlds: int = WORLDS,
        learner: Learner | None = None,
        beta: float = 0.0,
    ) -> None:
        """`beta`: for a policy under training, the probability of the expert's command at each control step."""
        self.suite = suite
        self.recipe = recipe
        self.seed = seed
        self.beta = beta
        made = [learner() for _ in range(worlds)] if learner else []
        self._name = type(made[0]).__name__ if made else ""
        self._learners = [as_policy(f"policy {self._name}", each) for each in made]
        config = TrackConfig(appearance=recipe.look, time_limit_s=recipe.time_limit_s)
        self._worlds = Worlds(worlds, load_pack(labels), config, airframe=AIRFRAMES[AIRFRAME])
        self._frames = np.empty((worlds, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
        self._looks_down = recipe.down_camera or any(each.needs_down_camera for each in self._learners)

    @property
    def renderer(self) -> str:
        """Name of the renderer."""
        return renderer_name()

    def close(self) -> None:
        """Free the renderer, and what the learners hold open."""
        self._worlds.close()
        for learner in self._learners:
            learner.close()

    def fly(self, indices: Iterable[int]) -> Iterator[FlownEpisode]:
        """Fly these tasks; yields each episode as it ends. Raises `DataError` for one that cannot be flown."""
        waiting = deque((index, 0, Counter[str]()) for index in indices)
        flights: dict[int, _Flight] = {}
        while waiting or flights:
            for world in range(len(self._worlds.runners)):
                if world not in flights and waiting:
                    flights[world] = self._begin(world, *waiting.popleft())
            for world, flight, outcome in self._step(flights):
                del flights[world]
                if outcome == "passed" or (flight.learner is not None and outcome not in ("invalid", "policy_error")):
                    yield FlownEpisode(self._episode(world, flight), outcome, dict(flight.dropped))
                else:
                    flight.dropped[outcome] += 1
                    waiting.appendleft((flight.index, flight.attempt + 1, flight.dropped))

    def _begin(self, world: int, index: int, attempt: int, dropped: Counter[str]) -> _Flight:
        if attempt == MAX_ATTEMPTS:
            task = self.suite.tracks[index][0]
            if self._learners:
                raise DataError(
                    f"task {task.id}: in {attempt} flights the policy gave no finite command; fix the policy"
                )
            raise DataError(
                f"task {task.id}: no flight out of {attempt} was passed; use a recipe with weaker disturbances"
            )
        rng = attempt_rng(self.suite.digest, index, self.seed, attempt)
        track_runner = self._worlds.runners[world]
        start = draw_beginning(rng, self.recipe, track_runner.world.hull_radius)
        speed = float(rng.uniform(*self.recipe.speed_m_s))
        disturbances = draw_disturbances(rng, self.recipe)
        learner = self._learners[world] if self._learners else None
        # A recipe without places draws nothing for them: its flights stay as they are, to the bit.
        there = self.recipe.places > 0.0 and rng.random() < self.recipe.places
        appearance = photo_appearance(rng, names("training")) if there else None
        track_runner.begin(self.suite.tracks[index], rng, start, appearance)
        expert = Expert(ExpertConfig(speed_m_s=speed))
        context = EpisodeContext(track_runner.task.instruction, ground_truth=track_runner.truth())
        expert.reset(context)
        expert_flies = np.zeros(int(self.recipe.time_limit_s * CONTROL_HZ) + 2, np.bool_)
        if learner is not None:
            with _naming_place(self._name, index, 0):
                begin_stage(learner, replace(context, seed=seed_of(learner, rng)))
            if self.beta:
                expert_flies = rng.random(len(expert_flies)) < self.beta
        return _Flight(index, attempt, expert, disturbances, learner, expert_flies, dropped)

    def _step(self, flights: Mapping[int, _Flight]) -> Iterator[tuple[int, _Flight, Outcome]]:
        """One control step of all worlds; yields those that ended, with their outcome."""
        worlds = list(flights)
        frames = self._worlds.simulator.frames(self._frames[: len(worlds)], worlds)
        downs = self._worlds.simulator.frames(worlds=worlds, down=True) if self._looks_down else [None] * len(worlds)
        for world, frame, down in zip(worlds, frames, downs, strict=True):
            try:
                self._decide(world, flights[world], frame, down)
            except NonFiniteAction:
                self._worlds.runners[world].end("policy_error")
        self._worlds.advance()
        for world in worlds:
            if results := self._worlds.runners[world].results:
                yield world, flights[world], results[0].outcome

    def _decide(self, world: int, flight: _Flight, frame: Image, down: Image | None) -> None:
        """Record the current step, and command."""
        simulator = self._worlds.simulator
        state = simulator.state(world)
        velocity, height, yaw_rate = proprioception(state)
        action = sent = clip_action(flight.expert.command())
        if flight.learner is not None:
            if not flight.pending:
                instruction = self._worlds.runners[world].task.instruction
                below = down if flight.learner.needs_down_camera else None
                seen = Observation(frame, instruction, velocity, height, yaw_rate, simulator.time(world), below)
                with _naming_place(self._name, flight.index, len(flight.sent)):
                    flight.pending = list(check_chunk(flight.learner.act(seen)))
            learned = clip_action(flight.pending.pop(0))
            # The policy acts at every step, so that its own clock and memory continue.
            sent = action if flight.expert_flies[len(flight.sent)] else learned
        sent = clip_action(disturb(sent, len(flight.sent), flight.disturbances))
        simulator.command(world, sent)
        flight.images.append(encode_image(frame, self.recipe.encoding, self.recipe.quality))
        if down is not None and self.recipe.down_camera:
            flight.down.append(encode_image(down, self.recipe.encoding, self.recipe.quality))
        flight.action.append(action)
        flight.sent.append(sent)
        flight.proprioception.append((velocity, height, yaw_rate))
        flight.position.append(state.position)
        flight.quaternion.append(state.quaternion)

    def _episode(self, world: int, flight: _Flight) -> Episode:
        start, place = self._worlds.runners[world].start, self._worlds.runners[world].appearance.place
        look: AppearanceName = "photo" if place else self.recipe.look
        velocity, height, yaw_rate = zip(*flight.proprioception, strict=True)
        return Episode(
            index=flight.index,
            suite=self.suite.name,
            task=self.suite.tracks[flight.index][0],
            conditions=Conditions(self.seed, AIRFRAME, look, start.position, start.yaw, start.wind, place),
            encoding=self.recipe.encoding,
            images=tuple(flight.images),
            down=tuple(flight.down),
            action=np.array(flight.action, dtype=np.float32),
            sent=np.array(flight.sent, dtype=np.float32),
            velocity=np.array(velocity, dtype=np.float32),
            height=np.array(height, dtype=np.float32),
            yaw_rate=np.array(yaw_rate, dtype=np.float32),
            position=np.array(flight.position),
            quaternion=np.array(flight.quaternion),
            final_position=np.array(self._worlds.simulator.state(world).position, dtype=np.float64),
        )


@contextmanager
def _naming_place(name: str, index: int, step: int) -> Iterator[None]:
    """Turn any exception of a policy into a `PolicyError` that names the place."""
    try:
        yield
    except CognitiveDroneError:
        raise
    except BaseException as error:  # also `SystemExit`, and a `KeyboardInterrupt` of its own
        if is_ctrl_c(error):
            raise
        reason = f"{type(error).__name__}: {error}"
        raise PolicyError(
            f"policy {name} failed in episode {index} at step {step} ({reason}); fix the policy"
        ) from error


def relabel(
    learner: Learner,
    suite: Suite,
    recipe: Recipe,
    seed: int,
    indices: Iterable[int],
    *,
    worlds: int = WORLDS,
    beta: float = 0.0,
) -> Iterator[Episode]:
    """Fly a policy under training and record the expert's commands as labels (DAgger; Ross et al., AISTATS 2011).

    `learner` creates one policy per world; `beta` is the paper's mixing parameter, the expert's share of the control
    steps. In the episodes, `sent` is what was flown and `action` is the expert's; flights are stored however they end.
    They come in the order of `indices`, several at a time.
    """
    fleet = Fleet(suite, recipe, seed, worlds=worlds, learner=learner, beta=beta)
    try:
        waiting = list(indices)
        for begin in range(0, len(waiting), 4 * worlds):
            flown = fleet.fly(waiting[begin : begin + 4 * worlds])
            yield from sorted((each.episode for each in flown), key=lambda episode: episode.index)
    finally:
        fleet.close()
