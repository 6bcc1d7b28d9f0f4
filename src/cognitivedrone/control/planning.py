"""The plan of a mission: the reasoner's own, asked for on the ground, or else the sentence cut by its words."""

from __future__ import annotations

from collections.abc import Callable

from cognitivedrone.control.async_reasoner import asking
from cognitivedrone.control.calls import NO_WATCH, Watch
from cognitivedrone.errors import ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.tasks.missions import problem_of, sub_goals
from cognitivedrone.types import SubGoal

Plans = Callable[[str], tuple[SubGoal, ...]]
"""The sub-goals of a sentence; at least one."""


def plans_with(reasoner: Reasoner | None, mission: str, watch: Watch = NO_WATCH) -> Plans:
    """The plan of `mission`, made now by a reasoner that plans, and of any other sentence cut by its words.

    Raises `ReasonerError` if the reasoner has no plan that can be flown.
    """
    own = None if reasoner is None else _plan_of(reasoner, mission, watch)
    return lambda sentence: own if own is not None and sentence == mission else sub_goals(sentence)


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
