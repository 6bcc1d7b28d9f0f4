"""Adapts a user's object to the full `Policy` or `Reasoner` interface.

An object that inherits one of them is used unchanged. Any other gets defaults for the methods and attributes that it
lacks.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cognitivedrone.errors import PluginError
from cognitivedrone.interfaces import PlugIn, Policy, Reasoner
from cognitivedrone.types import ActionChunk, EpisodeContext, Guidance, Image, Observation, SubGoal

POLICY_METHODS = ("reset", "act")
REASONER_METHODS = ("refine",)
"""What a class must have to be a policy or a reasoner."""


def as_policy(what: str, part: Any) -> Policy:
    """`part` as a policy; `what` names it in messages. Raises `PolicyError` if it lacks `reset` or `act`."""
    if isinstance(part, Policy):
        return part
    _check_methods(what, part, *POLICY_METHODS)
    return _AdaptedPolicy(what, part)


def as_reasoner(what: str, part: Any) -> Reasoner:
    """`part` as a reasoner; `what` names it in messages. Raises `PolicyError` if it lacks `refine`."""
    if isinstance(part, Reasoner):
        return part
    _check_methods(what, part, *REASONER_METHODS)
    return _AdaptedReasoner(what, part)


def _check_methods(what: str, part: Any, *methods: str) -> None:
    for method in methods:
        if not callable(getattr(part, method, None)):
            raise PluginError(f"{what} has no method {method}(); see cognitivedrone.interfaces")


class _Adapted(PlugIn):
    """Wraps a user's object that inherits none of our classes."""

    def __init__(self, what: str, part: Any) -> None:
        self._what, self._part = what, part
        self.needs_ground_truth = getattr(part, "needs_ground_truth", False) is True
        self.needs_seed = getattr(part, "needs_seed", False) is True
        self.needs_down_camera = getattr(part, "needs_down_camera", False) is True
        self.reads_english_only = getattr(part, "reads_english_only", False) is True

    def reset(self, context: EpisodeContext) -> None:
        if hasattr(self._part, "reset"):
            with self._explained():
                self._part.reset(context)

    def close(self) -> None:
        close = getattr(self._part, "close", None)
        if callable(close):
            close()

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Explain errors of a class that mistakes the context for the instruction."""
        try:
            yield
        except (AttributeError, TypeError) as error:
            if EpisodeContext.__name__ not in str(error):
                raise
            raise PluginError(
                f"{self._what}: reset(context) receives an EpisodeContext, not text ({error}); read context.instruction"
            ) from error


class _AdaptedPolicy(_Adapted, Policy):
    @property
    def declines(self) -> bool:  # type: ignore[override]
        return getattr(self._part, "declines", False) is True

    @property
    def present(self) -> float | None:  # type: ignore[override]
        present = getattr(self._part, "present", None)
        return float(present) if isinstance(present, int | float) else None

    def act(self, observation: Observation) -> ActionChunk:
        with self._explained():
            chunk: ActionChunk = self._part.act(observation)
        return chunk


class _AdaptedReasoner(_Adapted, Reasoner):
    def refine(self, image: Image, instruction: str) -> Guidance:
        with self._explained():
            guidance: Guidance = self._part.refine(image, instruction)
        return guidance

    def plan(self, mission: str) -> tuple[SubGoal, ...] | None:
        plan = getattr(self._part, "plan", None)
        return plan(mission) if callable(plan) else None
