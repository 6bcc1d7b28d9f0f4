"""For learning to fly: a privileged state in place of pictures, and a reward that tells of progress.

Both know the right gate, which no pilot does: they are for studying control, and for teachers. What is scored sees
pictures and sentences.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias, get_args

import numpy as np
from gymnasium import spaces

from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.envs.worlds import proprioception
from cognitivedrone.errors import SimulationError, did_you_mean
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.types import FloatArray, StageResult
from cognitivedrone.world.geometry import gate_centers, gate_yaws, half_width, to_gate_frame

Observe: TypeAlias = Literal["camera", "state"]
Reward: TypeAlias = Literal["passed", "progress"]

STATE = (
    *("gate_x_m", "gate_y_m", "gate_z_m", "normal_x", "normal_y", "gate_half_width_m"),
    *("velocity_x_m_s", "velocity_y_m_s", "velocity_z_m_s", "height_m", "yaw_rate_rad_s"),
)
"""The numbers of a state: the right gate's centre from the drone and its outward normal, heading frame, half its width,
and the drone's own motion as in `observation_space`. Where no gate is right, those of the gate are 0."""
STEP, PASSED, FAILED = -0.02, 5.0, -5.0
"""Of the reward `progress`: for each control step, for the right gate, and for any other end of a stage."""


def learns_by(observe: Observe, reward: Reward) -> tuple[bool, bool]:
    """Whether states are observed, and progress is rewarded; raises `SimulationError` for a kind that there is not."""
    for name, given, known in (("observe", observe, get_args(Observe)), ("reward", reward, get_args(Reward))):
        if given not in known:
            raise SimulationError(f"{name} is {given!r}; {did_you_mean(str(given), known)}")
    return observe == "state", reward == "progress"


def state_space() -> spaces.Box:
    """The space of a state, (11,) float32, `STATE`."""
    return spaces.Box(-np.inf, np.inf, (len(STATE),), np.float32)


def states_of(runners: Sequence[TrackRunner]) -> FloatArray:
    """The states (worlds, 11) float32 of the drones of several worlds."""
    return np.stack([_state_of(runner) for runner in runners])


def _state_of(runner: TrackRunner) -> FloatArray:
    state, target = runner.world.state(), runner.task.target
    velocity, height, yaw_rate = proprioception(state)
    gate = np.zeros(6)
    if target is not None:
        yaw = yaw_of(state.quaternion)
        normal = gate_yaws(runner.stage)[target] - yaw
        center = gate_centers(runner.stage, runner.world.time())[target]
        gate[:3] = world_to_heading(center - state.position, yaw)
        gate[3:] = np.cos(normal), np.sin(normal), half_width(runner.stage, target)
    return np.array([*gate, *velocity, height, yaw_rate], np.float32)


class Progress:
    """The reward `progress` of one world: by how much the drone came nearer to the right gate's centre and its axis, m.

    In addition `STEP` for each control step, `PASSED` for the right gate, `FAILED` for any other end.
    """

    def __init__(self, runner: TrackRunner) -> None:
        self._runner = runner
        self._left = 0.0

    def begin(self) -> None:
        """A stage begins."""
        self._left = self._distance()

    def score(self, result: StageResult | None) -> float:
        """The reward of a control step, with the result of the stage that ended in it."""
        if result is not None:
            self.begin()
            return PASSED if result.outcome == "passed" else FAILED
        before, self._left = self._left, self._distance()
        return before - self._left + STEP

    def _distance(self) -> float:
        runner, target = self._runner, self._runner.task.target
        if target is None:
            return 0.0
        center, yaw = gate_centers(runner.stage, runner.world.time())[target], gate_yaws(runner.stage)[target]
        along, *aside = to_gate_frame(runner.world.state().position, center, yaw).tolist()
        off = float(np.hypot(*aside))
        return float(np.hypot(along, off)) + off
