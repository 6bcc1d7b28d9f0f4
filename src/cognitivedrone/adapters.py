"""Adapts a user's object to the full `Policy` or `Reasoner` interface.

An object that inherits one of them is used unchanged. Any other gets defaults for the methods and attributes that it
lacks. Classes written for the interface before `EpisodeContext` still work, with a warning, until the next version.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cognitivedrone.errors import PluginError
from cognitivedrone.interfaces import PlugIn, Policy, Reasoner
from cognitivedrone.types import ActionChunk, EpisodeContext, Guidance, Image, Observation

_OLD_METHODS = ("seed", "brief", "new_flight", "new_stage", "check")


def as_policy(what: str, part: Any) -> Policy:
    """`part` as a policy; `what` names it in messages. Raises `PolicyError` if it lacks `reset` or `act`."""
    if isinstance(part, Policy):
        return part
    _check_methods(what, part, "reset", "act")
    return _AdaptedPolicy(what, part, old=_takes_text(part.reset))


def as_reasoner(what: str, part: Any) -> Reasoner:
    """`part` as a reasoner; `what` names it in messages. Raises `PolicyError` if it lacks `refine`."""
    if isinstance(part, Reasoner):
        return part
    _check_methods(what, part, "refine")
    return _AdaptedReasoner(what, part, old=not hasattr(part, "reset") and bool(_old_methods(part)))


def _check_methods(what: str, part: Any, *methods: str) -> None:
    for method in methods:
        if not callable(getattr(part, method, None)):
            raise PluginError(f"{what} has no method {method}(); see cognitivedrone.interfaces")


class _Adapted(PlugIn):
    """Wraps a user's object that inherits none of our classes."""

    def __init__(self, what: str, part: Any, *, old: bool) -> None:
        self._what, self._part = what, part
        self._old = _old_methods(part) if old else ()
        self._takes_text = old and hasattr(part, "reset")
        self.needs_ground_truth = getattr(part, "needs_ground_truth", False) is True or "brief" in self._old
        self.needs_seed = getattr(part, "needs_seed", False) is True or "seed" in self._old
        if old:
            methods = [*(["reset(instruction)"] if self._takes_text else []), *(f"{method}()" for method in self._old)]
            warnings.warn(
                f"{what} has methods of the former contract ({', '.join(methods)}), which the next version will not"
                " call: write reset(self, context) and read context.instruction (docs/own_policy.md)",
                FutureWarning,
                stacklevel=4,
            )

    def reset(self, context: EpisodeContext) -> None:
        if "seed" in self._old and context.stage == 0:
            self._part.seed(context.seed)
        if {"new_flight", "new_stage"} <= set(self._old):
            (self._part.new_stage if context.stage else self._part.new_flight)()
        if self._takes_text:
            self._part.reset(context.instruction)
        elif hasattr(self._part, "reset"):
            with self._explained():
                self._part.reset(context)
        if "brief" in self._old and context.ground_truth is not None:
            self._part.brief(context.ground_truth)

    def check(self) -> None:
        if "check" in self._old:
            self._part.check()

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


def _old_methods(part: Any) -> tuple[str, ...]:
    return tuple(method for method in _OLD_METHODS if callable(getattr(part, method, None)))


def _takes_text(reset: Any) -> bool:
    """Whether a method has the form `reset(self, instruction: str)`, by its parameter's name or type."""
    try:
        parameters = [*inspect.signature(reset).parameters.values()]
    except (TypeError, ValueError):  # some classes written in C
        return False
    return bool(parameters) and (parameters[0].name == "instruction" or parameters[0].annotation in (str, "str"))
