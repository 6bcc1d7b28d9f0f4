"""A reasoner that runs beside the control loop: it works on a frame while the policy flies on.

On a simulated clock (`SimulatedReasoner`) the answer is computed at once and delivered after its latency; on the wall
clock (`ThreadedReasoner`) it is computed in a thread. Either way there is one question at a time and no queue: once the
reasoner is idle, it is asked about the newest frame.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from typing import Final, Protocol

import numpy as np

from cognitivedrone.control.calls import NO_WATCH, Watch, begin_stage, calling
from cognitivedrone.control.latency import LatencyModel
from cognitivedrone.errors import PolicyRaised, ReasonerError, ReasonerFault
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.tasks.directives import HOLD, declines, parse_directive, write_directive
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.missions import shuts, things_of
from cognitivedrone.types import (
    CONTROL_HZ,
    REASONER_HZ,
    EpisodeContext,
    GroundTruth,
    Guidance,
    Image,
    SeenPanel,
    SubGoal,
)

LEAVE_S: Final = 3.0
"""A reasoner that still thinks after the flight has so long to come to an end."""
LONGEST_DIRECTIVE = 1000
"""Maximum length in characters."""
ANSWER_S: Final = 1 / REASONER_HZ + 0.5 / CONTROL_HZ
"""An answer that is older is late: the control step has passed in which the next question was due, s."""
FITS: Final = 0.05
"""Where the likeliest gate is forbidden, another is flown through that fits with more than this probability. R1 gave
more to all 18 gates that fitted, and to 10.2 % of 588 that did not; with 0.1 these are 6.5 %, but an allowed animal in
tests/apps/test_mission_flights.py was hovered at."""
STAYS: Final = 3
"""Where gates are forbidden, one that was named in so many answers in a row stays the answer. A drone that turns late
ended in the forbidden one between them (2 of 42 stages of `open-v3:missions`)."""
MAY_SHOW: Final = 0.25
"""A gate that shows a forbidden thing with more than this probability is not flown through, where the reasoner is
unsure of the sentence. R1 was at 2 stages: the right gates had more, and so had 2 of 4 others."""
MAY_READ: Final = 0.02
"""A panel that is read as a thing with more than this probability may show it. R1 read 5.1 % of 1,012 things that were
there with less, and 0.6 % of 6,300 names of things that were not with more; with 0.01 it is 4.2 and 0.8 %.

All three: first frames of all stages of `open-v3:missions` and `open-v1:test`, `benchmarks/prohibitions.py`."""
UNAIDED: Final = 40
"""After so many late answers in a row, the policy is said to fly without its reasoner."""


_NAMED = re.compile(r"^fly (?:to|through) (?:the gate with )?(?:the |an? )?", re.I)


class LateAnswers:
    """Counts the answers in a row that came late."""

    def __init__(self) -> None:
        self.row = 0

    def count(self, age_s: float) -> bool:
        """Count an answer to a frame of this age; whether it completes a row of `UNAIDED`."""
        self.row = self.row + 1 if age_s > ANSWER_S else 0
        return self.row == UNAIDED


@dataclass(frozen=True, slots=True)
class Question:
    """A question to a reasoner."""

    segment: int
    """Index of the segment that it belongs to."""
    instruction: str
    image: Image
    time: float
    """Time of the frame on the loop's clock, s."""
    truth: GroundTruth | None = None
    """Only in a simulator, for reasoners that need it."""
    goal: SubGoal | None = None
    """What this part of a mission is about."""
    stage: int | None = None
    """Number of the stage, if several segments may belong to one."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A reasoner's answer: guidance, or a fault."""

    question: Question
    guidance: Guidance | None
    fault: ReasonerFault | None = None
    message: str = ""
    trace: str = ""
    """Traceback, if the reasoner raised an exception of its own."""
    certainty: float | None = None
    """Of a fault: as `ReasonerError.certainty`."""
    seen: Sequence[SeenPanel] = ()
    """What the reasoner has read of the panels by then."""


class AsyncReasoner(Protocol):
    """Interface between the control loop and a reasoner; `now` is the time on the loop's clock, s."""

    def idle(self, now: float) -> bool:
        """Whether it can be asked."""

    def ask(self, question: Question) -> None:
        """Start working on a question; only while idle."""

    def answer(self, now: float) -> Answer | None:
        """The answer to the last question, once, when it has arrived."""

    def close(self) -> None:
        """End the flight."""


class SimulatedReasoner:
    """Computes the answer at once and delivers it after the charged latency."""

    def __init__(
        self, reasoner: Reasoner, latency_model: LatencyModel = lambda _: 0.0, watch: Watch = NO_WATCH, *, seed: int = 0
    ) -> None:
        self._thinker = _Thinker(reasoner, watch, seed)
        self._charge = latency_model
        self.trace = ""
        """The first traceback of the reasoner's own exceptions; empty where it raised none."""
        self._pending: tuple[float, Answer] | None = None

    def idle(self, now: float) -> bool:  # noqa: ARG002
        """Whether the last answer was taken."""
        return self._pending is None

    def ask(self, question: Question) -> None:
        """Compute the answer."""
        begin = time.perf_counter()
        answer = self._thinker.think(question)
        self.trace = self.trace or answer.trace
        self._pending = question.time + self._charge(time.perf_counter() - begin), answer

    def answer(self, now: float) -> Answer | None:
        """The answer, once its latency has passed."""
        if self._pending is None or self._pending[0] > now + 1e-9:
            return None
        _, answer = self._pending
        self._pending = None
        return answer

    def close(self) -> None:
        """Discard the pending answer."""
        self._pending = None


class ThreadedReasoner:
    """Computes answers in a thread beside the loop; one that never comes keeps neither the flight nor the process."""

    def __init__(self, reasoner: Reasoner) -> None:
        self._thinker = _Thinker(reasoner)
        self._questions: SimpleQueue[Question | None] = SimpleQueue()
        self._answers: SimpleQueue[Answer | BaseException] = SimpleQueue()
        self._asked = False
        # A daemon: the process may end while it thinks, which no pool of concurrent.futures allows.
        self._thread = threading.Thread(target=self._think, name="reasoner", daemon=True)
        self._thread.start()

    def idle(self, now: float) -> bool:  # noqa: ARG002
        """Whether the last answer was taken."""
        return not self._asked

    def ask(self, question: Question) -> None:
        """Start computing the answer."""
        self._asked = True
        self._questions.put(question)

    def answer(self, now: float) -> Answer | None:  # noqa: ARG002
        """The answer, once the thread has it."""
        try:
            answer = self._answers.get_nowait()
        except Empty:
            return None
        self._asked = False
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def close(self) -> None:
        """Shut down; a pending answer is waited for a moment.

        A thread that is inside a library of C++ when the interpreter ends takes the process down ("terminate called
        without an active exception").
        """
        self._questions.put(None)
        self._thread.join(LEAVE_S)

    def _think(self) -> None:
        while (question := self._questions.get()) is not None:
            try:
                self._answers.put(self._thinker.think(question))
            except BaseException as error:  # the loop raises it
                self._answers.put(error)


class _Thinker:
    """Asks a reasoner, resets it at flights and stages, and turns its faults into answers."""

    def __init__(self, reasoner: Reasoner, watch: Watch = NO_WATCH, seed: int = 0) -> None:
        self._reasoner = reasoner
        self._watch = watch
        self._seed = seed
        self._segment: int | None = None
        self._stage: int | None = None
        self._chosen: str | None = None
        self._row = 0

    def think(self, question: Question) -> Answer:
        """An answer in any case: an exception or invalid result of the reasoner becomes a fault."""
        try:
            with asking(self._watch):
                return Answer(question, check_guidance(self._ask(question)), seen=self._reasoner.seen)
        except ReasonerError as error:
            return Answer(question, None, error.kind, str(error), error.trace, error.certainty, self._reasoner.seen)

    def _ask(self, question: Question) -> Guidance:
        reasoner = self._reasoner
        if question.segment != self._segment:
            stage = 0 if self._segment is None else question.segment
            same = question.stage is not None and question.stage == self._stage
            context = EpisodeContext(question.instruction, self._seed, stage, question.truth, same_stage=same)
            begin_stage(reasoner, context)
            self._segment, self._stage, self._chosen, self._row = question.segment, question.stage, None, 0
        if question.goal is None:
            return reasoner.refine(question.image, question.instruction)
        found = _within(question.goal, question.image, reasoner, self._chosen if self._row >= STAYS else None)
        color = parse_directive(found.directive)[1]
        self._chosen, self._row = color, self._row + 1 if color == self._chosen else 1
        return found


def _within(goal: SubGoal, image: Image, reasoner: Reasoner, chosen: str | None) -> Guidance:
    """An answer that keeps to a sub-goal: the way through its choices, and gates that are not flown through.

    It declines if every gate that fits is forbidden. The gate whose colour is `chosen` stays the answer.
    """
    first, seen = goal, list[bool]()
    while first.kind == "if":
        found = reasoner.refine(image, first.instruction)
        if _read_of(first.instruction, reasoner) == frozenset():
            found = Guidance(HOLD, None, 1 - MAY_READ)
        seen.append(there := not declines(found.directive))
        first = (first.then if there else first.otherwise)[0]
        if first.kind == "land":
            return Guidance(first.instruction, None, found.confidence, seen=tuple(seen))
    things, kept = things_of(first.avoid), bool(first.avoid)
    found = _answer_to(first.instruction, image, reasoner, kept=kept)
    never = first.avoid.difference(things).union(goal.rejected, *(_showing(thing, image, reasoner) for thing in things))
    if things:  # a reasoner remembers its last answer
        found = _answer_to(first.instruction, image, reasoner, kept=kept)
    if never and not reasoner.seen:  # it does not say what else may fit
        shut = [f"the {look} gate" for look in sorted(never)] + [thing.removeprefix("Fly to ") for thing in things]
        found = reasoner.refine(image, f"{first.instruction}, but never through {' or '.join(shut)}")
    least = 0.0 if goal.rejected else FITS
    return replace(_allowed(found, never, reasoner, least, chosen), seen=tuple(seen))


def _answer_to(sentence: str, image: Image, reasoner: Reasoner, *, kept: bool) -> Guidance:
    """A reasoner's answer; an empty one if it is unsure and something is forbidden, of which a policy knows nothing."""
    try:
        return reasoner.refine(image, sentence)
    except ReasonerError as error:
        if error.kind != "unsure" or not kept or any(panel.right is None for panel in reasoner.seen):
            raise
        return Guidance("", None, 0.0)


def _allowed(found: Guidance, never: frozenset[str], reasoner: Reasoner, least: float, chosen: str | None) -> Guidance:
    """An answer that names what is not forbidden, or else the likeliest gate that is not, or to hold.

    That gate fits with more than the probability `least`. An empty answer names none.
    """
    named = parse_directive(found.directive)
    looks = {panel.color: _look_of(panel) for panel in reasoner.seen}
    look_named = next((look for color, look in looks.items() if color == named[1]), frozenset())
    fits = [(panel.right or 0.0, at) for at, panel in enumerate(reasoner.seen) if not shuts(never, _look_of(panel))]
    stays = next((fit for fit in fits if never and reasoner.seen[fit[1]].color == chosen), None)
    if found.directive and not shuts(never, {*named, *look_named}) and (stays is None or named[1] == chosen):
        return found
    best, number = stays or max(fits, default=(0.0, 0))
    if best <= least and stays is None:
        return Guidance(HOLD, None, 1.0, present=0.0)
    panel = reasoner.seen[number]
    directive = f"Fly through the {panel.color} gate" if panel.gate is None else write_directive(panel.gate)
    return Guidance(directive, number, max(fits)[0] / max(sum(share for share, _ in fits), 1e-9))


def _look_of(panel: SeenPanel) -> frozenset[str]:
    """What was read of how a gate looks."""
    return frozenset({panel.color} if panel.gate is None else {panel.color, panel.gate.shape, panel.gate.size})


def _read_of(thing: str, reasoner: Reasoner) -> frozenset[str] | None:
    """The colours of the gates whose panels may be read as the thing that a sentence names; none if it names none.

    Asked for what is not there, a reasoner may choose what is most like it.
    """
    name = _NAMED.sub("", thing).strip(" .").lower()
    if not reasoner.seen or not (name.replace(" ", "_") in KIND_OF or name.startswith(("letter ", "number "))):
        return None
    read = ((panel.color, {said.lower(): share for said, share in panel.readings}) for panel in reasoner.seen)
    return frozenset(color for color, shares in read if shares.get(name, 0.0) > MAY_READ)


def _showing(thing: str, image: Image, reasoner: Reasoner) -> frozenset[str]:
    """The colours of the gates that show what a sentence asks for, or may."""
    if (read := _read_of(thing, reasoner)) is not None:
        return read
    try:
        found = reasoner.refine(image, thing)
    except ReasonerError as error:
        if error.kind != "unsure" or any(panel.right is None for panel in reasoner.seen):
            raise
        return frozenset(panel.color for panel in reasoner.seen if (panel.right or 0.0) > MAY_SHOW)
    color = parse_directive(found.directive)[1]
    if color is None and not declines(found.directive):
        raise ReasonerError("unsure", f"it does not say which gate shows what is forbidden: {found.directive[:80]!r}")
    return frozenset(filter(None, [color]))


@contextmanager
def asking(watch: Watch = NO_WATCH) -> Iterator[None]:
    """Call a reasoner in the block; an exception of its own becomes a `ReasonerError` of kind `raised`."""
    try:
        with calling("the reasoner", watch):
            yield
    except PolicyRaised as error:
        raise ReasonerError("raised", str(error), error.trace) from error


def check_guidance(guidance: object) -> Guidance:
    """A reasoner's answer, unchanged. Raises `ReasonerError` if it is not usable."""
    if not isinstance(guidance, Guidance):
        found = type(guidance).__name__
        raise ReasonerError("schema", f"the reasoner returned {found!r}; expected cognitivedrone.types.Guidance")
    directive, gate, confidence = guidance.directive, guidance.gate, guidance.confidence
    if not isinstance(directive, str):
        raise ReasonerError("schema", f"the directive is {type(directive).__name__!r}; expected a sentence")
    if len(directive) > LONGEST_DIRECTIVE:
        raise ReasonerError("too_long", f"the directive has {len(directive)} characters; at most {LONGEST_DIRECTIVE}")
    if not directive.strip() or not directive.isprintable():
        raise ReasonerError("garbage", f"the directive {directive[:60]!a} is not one line of printable text")
    if gate is not None and gate not in range(3):
        raise ReasonerError("no_such_gate", f"the gate is {gate!r}; expected 0, 1, 2 or None")
    if not isinstance(confidence, (int, float, np.floating)) or not 0 <= confidence <= 1:
        raise ReasonerError("schema", f"the confidence is {confidence!r}; expected a number from 0 to 1")
    return guidance
