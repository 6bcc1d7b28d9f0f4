"""Questions that no reasoner answered, because its server could not be reached or refused: no part of a score."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from cognitivedrone.types import EpisodeResult

TRANSPORT: Final = frozenset({"unreachable", "http"})
"""Kinds of `ReasonerError` that say nothing of the reasoner."""
MOST: Final = 0.05
"""Share of the questions above which a run measures the server."""


def unanswered(episode: EpisodeResult) -> bool:
    """Whether a question of a flight got no answer from the server: such a flight is not counted."""
    return any(stage.reasoner is not None and TRANSPORT & stage.reasoner.faults.keys() for stage in episode.stages)


def not_measured(faults: Mapping[str, int], asked: int) -> str:
    """Why a run is no measurement of its reasoner; empty if it is one."""
    lost = sum(faults.get(kind, 0) for kind in TRANSPORT)
    if not asked or lost <= MOST * asked:
        return ""
    return (
        f"this is not a measurement: {lost} of {asked} questions to the reasoner got no answer from its server; see to"
        " the server, or let it ask for longer waits with retry=SECONDS"
    )
