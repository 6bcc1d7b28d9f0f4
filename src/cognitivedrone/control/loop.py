"""The control loop: policy at 10 Hz, reasoner at 2 Hz, on absolute deadlines of the given clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cognitivedrone.control.async_reasoner import UNAIDED, AsyncReasoner, LateAnswers, Question
from cognitivedrone.control.calls import begin_stage, check_chunk
from cognitivedrone.control.closer_look import CloserLook
from cognitivedrone.control.directive_filter import DirectiveFilter
from cognitivedrone.control.latency import LatencyModel
from cognitivedrone.control.planning import Lander
from cognitivedrone.interfaces import Clock, Drone, Policy, Recorder
from cognitivedrone.tasks.directives import HOLD, declines
from cognitivedrone.tasks.missions import lands
from cognitivedrone.types import (
    CONTROL_HZ,
    REASONER_HZ,
    Action,
    EpisodeContext,
    Event,
    GroundTruth,
    Guidance,
    Observation,
    SubGoal,
)

LATE_S = 0.010
"""A deadline missed by less than this, plus one step of the clock, counts as met."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of a flight with one instruction."""

    index: int
    """Number of the instruction: a new index starts a new segment even if the text is the same."""
    instruction: str
    truth: GroundTruth | None = None
    """Only in a simulator, for policies and reasoners that need it."""
    goal: SubGoal | None = None
    """What this part of a mission is about, if the instruction is part of one."""
    stage: int | None = None
    """Number of the stage, where an instruction may be given in the middle of one; by default as `index`."""
    corrections: int = 0
    """How often the user rejected the gate flown at: a choice is dropped with each, but not what was seen."""


Mission = Callable[[], Segment | None]
"""Returns the current segment; called before every control step. None ends the flight."""


def resolution_of(clock: Clock) -> float:
    """The steps in which a clock goes on, s: `resolution_s`, where it has one."""
    return float(getattr(clock, "resolution_s", 0.0))


def fly(
    drone: Drone,
    policy: Policy,
    clock: Clock,
    mission: Mission,
    *,
    reasoner: AsyncReasoner | None = None,
    look: CloserLook | None = None,
    recorder: Recorder | None = None,
    latency_model: LatencyModel | None = None,
    seed: int = 0,
    real_time: bool = False,
) -> int:
    """Fly until the mission ends; returns the number of commands sent.

    The policy decides on absolute deadlines; a deadline that has passed is skipped. Its commands are sent when
    inference is done: on a wall clock after the time it takes, on a simulated clock after the time that `latency_model`
    charges. A chunk of actions is flown to its end before the policy is asked again.

    A new segment resets the policy, with `seed` in its context, and drops the rest of the chunk; a correction drops
    directive and chunk alone. The `reasoner` is
    asked about the newest frame at the start of a segment and then `REASONER_HZ` times a second, if it is idle. Its
    directive replaces the instruction when it arrives; `DirectiveFilter` decides whether it replaces another directive.
    The recorder is notified when `UNAIDED` answers in a row were late.

    Where the reasoner's answers leave it in doubt, the drone looks closer (`look`): on the way ahead the policy still
    sees every frame, for what is in the way, but it does not fly, and only the answer at the end of the look counts.

    The pilot declines while the current directive is "Hold position", or while the policy says so (`Policy.declines`).
    With that directive, or one to land, the drone hovers and the policy is not asked; so it does before the first
    directive where something is forbidden, or depends on what is seen. Where the segment's instruction,
    never only a directive, is to land on a pad, the loop's own `Lander` flies, and nobody is asked. The recorder is
    notified of both ends, and of when the policy only holds the position because it is in trouble (`Policy.trouble`).

    `real_time` tells the policy whether time goes on while it computes.
    """
    log, look = recorder or _NullRecorder(), look or CloserLook.of("no")
    start = clock.now()
    tolerance_s = LATE_S + resolution_of(clock)
    segment_index: int | None = None
    corrections = 0
    directive_filter, late_answers = DirectiveFilter(), LateAnswers()
    declined, troubled, looked, stage = False, False, False, None
    pending: list[Action] = []
    lander = Lander()
    slot = sent_count = 0
    next_question = 0
    while (segment := mission()) is not None:
        late = clock.now() - (start + slot / CONTROL_HZ)
        if slot and late > tolerance_s:
            log.note(Event(clock.now() - start, "late", age_s=late))
        if segment.index != segment_index:
            number = 0 if segment_index is None else segment.index
            segment_index, directive_filter, pending, next_question = segment.index, DirectiveFilter(), [], slot
            declined, lander, corrections = False, Lander(), segment.corrections
            look.begin(segment.index)
            begin_stage(policy, EpisodeContext(segment.instruction, seed, number, segment.truth, real_time))
            log.note(Event(clock.now() - start, "segment", segment.instruction))
        elif segment.corrections != corrections:
            corrections, directive_filter, pending, next_question = segment.corrections, DirectiveFilter(), [], slot
            log.note(Event(clock.now() - start, "corrected", segment.instruction))
        observation = drone.observe()
        look.see(observation, waits=declined)
        if stage != (stage := segment.index if segment.stage is None else segment.stage):
            look.begin_stage()
        landing, pad = lands(segment.instruction)
        if reasoner is not None and not landing:
            _poll(reasoner, directive_filter, look, late_answers, segment, start, clock.now(), log)
            if slot >= next_question and look.listens and reasoner.idle(clock.now()):
                told = segment.truth, segment.goal, stage
                reasoner.ask(Question(segment.index, segment.instruction, observation.image, clock.now(), *told))
                log.note(Event(clock.now() - start, "asked", segment.instruction))
                next_question = slot + CONTROL_HZ // REASONER_HZ
                _poll(reasoner, directive_filter, look, late_answers, segment, start, clock.now(), log)
        guidance = directive_filter.guidance(clock.now())
        observation = replace(observation, instruction=guidance.directive if guidance else segment.instruction)
        looks = look.active and not landing
        if looked != looks:
            looked, pending = looks, []
            log.note(Event(clock.now() - start, "hold" if looks else "sure", look.described))
        led = guidance is not None and (declines(guidance.directive) or lands(guidance.directive)[0])
        held = look.given_up or (not looks and led)
        if held:
            pending = [np.zeros(4, dtype=np.float32)]
        elif not looks and guidance is None and segment.goal and (segment.goal.kind == "if" or segment.goal.avoid):
            pending = [np.zeros(4, dtype=np.float32)]  # nobody has said yet what is not flown through
        elif landing:
            pending = [lander.act(observation, pad)]
        elif not pending and (not looks or look.ahead):
            begin = time.perf_counter()
            pending = list(check_chunk(policy.act(observation)))
            directive_filter.policy_says(policy.present)
            if latency_model is not None:
                clock.sleep_until(clock.now() + latency_model(time.perf_counter() - begin))
        action = pending.pop(0) if pending else np.zeros(4, dtype=np.float32)
        if looks:
            action = policy.around(look.command())
        if declined != (held or (policy.declines and not landing and not looks)):
            declined = not declined
            log.note(Event(clock.now() - start, "declined" if declined else "resumed", observation.instruction))
        if troubled != bool(policy.trouble):
            troubled = not troubled
            log.note(Event(clock.now() - start, "lost" if troubled else "back", policy.trouble))
        sent = drone.send(action)
        log.record(observation, sent, guidance)
        sent_count += 1
        slot = max(slot + 1, math.ceil((clock.now() - start) * CONTROL_HZ - LATE_S * CONTROL_HZ))
        clock.sleep_until(start + slot / CONTROL_HZ)
    return sent_count


def _poll(
    reasoner: AsyncReasoner,
    directive_filter: DirectiveFilter,
    look: CloserLook,
    late_answers: LateAnswers,
    segment: Segment,
    start: float,
    now: float,
    log: Recorder,
) -> None:
    """Take the reasoner's answer, if it has arrived."""
    answer = reasoner.answer(now)
    if answer is None:
        return
    age = now - answer.question.time
    if (answer.question.segment, answer.question.goal) != (segment.index, segment.goal):
        text = answer.guidance.directive if answer.guidance else answer.message
        log.note(Event(now - start, "stale", text, age))
    elif not look.hear(answer) and answer.guidance is not None:
        log.note(Event(now - start, "kept", answer.guidance.directive, age))
    elif answer.guidance is None:
        log.note(Event(now - start, answer.fault or "garbage", answer.message, age))
        if look.ended and answer.fault == "unsure":  # from near, what it cannot name is not there
            directive_filter.update(Guidance(HOLD, None, 1.0), answer.question.time, looked=True)
    else:
        what = directive_filter.update(answer.guidance, answer.question.time, looked=look.ended)
        log.note(Event(now - start, what, answer.guidance.directive, age))
    if late_answers.count(age):
        text = f"the last {UNAIDED} answers of the reasoner were late: the policy flies without it"
        log.note(Event(now - start, "unaided", text, age))


class _NullRecorder:
    """A recorder that discards everything."""

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        pass

    def note(self, event: Event) -> None:
        pass
