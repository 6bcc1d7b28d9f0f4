"""The oracle: told where the right gate is, it flies through it. Teacher of the data and upper bound of scores."""

from __future__ import annotations

import numpy as np

from cognitivedrone.errors import PolicyError
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.policies.guidance import Pursuit, pursue
from cognitivedrone.types import Action, ActionChunk, Observation, Truth
from cognitivedrone.world.geometry import gate_centers, gate_yaws


class Expert:
    """Closed-loop pursuit of the right gate's axis from the true state."""

    def __init__(self, config: Pursuit | None = None) -> None:
        self.config = config or Pursuit()
        self._truth: Truth | None = None

    def reset(self, instruction: str) -> None:
        """Forget the last stage."""
        self._truth = None

    def brief(self, truth: Truth) -> None:
        """Take the truth of the stage at hand."""
        self._truth = truth

    def act(self, observation: Observation) -> ActionChunk:
        """One command; the truth is better than any picture."""
        return self.command()[None]

    def command(self) -> Action:
        """The command for where the drone is now, (4,), heading frame, m/s and rad/s."""
        if self._truth is None:
            raise PolicyError("the oracle policy needs the simulator's truth, which this flight does not have")
        stage, target = self._truth.stage, self._truth.task.target
        state = self._truth.state()
        yaw = float(yaw_of(state.quaternion))
        gate_yaw = float(gate_yaws(stage)[target])
        gate = world_to_heading(gate_centers(stage)[target] - state.position, yaw)
        normal = world_to_heading(np.array([np.cos(gate_yaw), np.sin(gate_yaw), 0.0]), yaw)
        command = pursue(gate, normal, world_to_heading(state.velocity, yaw), self.config)
        return command.astype(np.float32)
