"""The one control loop: policy at 10 Hz, reasoner at 2 Hz, on absolute deadlines of whatever clock is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cognitivedrone.errors import NonFiniteAction, PolicyError
from cognitivedrone.interfaces import Clock, Drone, Policy, Privileged, Reasoner, Recorder
from cognitivedrone.types import CONTROL_HZ, Action, ActionChunk, Guidance, Truth


@dataclass(frozen=True, slots=True)
class Leg:
    """What is to be done now."""

    index: int
    """Counts the instructions given: a new index is a new leg even where the words are the same."""
    instruction: str
    truth: Truth | None = None
    """For privileged pilots, in the simulator."""


Mission = Callable[[], Leg | None]
"""The leg at hand, asked before every control step; none ends the flight."""


@dataclass(frozen=True, slots=True)
class Rates:
    """How often the parts of a pilot run, Hz; the reasoner's rate divides the policy's."""

    control_hz: int = CONTROL_HZ
    reasoner_hz: int = 2

    def __post_init__(self) -> None:
        if self.control_hz % self.reasoner_hz:
            raise ValueError(f"{self.control_hz} Hz control is no whole multiple of {self.reasoner_hz} Hz reasoning")

    @property
    def reason_every(self) -> int:
        """Control steps between two answers of the reasoner."""
        return self.control_hz // self.reasoner_hz


def check_chunk(chunk: ActionChunk) -> ActionChunk:
    """The chunk as (k, 4) float32.

    Raises `PolicyError` where it has another shape, `NonFiniteAction` where a number is NaN or infinite.
    """
    array = np.asarray(chunk, dtype=np.float32)
    if array.ndim != 2 or array.shape[0] < 1 or array.shape[1] != 4:
        raise PolicyError(
            f"the policy returned an action of shape {array.shape};"
            " expected (k, 4): vx, vy, vz in m/s and yaw rate in rad/s"
        )
    if not np.isfinite(array).all():
        raise NonFiniteAction(f"the policy returned {array[0].tolist()}: not all of it is a finite number")
    return array


def fly(
    drone: Drone,
    policy: Policy,
    clock: Clock,
    mission: Mission,
    *,
    reasoner: Reasoner | None = None,
    recorder: Recorder | None = None,
    rates: Rates | None = None,
) -> int:
    """Fly until the mission ends; returns the number of control steps.

    A chunk of actions is flown to its end before the policy is asked again. A new leg resets the policy, drops what is
    left of the chunk, and asks the reasoner at once.
    """
    rates = rates or Rates()
    start = clock.now()
    leg_index: int | None = None
    guidance: Guidance | None = None
    pending: list[Action] = []
    since_reasoning = 0
    step = 0
    while (leg := mission()) is not None:
        if leg.index != leg_index:
            leg_index, guidance, pending, since_reasoning = leg.index, None, [], 0
            policy.reset(leg.instruction)
            for part in (policy, reasoner):
                if leg.truth is not None and isinstance(part, Privileged):
                    part.brief(leg.truth)
        observation = drone.observe()
        if reasoner is not None and since_reasoning % rates.reason_every == 0:
            guidance = reasoner.refine(observation.image, leg.instruction)
        since_reasoning += 1
        text = guidance.directive if guidance is not None else leg.instruction
        observation = replace(observation, instruction=text)
        if not pending:
            pending = list(check_chunk(policy.act(observation)))
        sent = drone.send(pending.pop(0))
        if recorder is not None:
            recorder.record(observation, sent, guidance)
        step += 1
        clock.sleep_until(start + step / rates.control_hz)
    return step
