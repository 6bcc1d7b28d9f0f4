"""Calls into policies and reasoners, which anybody may have written: every fault is named, every call can be timed."""

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
    """Is told when a call begins and ends, so that somebody else can see one that hangs."""

    def begin(self) -> None:
        """A call begins."""
        ...

    def end(self) -> None:
        """It has returned or raised."""
        ...


class NoWatch:
    """Nobody looks."""

    def begin(self) -> None:
        """Nothing."""

    def end(self) -> None:
        """Nothing."""


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
    """Reset a policy or reasoner for a stage; the ground truth goes to none that does not declare that it needs it."""
    part.reset(context if part.needs_ground_truth else replace(context, ground_truth=None))


def seed_of(part: PlugIn | None, rng: np.random.Generator) -> int:
    """The seed of a part's episode, drawn from the episode's generator only where the part draws random numbers."""
    return int(rng.integers(2**31)) if part is not None and part.needs_seed else 0
