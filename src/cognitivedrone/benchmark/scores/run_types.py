"""The values of a benchmark run: rollouts, traces, and the runner's interface.

And what a suite says of the flights through it, by which records and submissions of other flights are recognised; and
questions that no reasoner answered, because its server could not be reached or refused: no part of a score.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.film.frame import FilmFrame
from cognitivedrone.types import EpisodeResult, Outcome, Stage, Task
from cognitivedrone.vehicles.contract import LinkReport


@dataclass(frozen=True, slots=True)
class Trace:
    """The path of one flight, for the report."""

    path: NDArray[np.float32]
    """(n, 3) world, m, at 10 Hz."""
    stages: tuple[Stage, ...]
    """The stages that were flown, as placed in the world."""
    stage_start: tuple[int, ...]
    """Index into `path` where each of `stages` begins."""
    decision_s: float
    """Mean wall time of a policy's decision, s; the only field that differs between two equal runs."""


@dataclass(frozen=True, slots=True)
class Rollout:
    """One flown episode."""

    result: EpisodeResult
    trace: Trace
    film: list[FilmFrame] | None = None
    """Every control step, if a film was requested."""
    link: LinkReport | None = None
    """Link statistics of the episode, if an autopilot in another process flew."""
    error: str = ""
    """Traceback of the policy's or the reasoner's first exception; empty if there was none."""


class EpisodeRunner(Protocol):
    """Flies single episodes of a suite; every worker process keeps one."""

    @property
    def renderer(self) -> str:
        """Name of the renderer, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""

    def fly(self, episode: int, *, film: bool) -> Rollout:
        """Fly the suite's track number `episode`; repeatable, in any order, in any process."""

    def close(self) -> None:
        """Free the simulator."""


_GOES_ON: Final = ("passed", "wrong_gate")
"""Outcomes after which a track goes on."""


def impossible(track: Sequence[Task], ends: Sequence[tuple[Outcome, int | None]]) -> str | None:
    """Why a flight through a track cannot have ended so, in one clause; None if it can.

    `ends` are outcome and chosen gate, 0 to 2, of every stage.
    """
    if len(ends) != len(track):
        return f"it has {len(ends)} stages, and its track {len(track)}"
    over = False
    for task, (outcome, chosen) in zip(track, ends, strict=True):
        if over != (outcome == "not_reached") or not _fits(outcome, chosen, task.target):
            return f"{task.id} cannot have ended as {outcome} with the gate {chosen}"
        over = outcome not in _GOES_ON
    return None


def _fits(outcome: Outcome, chosen: int | None, target: int | None) -> bool:
    """Whether a stage with this right gate can have ended so."""
    if chosen is not None and not 0 <= chosen <= 2:
        return False
    match outcome:
        case "passed":
            return chosen == target
        case "wrong_gate":
            return chosen not in (None, target)
        case "hesitated":
            return target is None
        case "false_alarm":
            return target is not None
        case "invalid" | "policy_error" | "not_reached":
            return chosen is None
        case _:
            return True


TRANSPORT: Final = frozenset({"unreachable", "http"})
"""Kinds of `ReasonerError` that say nothing of the reasoner."""
MOST_UNANSWERED: Final = 0.05
"""Share of the questions above which a run measures the server."""


def unanswered(episode: EpisodeResult) -> bool:
    """Whether a question of a flight got no answer from the server: such a flight is not counted."""
    return any(stage.reasoner is not None and TRANSPORT & stage.reasoner.faults.keys() for stage in episode.stages)


def not_measured(faults: Mapping[str, int], asked: int) -> str:
    """Why a run is no measurement of its reasoner; empty if it is one."""
    lost = sum(faults.get(kind, 0) for kind in TRANSPORT)
    if not asked or lost <= MOST_UNANSWERED * asked:
        return ""
    return (
        f"this is not a measurement: {lost} of {asked} questions to the reasoner got no answer from its server; see to"
        " the server, or let it ask for longer waits with retry=SECONDS"
    )
