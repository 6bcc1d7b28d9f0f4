"""Runs the policy for all sessions: one thread, whatever waits in one batch, a bounded queue."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from cognitivedrone.errors import MessageError
from cognitivedrone.interfaces import Policy, attempt
from cognitivedrone.serving.config import Limits
from cognitivedrone.serving.sessions import Served, Session
from cognitivedrone.types import ActionChunk, EpisodeContext, Observation

_Result = TypeVar("_Result")


@dataclass(frozen=True, slots=True)
class Done:
    """A session's actions, and how long they took."""

    actions: ActionChunk
    declines: bool
    present: float | None
    infer_s: float
    """Of the whole batch."""
    wait_s: float
    """In the queue."""


@dataclass(slots=True)
class _Turn:
    session: Session
    contexts: Sequence[EpisodeContext]
    """Stages to start first."""
    observation: Observation
    done: asyncio.Future[Done]
    since: float


class Engine:
    """Calls of policy and reasoner, which may block, in a thread each; made in a running event loop."""

    def __init__(self, served: Served, limits: Limits) -> None:
        self.served = served
        self._limits = limits
        self._policy_thread = ThreadPoolExecutor(1, "policy")
        self._reasoner_thread = ThreadPoolExecutor(1, "reasoner")
        self._opening_thread = ThreadPoolExecutor(1, "sessions")
        self._waiting: list[_Turn] = []
        self._running: asyncio.Task[None] | None = None

    async def act(self, session: Session, contexts: Sequence[EpisodeContext], observation: Observation) -> Done:
        """The session's actions, together with those of others that wait; raises `MessageError` if too many wait."""
        if len(self._waiting) >= self._limits.queue:
            raise MessageError("busy", f"{len(self._waiting)} observations wait already; try again later")
        done: asyncio.Future[Done] = asyncio.get_running_loop().create_future()
        self._waiting.append(_Turn(session, contexts, observation, done, time.perf_counter()))
        if self._running is None or self._running.done():
            self._running = asyncio.create_task(self._run())
        return await done

    async def open_session(self) -> Session:
        """A new session; others fly on while it is made."""
        return await asyncio.get_running_loop().run_in_executor(self._opening_thread, self.served.open_session)

    async def close_session(self, session: Session) -> None:
        """Close a session, after its last turn."""
        with suppress(RuntimeError):  # the server has ended
            await self.on_policy_thread(session.close)

    async def reason(self, call: Callable[[], _Result]) -> _Result:
        """What a call of the reasoner returns."""
        return await asyncio.get_running_loop().run_in_executor(self._reasoner_thread, call)

    async def on_policy_thread(self, call: Callable[[], _Result]) -> _Result:
        """What another call returns that touches the policy."""
        return await asyncio.get_running_loop().run_in_executor(self._policy_thread, call)

    def close(self) -> None:
        """End the threads, without waiting for a call that hangs."""
        for thread in (self._policy_thread, self._reasoner_thread, self._opening_thread):
            thread.shutdown(wait=False, cancel_futures=True)

    async def _run(self) -> None:
        while self._waiting:
            turns, self._waiting = self._waiting[: self._limits.batch], self._waiting[self._limits.batch :]
            began = time.perf_counter()
            try:
                results = await self.on_policy_thread(lambda turns=turns: self._act(turns))  # type: ignore[misc]
            except Exception as error:  # of this package
                results = [error] * len(turns)
            took_s = time.perf_counter() - began
            for turn, result in zip(turns, results, strict=True):
                if turn.done.done():  # the client has left
                    continue
                if isinstance(result, Exception):
                    turn.done.set_exception(result)
                else:
                    turn.done.set_result(Done(*result, took_s, began - turn.since))

    def _act(self, turns: Sequence[_Turn]) -> list[tuple[ActionChunk, bool, float | None] | Exception]:
        """Start stages and act; an error stays with its own turn."""
        begun = [attempt(turn.session.reset_policy, turn.contexts) for turn in turns]
        acting = [turn for turn, error in zip(turns, begun, strict=True) if error is None]
        chunks = iter(
            self.served.act([turn.session for turn in acting], [turn.observation for turn in acting]) if acting else []
        )
        results: list[tuple[ActionChunk, bool, float | None] | Exception] = []
        for turn, error in zip(turns, begun, strict=True):
            chunk = next(chunks) if error is None else error
            results.append(
                chunk if isinstance(chunk, Exception) else attempt(_with_reports(chunk), turn.session.policy)
            )
        return results


def _with_reports(chunk: ActionChunk) -> Callable[[Policy], tuple[ActionChunk, bool, float | None]]:
    """Adds to a chunk what the policy reports with it, which may be computed by a user's code."""
    return lambda policy: (chunk, policy.declines, policy.present)
