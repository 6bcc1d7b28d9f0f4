"""Rollout stream: training data made on the fly, by drones in many scenes at once.

Each world of a `RolloutStream` flies toward one gate, by the expert with random wrong commands added, or by the
network itself in an earlier state (continuous DAgger). Some steps of every flight become samples: a rendered
frame, its ground truth, and several sentences that ask for one gate or another. The gate flown at is independent of the
gate asked for, unless the panels cannot be read: then a drone can only continue toward its gate.

A stream is a pure function of recipe, seed and the weights of the policy under training: the same batches on every
machine of a kind.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Split
from cognitivedrone.data.store import Store
from cognitivedrone.envs.track_runner import TrackConfig, draw_start, stage_of
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import TrainingError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.labels import load_pack
from cognitivedrone.layout import draw_layout
from cognitivedrone.policies.expert import intent
from cognitivedrone.sim.airframe import RACER
from cognitivedrone.sim.simulator import Start
from cognitivedrone.tasks import train_task
from cognitivedrone.tasks.families.racing import crowded_task, race_task
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.training.perception.ground_truth import Poses
from cognitivedrone.training.small_vla.sampling import Sampler, Setting, StreamRecipe
from cognitivedrone.training.trainer.training_task import Batch, Batches, Filling, Learner
from cognitivedrone.types import Commands, FloatArray, Image, Stage, Task
from cognitivedrone.world import geometry
from cognitivedrone.world.appearance import PLAIN, photo_appearance, varied_appearance
from cognitivedrone.world.places import names

_HOPELESS = TrackConfig(time_limit_s=14.1)  # a flight of so long leads nowhere
_BOUND_M = 9.0  # beyond this distance from the stage's origin there is nothing to learn


class StreamFlight(Setting):
    """One flight in progress."""

    def __init__(self, task: Task, stage: Stage, flown: int, *, learner: bool, wander: float, speed: float) -> None:
        super().__init__(task, stage, flown)
        self.learner = learner
        self.wander = wander
        self.speed = speed
        self.wrong = np.zeros(4)


class RolloutStream:
    """Worlds with training flights."""

    def __init__(self, recipe: StreamRecipe, sampler: Sampler) -> None:
        self.recipe = recipe
        self._sampler = sampler
        self._worlds = Worlds(recipe.worlds, load_pack(), _HOPELESS)
        self._rng = np.random.default_rng()
        self._learner: Learner | None = None
        self._flights: list[StreamFlight] = []
        self._report: Filling = lambda *_: None

    def watch(self, report: Filling) -> None:
        """Report from now on how the buffer for the next batches fills."""
        self._report = report

    def close(self) -> None:
        """Free the renderer."""
        self._worlds.close()

    def __call__(self, seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
        """Endless batches, from flights that all begin now; the `learner`, if given, flies some."""
        self._rng, self._learner = np.random.default_rng(seed), learner
        self._flights = [self._begin(world) for world in range(self.recipe.worlds)]
        pool: list[Batch] = []
        size = self.recipe.batch * self.recipe.pool
        while True:
            while (made := sum(len(part["flown"]) for part in pool)) < size:
                self._report(made, size)
                pool.extend(self._step())
            self._report(size, size)
            together = {name: np.concatenate([part[name] for part in pool]) for name in pool[0]}
            order = self._rng.permutation(len(together["flown"]))
            for first in range(0, size, self.recipe.batch):
                chosen = order[first : first + self.recipe.batch]
                yield {name: values[chosen] for name, values in together.items()}
            pool = [{name: values[order[size:]] for name, values in together.items()}]

    def _task(self) -> Task:
        """The task of a new flight."""
        rng, recipe = self._rng, self.recipe
        make = train_task
        if recipe.suite == "race":
            make = crowded_task if rng.random() < recipe.crowded else race_task
        task = make(int(rng.integers(2**31)), 0)
        # A share of zero draws nothing: the recipes without layouts or places stay as they are, to the bit.
        if recipe.layouts and rng.random() < recipe.layouts:
            task = replace(task, layout=draw_layout(rng, task.gates, board=task.board is not None))
        return task

    def _begin(self, world: int) -> StreamFlight:
        rng, recipe, task = self._rng, self.recipe, self._task()
        if recipe.places and rng.random() < recipe.places:
            appearance = photo_appearance(rng, names("training"))
        else:
            appearance = varied_appearance(rng) if rng.random() < recipe.varied else PLAIN
        start, velocity = self._draw_start()
        runner, flight = self._worlds.runners[world], self._worlds.simulator.flight
        runner.begin((task,), rng, start, appearance)
        position, wind = np.array(start.position), np.array(start.wind)
        flight.reset(world, position, start.yaw, rotate_yaw(velocity, start.yaw), wind=wind)
        stage = runner.stage
        others = [gate for gate in range(3) if gate != task.target and stage.only is None]
        learner = self._learner is not None and world < recipe.learner * recipe.worlds
        flown = right_gate(task) if learner or not others or rng.random() < 0.5 else int(rng.choice(others))
        wander = float(rng.uniform(0.3, 1.2)) if rng.random() < recipe.wander else 0.0
        speed = float(rng.uniform(1.3, 1.8))
        return StreamFlight(task, stage, flown, learner=learner, wander=wander, speed=speed)

    def _draw_start(self) -> tuple[Start, FloatArray]:
        """Initial conditions of a flight, and its velocity, heading frame, m/s."""
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
        flight = self._worlds.simulator.flight
        return Poses(
            flight.position[worlds], flight.quaternion[worlds], flight.velocity[worlds], flight.body_rates[worlds, 2]
        )

    def _step(self) -> list[Batch]:
        """One control step of all worlds; returns the samples taken before it."""
        taken = np.flatnonzero(self._rng.random(self.recipe.worlds) < self.recipe.sampled)
        led = np.array([w for w, flight in enumerate(self._flights) if flight.learner], dtype=np.intp)
        shown = np.union1d(taken, led)
        frames = self._worlds.simulator.frames(worlds=shown.tolist())
        samples = []
        if len(taken):
            flights = [self._flights[world] for world in taken]
            seen = frames[np.isin(shown, taken)]
            samples.append(self._sampler.sample(self._rng, self._poses(taken), flights, seen))
        self._command(led, frames[np.isin(shown, led)])
        results = self._worlds.advance()
        far = np.abs(self._worlds.simulator.flight.position[:, :2]).max(axis=1) > _BOUND_M
        for world, result in enumerate(results):
            if result is not None or far[world]:
                self._flights[world] = self._begin(world)
        return samples

    def _command(self, led: NDArray[np.intp], frames: Image) -> None:
        """Command every drone."""
        flights, actions = self._flights, self._expert_actions()
        kicks = self._rng.standard_normal((len(flights), 4)) * (1.0, 1.0, 0.6, 0.8)
        for world, each in enumerate(flights):
            actions[world, :3] *= each.speed / self.recipe.expert.speed_m_s
            # Random wrong command, correlated over half a second, with the standard deviation `wander`.
            each.wrong = 0.82 * each.wrong + 0.57 * each.wander * kicks[world]
            actions[world] += each.wrong
        if self._learner is not None and len(led):
            texts = [flights[world].task.instruction for world in led]
            actions[led] = self._learner.act(frames, self._poses(led).state(), texts)
        self._worlds.command(actions)

    def _expert_actions(self) -> Commands:
        """(n, 4) the expert's commands toward the gates flown at."""
        flight, flights = self._worlds.simulator.flight, self._flights
        centers = np.stack([geometry.gate_centers(each.stage)[each.flown] for each in flights])
        yaws = np.array([geometry.gate_yaws(each.stage)[each.flown] for each in flights])
        return intent(flight.position, flight.velocity, flight.yaw, centers, yaws, self.recipe.expert)


class Recorded:
    """The steps of a split of a data set, as batches in random order."""

    def __init__(self, folder: Path, recipe: StreamRecipe, encoder: Path | None, split: Split = "train") -> None:
        self._recipe, self._split = recipe, split
        self._sampler = Sampler(recipe, encoder)
        self._store = Store(folder)
        self._steps = self._store.step_numbers(split)
        if not len(self._steps):
            raise TrainingError(f"{folder}: has no step in its {split} split; collect more flights")
        self._episode = self._store.episode_rows()
        self._tasks = self._store.tasks()
        self._settings: dict[int, Setting] = {}
        columns = self._store.columns("position", "quaternion", "velocity", "yaw_rate", "action")
        velocity = rotate_yaw(columns["velocity"].astype(np.float64), yaw_of(columns["quaternion"]))
        self._poses = Poses(columns["position"], columns["quaternion"], velocity, columns["yaw_rate"])
        self._action = columns["action"]

    def batches(self, seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
        """Endless batches: all steps in a new random order, again and again; no `learner` can fly here."""
        del learner
        rng = np.random.default_rng(seed)
        left = np.empty(0, np.int64)
        while True:
            while len(left) < self._recipe.batch:
                left = np.concatenate([left, rng.permutation(self._steps)])
            taken, left = left[: self._recipe.batch], left[self._recipe.batch :]
            yield self._sample(rng, taken)

    def _sample(self, rng: np.random.Generator, steps: NDArray[np.int64]) -> Batch:
        settings = [self._setting(row) for row in self._episode[steps].tolist()]
        poses = Poses(*(values[steps] for values in self._poses))
        batch = self._sampler.sample(rng, poses, settings, self._store.steps(steps)["image"])
        ends = np.searchsorted(self._episode, self._episode[steps], side="right") - 1  # the last steps of the flights
        ahead = np.minimum(steps[:, None] + np.arange(self._recipe.chunk), ends[:, None])
        batch["action"][np.arange(len(steps)), batch["flown"]] = self._action[ahead]
        return batch

    def _setting(self, row: int) -> Setting:
        if row not in self._settings:
            task = self._tasks[row]
            self._settings[row] = Setting(task, stage_of(task), right_gate(task))
        return self._settings[row]


def training_batches(
    stream: StreamRecipe, encoder: Path | None, data: Path | None, *, validation: bool = False
) -> Batches:
    """Batches from a split of a data set or, without one, from flights made during training, split by seed."""
    if data is None:
        return RolloutStream(stream, Sampler(stream, encoder))
    return Recorded(data, stream, encoder, "val" if validation else "train").batches
