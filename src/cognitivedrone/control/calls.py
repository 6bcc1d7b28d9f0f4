"""Calls into policies and reasoners, which may be a user's own code: exceptions are wrapped, calls can be watched."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Protocol

import numpy as np

from cognitivedrone.errors import CognitiveDroneError, PolicyRaised
from cognitivedrone.interfaces import PlugIn
from cognitivedrone.registry import one_line
from cognitivedrone.types import EpisodeContext


class Watch(Protocol):
    """Notified when a call begins and ends, so that a hanging call can be detected."""

    def begin(self) -> None:
        """A call begins."""
        ...

    def end(self) -> None:
        """The call has returned or raised."""
        ...


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

    The package's own errors pass. Anything else, `SystemExit` included, becomes a `PolicyRaised` with its traceback.
    """
    watch.begin()
    try:
        yield
    except CognitiveDroneError:
        raise
    except (Exception, SystemExit) as error:
        raise PolicyRaised(f"{what} raised {one_line(error)}", traceback.format_exc()) from error
    finally:
        watch.end()


def begin_stage(part: PlugIn, context: EpisodeContext) -> None:
    """Reset a policy or reasoner for a stage, with the ground truth only if it declares that it needs it."""
    part.reset(context if part.needs_ground_truth else replace(context, ground_truth=None))


def seed_of(part: PlugIn | None, rng: np.random.Generator) -> int:
    """The episode's seed for a policy or reasoner, drawn from the episode's generator only if it needs one; else 0."""
    return int(rng.integers(2**31)) if part is not None and part.needs_seed else 0
