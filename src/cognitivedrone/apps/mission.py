"""A flight of the command `fly` as its loop sees it: what to do now, where the loop's reports go, and why it ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.orders import Orders
from cognitivedrone.apps.values import Ending, Instrument, Step
from cognitivedrone.control.closer_look import CloserLook
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import Segment
from cognitivedrone.control.passage import Passage
from cognitivedrone.control.planning import Plans, Route
from cognitivedrone.envs.captions import readable
from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.tasks.directives import HOLD, parse_directive
from cognitivedrone.tasks.matching import asks_the_same
from cognitivedrone.tasks.missions import changed, is_mission, lands, read, rejects, sub_goals, things_of, way
from cognitivedrone.types import Action, Color, Event, Guidance, Observation, StageResult, SubGoal, Task
from cognitivedrone.vehicles.contract import Vehicle

_DECLINED = "declined: no gate matches the instruction"
_UNJUDGED = ("wrong_gate", "false_alarm")
"""Outcomes that may be right where the user asks for something else than the scene."""


def ending_of(vehicle: Vehicle, instruction: str) -> Ending | None:
    """How the flight ended, or none while it continues: by the vehicle, or with the last stage of its track.

    `instruction` is the user's own, "" for the scene's. If it asks for something else than the scene's instruction,
    only the user knows which gate is right.
    """
    track = vehicle.track_runner
    if track is not None and track.finished:
        return _judged(track, instruction)
    return None if vehicle.over is None else Ending("vehicle", vehicle.over)


def flown_by_estimate(gates: int, *, done: bool) -> Ending | None:
    """How the flight of a vehicle without ground truth ended, once it has flown through all gates that were asked.

    `gates` is the pilot's own estimate; nobody but the user knows whether they were the right ones.
    """
    if not (done and gates):
        return None
    what = "a gate" if gates == 1 else f"{gates} gates"
    return Ending("flown", f"flew through {what} by its own estimate (not judged)")


def out_of_time(vehicle: Vehicle, seconds: float) -> Ending:
    """The ending at the time limit: a miss in a scene; a real flight is not judged."""
    return Ending("time" if vehicle.track_runner is None else "missed", f"the time limit of {seconds:g} s is over")


def _judged(track: TrackRunner, instruction: str) -> Ending:
    flown = [
        (result, task, instruction in ("", task.mission) or asks_the_same(instruction, task))
        for result, task in zip(track.results, track.track, strict=True)
        if result.outcome != "not_reached"
    ]
    text = "; ".join(_in_words(result, task, judged=judged) for result, task, judged in flown)
    if any(result.outcome != "passed" and (judged or result.outcome not in _UNJUDGED) for result, _, judged in flown):
        return Ending("missed", text)
    return Ending("passed" if all(judged for *_, judged in flown) else "flown", text)


def _pad(task: Task, index: int) -> str:
    return f"{task.gates[index].color} pad"


def _in_words(result: StageResult, task: Task, *, judged: bool) -> str:
    """How a stage ended, in words."""
    if not judged and result.chosen is not None and result.outcome in ("passed", "wrong_gate"):
        shown = "" if task.only is not None else f"{readable(task.options[result.chosen].removesuffix('.dae'))}; "
        return f"flew through gate {result.chosen + 1} ({shown}you judge), after {result.time_s:.1f} s"
    if not judged and result.outcome == "false_alarm":
        return f"{_DECLINED} (you judge), after {result.time_s:.1f} s"
    gate = "no gate" if result.chosen is None else f"gate {result.chosen + 1}"
    if task.landing and result.chosen is not None and result.outcome in ("passed", "wrong_gate"):
        wanted = (
            "" if result.outcome == "passed" or result.target is None else f", {_pad(task, result.target)} was right"
        )
        return f"landed on the {_pad(task, result.chosen)}{wanted}, after {result.time_s:.1f} s"
    right = "none was right" if result.target is None else f"the right one was {result.target + 1}"
    how = {
        "passed": f"through {gate}" if result.target is not None else _DECLINED if task.mission is None else "looked",
        "wrong_gate": f"through {gate}, {right}",
        "hesitated": "hovered, but did not report that no gate matches the instruction",
        "false_alarm": f"declined, but gate {result.target + 1} is right" if result.target is not None else "",
        "collision": f"collided, flying at {gate}",
        "missed": f"flew past the gates, at {gate}",
        "out_of_bounds": f"left the stage, flying at {gate}",
        "invalid": "the physics diverged",
    }.get(result.outcome, result.outcome)
    return f"{how}, after {result.time_s:.1f} s"


@dataclass(frozen=True, slots=True)
class _Order:
    """What the user wants."""

    sentence: str
    lines: int = 0
    """Typed so far."""
    number: int = 0
    """Of the sentences before it."""
    began: int = 0
    """The stage at which it was given."""
    corrections: tuple[str, ...] = ()
    """Every "no, the other one" since."""
    corrected: int | None = None
    """The stage at which that was said."""
    avoid: frozenset[Color] = frozenset()
    """The gates of that stage that were not meant."""


UNKEPT: Final = "only a reasoner keeps to a condition and to what is forbidden; leave out --reasoner none"


def kept_by_none(goal: SubGoal | None) -> bool:
    """Whether a sub-goal asks for what no policy keeps without a reasoner."""
    return goal is not None and (goal.kind == "if" or bool(goal.avoid))


class Mission:
    """The current segment: the latest typed instruction, else the command's, else the scene's."""

    def __init__(
        self,
        plan: FlyPlan,
        vehicle: Vehicle,
        orders: Orders,
        now: Callable[[], float],
        look: CloserLook,
        passage: Passage | None,
        plain: Callable[[str], str | None],
        refused: Callable[[str], frozenset[str]],
        plans: Plans = sub_goals,
    ) -> None:
        self.segment: Segment | None = None
        self.ending: Ending | None = None
        self._plan, self._vehicle, self._orders, self._now, self._look = plan, vehicle, orders, now, look
        self._passage, self._plain, self._plans = passage, plain, plans
        self._refused = refused
        self.aim: Color | None = None
        """Of the gate that the reasoner directs to, once it has answered about this order and stage."""
        self._unaided = plan.pilot.reasoner == "none"
        self._stage = 0
        self._order = _Order(plan.instruction or "")
        self._route: tuple[tuple[int, str], Route] | None = None

    def __call__(self) -> Segment | None:
        """The segment of now; none once the flight is over, for the reason `ending`."""
        track = self._vehicle.track_runner
        gates = self._passage.gates if self._passage is not None else 0
        index = track.index if track is not None else gates
        if index != self._stage:
            self.aim = None
        order = self._newest(index)
        instruction = order.sentence or (track and track.task.mission) or ""
        self.ending = (
            self._orders.ending
            or ending_of(self._vehicle, order.corrections[-1] if order.corrections else instruction.strip())
            or flown_by_estimate(gates, done=self._done(instruction, gates))
        )
        if self.ending is None and self._now() >= self._plan.time_limit:
            self.ending = out_of_time(self._vehicle, self._plan.time_limit)
            if self._look.active:
                self.ending = Ending("unsure", f"{self.ending.reason}; it was {self._look.described}")
        if self.ending is not None and self._look.given_up:
            self.ending = replace(self.ending, reason=f"{self.ending.reason}; {self._look.reason}")
        if self.ending is not None:
            return None
        truth = track.truth() if track is not None else None
        of_scene = truth.task.instruction if truth is not None else ""
        self._look.begin(index + order.number)
        goal = self._goal(instruction, of_scene, index)
        if goal is not None and goal.kind == "if" and truth is not None and truth.task.landing:
            goal = way([goal])[0]  # pads show nothing
        if goal is not None and (ends := self._landing(goal, track)):
            self.ending = ends
            return None
        sentence = instruction if goal is None else goal.instruction
        # The words of a reasoner's own plan are its own: only what people type may be put into English.
        own = goal is not None and self._plans(instruction) != sub_goals(instruction)
        unkept = self._unaided and kept_by_none(goal)
        plain = sentence if own else None if read(instruction).problem or unkept else self._plain(sentence)
        if goal is not None and not own:
            goal = changed(goal, self._reworded)
        if plain is None:
            self._look.give_up(UNKEPT if unkept else f"{sentence!r} was not understood")
            plain = self.segment.instruction if self.segment is not None else HOLD
        self._stage = index
        self.segment = Segment(index + order.number, plain or of_scene, truth, goal, index, len(order.corrections))
        return self.segment

    def saw(self, guidance: Guidance) -> None:
        """Take the directive of now."""
        self.aim = parse_directive(guidance.directive)[1]
        if self._route is not None:
            self._route[1].seen = guidance.seen

    def _landing(self, goal: SubGoal, track: TrackRunner | None) -> Ending | None:
        """The end where a landing is due, and no pad is here, nor shown once it has looked."""
        first = way([goal], self._route[1].seen if self._route is not None else ())[0]
        if first.kind != "land" or (goal.kind == "if" and not (self._route and self._route[1].seen)):
            return None
        pad = goal is first or lands(first.instruction)[1]
        if track is not None and (track.task.landing or (pad and track.shows_pads_next)):
            return None
        return Ending("ordered", f"landed where it was, as the mission says{': there is no pad here' if pad else ''}")

    def _reworded(self, goal: SubGoal) -> SubGoal:
        """A part of a mission in the words that the pilot is told."""
        plain = {said: self._plain(said) or said for said in (goal.instruction, *things_of(goal.avoid))}
        avoid = frozenset(plain.get(each, each) for each in goal.avoid)
        return replace(goal, instruction=plain[goal.instruction], avoid=avoid)

    def _done(self, instruction: str, gates: int) -> bool:
        """Whether all gates of the mission, or of the plan, are flown through."""
        route = self._route_of(instruction)
        return gates >= self._plan.gates if route is None else route.over(gates)

    def _route_of(self, instruction: str) -> Route | None:
        """The way through the mission that a sentence is, which begins where it was given; none if it is none."""
        order, goals = self._order, self._plans(instruction)
        if not is_mission(goals):
            self._route = None
        elif self._route is None or self._route[0] != (order.number, instruction):
            self._route = (order.number, instruction), Route(goals, order.began)
        return self._route and self._route[1]

    def _newest(self, index: int) -> _Order:
        """The newest order, given at the stage `index`; "no, the other one" is the one before, without this gate.

        Said before the reasoner has directed to a gate, it changes nothing; without a reasoner, it is an order.
        """
        order = self._order
        count, typed = self._orders.given
        if count == order.lines:
            return order
        if not self._unaided and rejects(typed):
            if self.aim is None:
                self._order = replace(order, lines=count)
                return self._order
            avoid = (order.avoid if order.corrected == index else frozenset()) | {self.aim}
            every = (*order.corrections, typed)
            self._order = replace(order, lines=count, corrections=every, corrected=index, avoid=avoid)
        else:
            self.aim = None
            self._order = _Order(typed, count, order.number + 1, index)
        return self._order

    def _goal(self, instruction: str, of_scene: str, index: int) -> SubGoal | None:
        """The sub-goal of now, if the sentence is a mission, says what is not meant, or was corrected here."""
        order, route = self._order, self._route_of(instruction)
        goal = SubGoal("fly", instruction or of_scene) if route is None else route.at(index)
        if not self._unaided:
            goal = changed(goal, lambda part: replace(part, avoid=part.avoid | self._refused(part.instruction)))
        rejected = order.avoid if order.corrected == index else frozenset()
        goal = replace(goal, rejected=rejected)
        return goal if route is not None or goal != SubGoal("fly", goal.instruction) else None


class Recorder:
    """Combines the loop's reports with the vehicle's status, and passes them to the instruments."""

    def __init__(
        self, instruments: Sequence[Instrument], mission: Mission, vehicle: Vehicle, timed: TimedPolicy
    ) -> None:
        self.late = 0
        self.answers_s: list[float] = []
        self._instruments, self._mission, self._vehicle, self._timed = instruments, mission, vehicle, timed
        self._decisions = 0
        self._decision = "fly"

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        """Report a control step."""
        segment, status = self._mission.segment, self._vehicle.status()
        if segment is None:
            return
        if guidance is not None:
            self._mission.saw(guidance)
        if status.decision != self._decision:
            self._decision = status.decision
            self.note(Event(observation.time, "guard", f"{status.decision}: {status.reason}".rstrip(": ")))
        thought = self._timed.took_s[-1] if len(self._timed.took_s) > self._decisions else None
        self._decisions = len(self._timed.took_s)
        step = Step(
            observation.time, segment.index, segment.instruction, observation, action, guidance, thought, status,
            0 if self._vehicle.track_runner is None else self._vehicle.track_runner.index,
        )  # fmt: skip
        for instrument in self._instruments:
            instrument.step(step)

    def note(self, event: Event) -> None:
        """Report an event."""
        self.late += event.kind == "late"
        track = self._vehicle.track_runner
        if event.kind in ("declined", "resumed") and track is not None:
            track.decline(event.kind == "declined")
        if event.kind in ("adopted", "agreed", "kept") and event.age_s is not None:
            self.answers_s.append(event.age_s)
        for instrument in self._instruments:
            instrument.event(event)
