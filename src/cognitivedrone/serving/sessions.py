"""The pilot that is served, the state that each client has of it, and the thread that runs it for all that wait."""

from __future__ import annotations

import asyncio
import importlib.metadata
import secrets
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from cognitivedrone.control.async_reasoner import Question, SimulatedReasoner, asking, check_guidance
from cognitivedrone.control.calls import calling, check_chunk
from cognitivedrone.control.directive_filter import DirectiveFilter
from cognitivedrone.errors import CognitiveDroneError, GroundTruthError, MessageError, PolicyError, PolicyRaised
from cognitivedrone.files import digest_of_files
from cognitivedrone.interfaces import Policy, Reasoner, attempt
from cognitivedrone.pilot import Pilot
from cognitivedrone.plan import PilotSpec
from cognitivedrone.policies import POLICIES, make_policy, policy_files
from cognitivedrone.reasoners import REASONERS, make_reasoner
from cognitivedrone.registry import one_line
from cognitivedrone.remote.messages import OURS, PROTOCOL, Message, read_prompt, read_resets
from cognitivedrone.serving.config import Limits
from cognitivedrone.tasks.directives import declines
from cognitivedrone.types import CONTROL_HZ, REASONER_HZ, ActionChunk, EpisodeContext, Guidance, Image, Observation


class ServedPilot:
    """A policy and maybe a reasoner, from whose weights every client's session is made."""

    def __init__(self, spec: PilotSpec, pilot: Pilot) -> None:
        """Raises `GroundTruthError` for an oracle, and `PolicyError` for a policy that needs a camera which looks down:
        clients send neither.
        """
        if pilot.policy.needs_down_camera:
            raise PolicyError(f"the policy {spec.policy!r} needs a camera that looks down, which no client sends")
        for kind, part in (("policy", pilot.policy), ("reasoner", pilot.reasoner)):
            if part is not None and part.needs_ground_truth:
                name = spec.policy if kind == "policy" else spec.reasoner
                raise GroundTruthError(f"the {kind} {name!r} uses privileged state, which no client sends")
        self.spec, self.policy, self.reasoner = spec, pilot.policy, pilot.reasoner
        files = policy_files(spec.policy)
        self._model = digest_of_files(*files) if files else None

    def metadata(self, session: str) -> dict[str, Any]:
        """What a client gets when its session begins."""
        reasoner = None if self.reasoner is None else _name(self.spec.reasoner, REASONERS)
        return {
            OURS: {
                "protocol": PROTOCOL,
                "version": _version(),
                "session": session,
                "policy": _name(self.spec.policy, POLICIES),
                "model": self._model,
                "reasoner": reasoner,
                "needs_seed": self.policy.needs_seed,
                "reasoner_needs_seed": self.reasoner is not None and self.reasoner.needs_seed,
                "control_hz": CONTROL_HZ,
            }
        }

    @property
    def unnorm_key(self) -> str | None:
        """Name of the action statistics of a served OpenVLA; none of other policies."""
        checkpoint = getattr(self.policy, "checkpoint", None)
        return None if checkpoint is None else str(checkpoint.statistics_key)

    def open_session(self) -> Session:
        """A session with a state of its own."""
        policy = self.policy.fork() or make_policy(self.spec.policy)
        reasoner = None if self.reasoner is None else self.reasoner.fork() or make_reasoner(self.spec.reasoner)
        return Session(policy, reasoner)

    def act(self, sessions: Sequence[Session], observations: Sequence[Observation]) -> list[ActionChunk | Exception]:
        """The checked actions of each session's policy, or the error of that session alone."""
        chunks = self.policy.act_batch([session.policy for session in sessions], observations)
        return [_checked(chunk) for chunk in chunks]


@dataclass(slots=True)
class Session:
    """A client's own state."""

    policy: Policy
    reasoner: Reasoner | None
    id: str = field(default_factory=lambda: secrets.token_hex(8))
    starts_stages: bool = False
    """Whether the client says when a stage begins. Otherwise a flight begins whenever the prompt changes."""
    prompt: str | None = None
    """The last one of a client that does not."""
    time_s: float = 0.0
    """Flight time of a client that sends none: the control steps so far."""
    guide: Guide | None = None

    def stages(self, message: Message) -> list[EpisodeContext]:
        """The stages that begin with this message; raises `MessageError`."""
        contexts = read_resets(message)
        if contexts is not None:
            self.starts_stages = True
            self.time_s = 0.0
            return contexts
        prompt = read_prompt(message)
        if self.starts_stages or prompt == self.prompt:
            return []
        self.prompt, self.time_s = prompt, 0.0
        return [EpisodeContext(prompt)]

    def reset_policy(self, contexts: Sequence[EpisodeContext]) -> None:
        """Start stages."""
        for context in contexts:
            with calling("the policy"):
                self.policy.reset(context)

    def answer(self, contexts: Sequence[EpisodeContext], image: Image, instruction: str) -> Guidance:
        """The reasoner's answer; raises `ReasonerError`, or `MessageError` without a reasoner."""
        if self.reasoner is None:
            raise MessageError("no_reasoner", "this server has no reasoner; start it with --reasoner NAME")
        with asking():
            for context in contexts:
                self.reasoner.reset(context)
            return check_guidance(self.reasoner.refine(image, instruction))

    def guided(self, contexts: Sequence[EpisodeContext], observation: Observation) -> Observation | None:
        """The observation with the reasoner's directive as instruction; none if the drone must hold its position."""
        if self.reasoner is None:
            return observation
        for context in contexts:
            if context.stage == 0 or self.guide is None:
                self.guide = Guide(self.reasoner, context.seed)
            self.guide.begin(context.stage)
        if self.guide is None:
            self.guide = Guide(self.reasoner, 0)
        return self.guide.apply(observation, None if contexts else self.policy.present)

    def close(self) -> None:
        """Free what this session alone has."""
        self.policy.close()
        if self.reasoner is not None:
            self.reasoner.close()


class Guide:
    """A reasoner in front of a policy for one flight, as in the control loop: asked twice a second of flight time."""

    def __init__(self, reasoner: Reasoner, seed: int) -> None:
        self._reasoner = SimulatedReasoner(reasoner, seed=seed)
        self.begin(0)

    def begin(self, stage: int) -> None:
        """Start a stage."""
        self._stage, self._filter, self._next_s = stage, DirectiveFilter(), -np.inf

    def apply(self, observation: Observation, present: float | None) -> Observation | None:
        """See `Session.guided`; `present` is the policy's, from its last commands of this stage."""
        now = observation.time
        self._filter.policy_says(present)
        if now >= self._next_s:
            self._next_s = now + 1 / REASONER_HZ - 0.5 / CONTROL_HZ  # frames are not exactly in time
            self._reasoner.ask(Question(self._stage, observation.instruction, observation.image, now))
            answer = self._reasoner.answer(now)
            if answer is not None and answer.guidance is not None:
                self._filter.update(answer.guidance, now)
        guidance = self._filter.guidance(now)
        if guidance is None:
            return observation
        return None if declines(guidance.directive) else replace(observation, instruction=guidance.directive)


def _checked(chunk: ActionChunk | Exception) -> ActionChunk | Exception:
    """A valid chunk, or the error to report."""
    if isinstance(chunk, CognitiveDroneError):
        return chunk
    if isinstance(chunk, BaseException):
        return PolicyRaised(f"the policy raised {one_line(chunk)}", "".join(traceback.format_exception(chunk)))
    try:
        with calling("the policy"):  # an object that converts itself runs the policy's code
            return check_chunk(chunk)
    except CognitiveDroneError as error:
        return error


def _name(text: str, known: dict[str, str]) -> str:
    """A plug-in's name without its arguments, which may name files of this machine."""
    parts = text.split(":")
    return parts[0] if parts[0] in known else ":".join(parts[:2])


def _version() -> str:
    """Of this package; sources that were put on the path, never installed, have none."""
    try:
        return importlib.metadata.version("cognitivedrone")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


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

    def __init__(self, served: ServedPilot, limits: Limits) -> None:
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
