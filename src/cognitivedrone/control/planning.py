"""The plan of a mission: the reasoner's own, asked for on the ground, or else the sentence read by its words."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cognitivedrone.control.async_reasoner import asking
from cognitivedrone.control.calls import NO_WATCH, Watch
from cognitivedrone.errors import ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.tasks.missions import forbidden, forbidding, parts_of, problem_of, read, sub_goals, way
from cognitivedrone.types import COLORS, SubGoal

Plans = Callable[[str], tuple[SubGoal, ...]]
"""The sub-goals of a sentence; at least one."""


def plans_with(reasoner: Reasoner | None, mission: str, watch: Watch = NO_WATCH) -> Plans:
    """The plan of `mission`, made now by a reasoner that plans, and of any other sentence read by its words.

    A plan of its own must keep to what the words forbid, and to their landing. Of conditions it can hold that another
    thing is flown to where one is not there; all others are left to the words. Raises `ReasonerError` if there is no
    plan that can be flown.
    """
    words = read(mission)
    judged = reasoner is not None and not reasoner.needs_ground_truth
    kept = any(goal.kind == "if" and not _is_plain(goal) for goal in words.goals)
    own = None if reasoner is None or kept else _plan_of(reasoner, mission, watch)
    if judged and own is None and words.problem:
        raise ReasonerError("schema", f"the mission {words.problem}")
    if own is not None and not words.problem:
        if lost := _lost(words.goals, own):
            raise ReasonerError("schema", f"the reasoner's plan leaves out {lost}")
        own = tuple(forbidding(goal, forbidden(mission)) for goal in own)
        if problem := problem_of(own):
            raise ReasonerError("schema", f"the reasoner's plan {problem}")
    return lambda sentence: own if own is not None and sentence == mission else sub_goals(sentence)


def _is_plain(goal: SubGoal) -> bool:
    """Whether a choice is between flying to a thing and, where that is not there, to another one."""
    return goal.then == (SubGoal("fly", goal.instruction, avoid=goal.avoid),) and [
        part.kind for part in parts_of(goal.otherwise)
    ] == ["fly"]


def _lost(words: tuple[SubGoal, ...], own: tuple[SubGoal, ...]) -> str:
    """What the words say and a plan, which knows no other prohibition, does not: a colour, or the landing."""
    colors = frozenset(COLORS).intersection(each for goal in words for each in goal.avoid)
    if any(goal.kind != "land" and not goal.avoid >= colors for goal in own):
        return f"what is forbidden, {' and '.join(sorted(colors))}"
    landings = [[goal.instruction for goal in goals if goal.kind == "land"] for goals in (words, own)]
    return "" if landings[0] == landings[1] else f"the landing, {(landings[0] or ['none'])[0].lower()}"


def _plan_of(reasoner: Reasoner, mission: str, watch: Watch) -> tuple[SubGoal, ...] | None:
    with asking(watch):
        plan: object = reasoner.plan(mission)
    if plan is None:
        return None
    if not isinstance(plan, tuple) or not all(isinstance(goal, SubGoal) for goal in plan):
        raise ReasonerError("schema", f"the reasoner's plan is {repr(plan)[:80]}; expected a tuple of SubGoal")
    if not plan:
        raise ReasonerError("schema", "the reasoner's plan is empty; there is nothing to fly")
    if problem := problem_of(plan):
        raise ReasonerError("schema", f"the reasoner's plan {problem}")
    return plan


class Route:
    """A mission as far as it is flown: the way through its choices, by what was seen when they were reached."""

    def __init__(self, goals: Sequence[SubGoal], began: int = 0) -> None:
        self._goals, self._stage, self._last = tuple(goals), began, goals[-1]
        self.seen: tuple[bool, ...] = ()
        """As `Guidance.seen`, of the stage of now."""

    def at(self, stage: int) -> SubGoal:
        """The sub-goal of a stage; the last one where none is left. Stages are asked about in their order."""
        while self._stage < stage:
            if self._goals:
                self._last, rest = way(self._goals, self.seen)
                self._goals = (self._last,) if self._last.kind == "land" else rest
            self._stage, self.seen = self._stage + 1, ()
        return self._goals[0] if self._goals else self._last

    def over(self, stage: int) -> bool:
        """Whether nothing but a landing is left at a stage."""
        self.at(stage)
        return all(goal.kind == "land" for goal in self._goals)
