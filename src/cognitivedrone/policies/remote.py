"""A policy on a server: this project's (`cognitivedrone serve`), or any that speaks openpi's protocol."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np

from cognitivedrone.errors import ActionError, PluginError
from cognitivedrone.interfaces import Policy
from cognitivedrone.remote.connection import Connection, Gone, Late
from cognitivedrone.remote.messages import PROTOCOL, Message, observation_message, reset_message
from cognitivedrone.types import IMAGE_SIZE, ActionChunk, EpisodeContext, Observation

DEADLINE_S = 0.2
"""Time that an answer may take in a flight in real time, s; as long as vehicles fly on without a command."""
PATIENCE_S = 50.0
"""Time that an answer may take where time stands still meanwhile, s; less than the usual --decision-timeout."""
WARM_UP_S = 600.0
"""Time that the first answer of all may take, s: servers load or compile their models for it."""
LONGEST_S = 3600.0
_FIRST = Observation(
    image=np.full((IMAGE_SIZE, IMAGE_SIZE, 3), 127, np.uint8),
    instruction="Fly through the red gate",
    velocity=np.zeros(3, np.float32),
    height=1.0,
    yaw_rate=0.0,
    time=0.0,
)
"""The observation of the first question."""


class Remote(Policy):
    """Flies the policy served at `url`, ws://HOST:PORT, without the server's reasoner.

    An answer later than `deadline`, in s, is discarded, and the drone holds its position meanwhile, also while the
    server is gone; then it connects again and continues. The default is 0.2 s in real time. In virtual time the
    flight waits for the answer, so that it does not depend on the server's speed, and fails after `patience`, in s.
    Before the first flight the server is asked once, which may take `warm_up`, in s; 0 leaves it out.

    `rows` is the number of actions flown of each chunk; all by default. The token comes from the environment variable
    COGNITIVEDRONE_SERVER_TOKEN. Raises `PluginError` for an invalid argument, `MissingExtra` if a package is missing.
    """

    def __init__(
        self,
        url: str,
        *,
        deadline: float | None = None,
        rows: int | None = None,
        patience: float | None = None,
        warm_up: float = WARM_UP_S,
    ) -> None:
        if deadline is not None and not 0 < deadline <= PATIENCE_S:
            raise PluginError(
                f"policy 'remote': deadline is {deadline}; it must be above 0 and at most {PATIENCE_S:g} s"
            )
        if patience is not None and not 0 < patience <= LONGEST_S:
            raise PluginError(
                f"policy 'remote': patience is {patience}; it must be above 0 and at most {LONGEST_S:g} s"
            )
        if not 0 <= warm_up <= LONGEST_S:
            raise PluginError(f"policy 'remote': warm_up is {warm_up}; it must be from 0 to {LONGEST_S:g} s")
        if rows is not None and rows < 1:
            raise PluginError(f"policy 'remote': rows is {rows}; it must be at least 1")
        self.connection = Connection(url)
        self.trouble = ""
        self.declines, self.present = False, None
        self._deadline_s, self._rows = deadline, rows
        self._patience_s, self._warm_up_s = patience, warm_up
        self._stages: list[EpisodeContext] = []
        """The stages of this flight; a new connection sends all of them."""
        self._sent = 0
        """How many of them the server has."""
        self._connections = 0

    def check(self) -> None:
        """Connect, and have the server answer once.

        Raises `ServerError` if the server is not there, refuses, does not answer, or speaks another version.
        """
        self.connection.open()
        served = self.connection.ours or {}
        self.needs_seed = served.get("needs_seed") is True
        if self._warm_up_s:
            self.reset(EpisodeContext(_FIRST.instruction))
            self.connection.warm_up(self._message(_FIRST), self._warm_up_s)
            self._warm_up_s = 0.0

    def reset(self, context: EpisodeContext) -> None:
        """Start a stage. The server gets it with the next observation."""
        if context.stage == 0:
            self._stages, self._sent = [], 0
        self._stages.append(context)
        self.declines, self.present, self.trouble = False, None, ""

    def act(self, observation: Observation) -> ActionChunk:
        """The server's commands (k, 4), or zeros (1, 4) while it does not answer in time.

        Raises the errors of the served policy, and `ServerError` if the server refuses the observation, or, in virtual
        time, does not answer.
        """
        real_time = bool(self._stages) and self._stages[-1].real_time
        limit_s = self._deadline_s or (DEADLINE_S if real_time else None)
        if limit_s is None:
            return self._awaited(observation)
        try:
            return self._asked(observation, time.monotonic() + limit_s)
        except (Late, Gone) as error:
            self._report(str(error), real_time=real_time)
            self.declines, self.present = False, None
            return np.zeros((1, 4), np.float32)

    def close(self) -> None:
        """Close the connection."""
        self.connection.close()

    def _awaited(self, observation: Observation) -> ActionChunk:
        """The server's commands, however long it takes; raises `Late` or `Gone` after `patience`."""
        until = time.monotonic() + (self._patience_s or PATIENCE_S)
        while True:
            try:
                return self._asked(observation, until)
            except Gone as error:
                self._report(str(error), real_time=False)
                if not self.connection.wait(until - time.monotonic()):
                    raise

    def _asked(self, observation: Observation, until: float) -> ActionChunk:
        self.connection.settle(until)
        reply = self.connection.request(self._message(observation), until)
        if self.trouble:
            self._report("", real_time=self._stages[-1].real_time)
        self.declines = reply.get("declines") is True
        present = reply.get("present")
        self.present = float(present) if isinstance(present, int | float) else None
        return self._commands(reply)

    def _message(self, observation: Observation) -> Message:
        message: dict[str, Any] = observation_message(observation)
        ours = self.connection.ours
        if ours is None:
            return message
        if self._connections != self.connection.count:
            self._connections, self._sent = self.connection.count, 0
        unsent, self._sent = self._stages[self._sent :], len(self._stages)
        message |= {"ask": "policy", "protocol": PROTOCOL, "session": ours.get("session")}
        return message | ({"reset": [reset_message(stage) for stage in unsent]} if unsent else {})

    def _commands(self, reply: Message) -> ActionChunk:
        actions = reply.get("actions")
        if not isinstance(actions, np.ndarray) or actions.dtype.kind not in "fiu":
            raise ActionError(
                f"the policy server at {self.connection.url} answered without an array of actions; expected (k, 4) in"
                " 'actions'"
            )
        return np.asarray(actions[: self._rows], dtype=np.float32) if actions.ndim else np.asarray(actions)

    def _report(self, trouble: str, *, real_time: bool) -> None:
        """Remember why it holds; the control loop of a flight in real time reports it, here a warning does."""
        if bool(trouble) != bool(self.trouble) and not real_time:
            text = f"{trouble}; the flight waits or holds" if trouble else f"{self.connection.url} answers again"
            warnings.warn(text, RuntimeWarning, stacklevel=4)
        self.trouble = trouble
