"""Views of known answers: what the drone sees on the expert's flights, and the commands that lead to each gate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.envs.worlds import SimulatedDrone, Worlds, clip_action
from cognitivedrone.frames import yaw_of
from cognitivedrone.labels import load_pack
from cognitivedrone.policies.expert import Expert, ExpertConfig, intent
from cognitivedrone.tasks import TRAIN_NAME, open_suite
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.types import Commands, DroneState, EpisodeContext, GroundTruth, Observation, Stage, Task
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
            yield LabelledView(task, runner.stage, _copy(runner.world.state()), seen, _commands(runner), step > 0)
        runner.world.command(clip_action(expert.command() + rng.normal(size=4) * _SWAY))
        runner.world.advance()


def _commands(runner: TrackRunner) -> Commands:
    state, stage = runner.world.state(), runner.stage
    centers, yaws = gate_centers(stage, runner.world.time()), gate_yaws(stage)
    position, velocity = np.tile(state.position, (3, 1)), np.tile(state.velocity, (3, 1))
    yaw = np.full(3, float(yaw_of(state.quaternion)))
    return clip_action(intent(position, velocity, yaw, centers, yaws, ExpertConfig()))


def _copy(state: DroneState) -> DroneState:
    return DroneState(*(np.array(getattr(state, name)) for name in DroneState.__dataclass_fields__))
