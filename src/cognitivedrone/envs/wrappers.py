"""What learners see in place of a pilot's observation, and what rewards them.

For libraries without `Text`: instructions as vectors, and smaller images. For learning to fly: a privileged state in
place of pictures, and a reward that tells of progress. The last two know the right gate, which no pilot does: they are
for studying control, and for teachers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from PIL import Image as PillowImage

from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.envs.worlds import proprioception
from cognitivedrone.errors import SimulationError, did_you_mean
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.models.words.text_encoder import VECTOR_SIZE, hash_instruction
from cognitivedrone.types import IMAGE_SIZE, Action, DroneState, FloatArray, Stage, StageResult
from cognitivedrone.world.geometry import gate_centers, gate_yaws, half_width, to_gate_frame

Seen = dict[str, Any]
"""An observation."""


class HashInstruction(gymnasium.ObservationWrapper[Seen, Action, Seen], RecordConstructorArgs):
    """Replaces the instruction of the observation by a vector: a `Box` (size,) float32 instead of the `Text`.

    See `hash_instruction`. Raises `SimulationError` for a size below 1.
    """

    def __init__(self, env: gymnasium.Env[Seen, Action], size: int = VECTOR_SIZE) -> None:
        RecordConstructorArgs.__init__(self, size=size)
        super().__init__(env)
        if size < 1:
            raise SimulationError(f"size is {size}; an instruction's vector has at least 1 number")
        self.size = size
        self.observation_space = _replaced(env, "instruction", spaces.Box(-1, 1, (size,), np.float32))

    def observation(self, observation: Seen) -> Seen:
        """The observation with the vector of its instruction."""
        return {**observation, "instruction": hash_instruction(observation["instruction"], self.size)}


class ShrinkImage(gymnasium.ObservationWrapper[Seen, Action, Seen], RecordConstructorArgs):
    """Shrinks the image by `factor` on each side, averaging over squares: 128 x 128 for 2.

    Raises `SimulationError` unless 256 is a multiple of the factor.
    """

    def __init__(self, env: gymnasium.Env[Seen, Action], factor: int = 2) -> None:
        RecordConstructorArgs.__init__(self, factor=factor)
        super().__init__(env)
        if factor < 1 or IMAGE_SIZE % factor:
            raise SimulationError(f"factor is {factor}; the image's {IMAGE_SIZE} pixels must be a multiple of it")
        self.factor = factor
        side = IMAGE_SIZE // factor
        self.observation_space = _replaced(env, "image", spaces.Box(0, 255, (side, side, 3), np.uint8))

    def observation(self, observation: Seen) -> Seen:
        """The observation with a smaller image."""
        image = PillowImage.fromarray(observation["image"]).reduce(self.factor)
        return {**observation, "image": np.array(image)}


def _replaced(env: gymnasium.Env[Seen, Action], key: str, space: spaces.Box) -> spaces.Dict:
    """The environment's observation space with another space under `key`."""
    if not isinstance(env.observation_space, spaces.Dict) or key not in env.observation_space.spaces:
        raise SimulationError(f"the observation space is {env.observation_space}; expected a Dict with {key!r}")
    return spaces.Dict({**env.observation_space.spaces, key: space})


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
    each = [(runner.world.state(), runner.stage, runner.task.target, runner.world.time()) for runner in runners]
    return np.stack([state_of(*of) for of in each])


def state_of(state: DroneState, stage: Stage, target: int | None, time_s: float) -> FloatArray:
    """`STATE` (11,) float32 of a drone before a stage whose right gate is `target`, as that stands at `time_s`."""
    velocity, height, yaw_rate = proprioception(state)
    gate = np.zeros(6)
    if target is not None:
        yaw = yaw_of(state.quaternion)
        normal = gate_yaws(stage)[target] - yaw
        center = gate_centers(stage, time_s)[target]
        gate[:3] = world_to_heading(center - state.position, yaw)
        gate[3:] = np.cos(normal), np.sin(normal), half_width(stage, target)
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
