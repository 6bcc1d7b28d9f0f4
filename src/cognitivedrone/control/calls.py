"""Calls into policies and reasoners, which may be a user's own code: exceptions are wrapped, calls can be watched."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Protocol

import numpy as np

from cognitivedrone.errors import ActionError, CognitiveDroneError, NonFiniteAction, PolicyRaised
from cognitivedrone.interfaces import PlugIn
from cognitivedrone.registry import one_line
from cognitivedrone.system.interrupts import is_ctrl_c, raise_pressed
from cognitivedrone.types import ActionChunk, EpisodeContext

_EXPECTED = "expected (k, 4) float32"
_NO_NUMBERS = "cbSUOmM"
"""Kinds of NumPy arrays that would silently become numbers, or half of them: complex, bool, text, objects, dates."""


class Watch(Protocol):
    """Notified when a call begins and ends, so that a hanging call can be detected."""

    def begin(self) -> None:
        """A call begins."""

    def end(self) -> None:
        """The call has returned or raised."""


class NoWatch:
    """A watch that does nothing."""

    def begin(self) -> None:
        """Do nothing."""

    def end(self) -> None:
        """Do nothing."""


NO_WATCH = NoWatch()


@contextmanager
def calling(what: str, watch: Watch = NO_WATCH) -> Iterator[None]:
    """Call `what`, such as "the policy", in the block.

    The package's own errors pass, and so does Ctrl-C. Anything else, `SystemExit` and a `KeyboardInterrupt` of its own
    included, becomes a `PolicyRaised` with its traceback.
    """
    watch.begin()
    try:
        yield
        raise_pressed()
    except CognitiveDroneError:
        raise_pressed()
        raise
    except BaseException as error:
        raise_pressed()
        if is_ctrl_c(error):
            raise
        raise PolicyRaised(f"{what} raised {one_line(error)}", traceback.format_exc()) from error
    finally:
        watch.end()


def check_chunk(chunk: object) -> ActionChunk:
    """The chunk as (k, 4) float32. Converting it may run a user's code, such as `__array__`: do it in `calling`.

    Raises `ActionError` if it has another shape or is not of real numbers, `NonFiniteAction` if a number is NaN or
    infinite.
    """
    if chunk is None:
        raise ActionError(f"the policy returned None, not an array of numbers; {_EXPECTED}")
    of = ""
    try:
        found = np.asarray(chunk)
        of = f", came {found.dtype}"
        if found.dtype.kind in _NO_NUMBERS:
            raise TypeError
        with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused below
            array = np.asarray(found, dtype=np.float32)
    except (TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor that is not on the host
        raise ActionError(
            f"the policy returned {type(chunk).__name__!r}, not an array of numbers; {_EXPECTED}{of}"
        ) from None
    if array.ndim != 2 or array.shape[0] < 1 or array.shape[1] != 4:
        hint = "; return one action as [[vx, vy, vz, yaw_rate]]" if array.shape == (4,) else ""
        raise ActionError(
            f"the policy returned an action of shape {array.shape};"
            f" expected (k, 4): vx, vy, vz in m/s and yaw rate in rad/s{hint}"
        )
    if not np.isfinite(array).all():
        raise NonFiniteAction(f"the policy returned {array[0].tolist()}: not all of it is a finite number")
    return array


def begin_stage(part: PlugIn, context: EpisodeContext) -> None:
    """Reset a policy or reasoner for a stage, with the ground truth only if it declares that it needs it."""
    part.reset(context if part.needs_ground_truth else replace(context, ground_truth=None))


def seed_of(part: PlugIn | None, rng: np.random.Generator) -> int:
    """The episode's seed for a policy or reasoner, drawn from the episode's generator only if it needs one; else 0."""
    return int(rng.integers(2**31)) if part is not None and part.needs_seed else 0
