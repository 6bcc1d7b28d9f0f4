"""Scores of missions: whole flights of one sentence. Pure arithmetic."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from cognitivedrone.types import EpisodeResult, StageResult


@dataclass(frozen=True, slots=True)
class MissionScore:
    """Flights of missions, without those in which the physics diverged."""

    n: int
    whole: int
    """Missions of which every sub-goal was done, in order."""
    sub_goals: int
    done: int
    spl: float
    """Success weighted by path length: the mean of the straight lines from gate to gate over the path, and of 0 for
    missions that are not whole (Anderson et al., arXiv 1807.06757)."""
    collisions: int
    per_100_m: float | None
    """Collisions in 100 m of path."""
    smallest_m: float | None
    """Smallest distance between the hull and the frame of a gate flown through, or an obstacle."""
    forbidden_s: float
    """Time in forbidden zones, s: the sum of `StageResult.forbidden_s`."""
    forbidden: int
    """Missions with such a time."""


def missions_of(episodes: Sequence[EpisodeResult], done: Callable[[StageResult], bool]) -> MissionScore | None:
    """The score of the missions among the flights; none if there are none. `done` says whether a sub-goal was done."""
    flights = [
        episode.stages
        for episode in episodes
        if episode.stages[0].forbidden_s is not None and all(stage.outcome != "invalid" for stage in episode.stages)
    ]
    if not flights:
        return None
    stages = [stage for flight in flights for stage in flight]
    metres = sum(stage.path_m for stage in stages)
    collisions = sum(stage.outcome == "collision" for stage in stages)
    rooms = [room for stage in stages for room in (stage.clearance_m, stage.obstacle_m) if room is not None]
    times = [sum(stage.forbidden_s or 0.0 for stage in flight) for flight in flights]
    whole = [all(map(done, flight)) for flight in flights]
    return MissionScore(
        n=len(flights),
        whole=sum(whole),
        sub_goals=len(stages),
        done=sum(map(done, stages)),
        spl=statistics.fmean(_efficiency(flight) if each else 0.0 for flight, each in zip(flights, whole, strict=True)),
        collisions=collisions,
        per_100_m=100 * collisions / metres if metres else None,
        smallest_m=min(rooms, default=None),
        forbidden_s=round(sum(times), 6),
        forbidden=sum(time > 0 for time in times),
    )


def _efficiency(flight: Sequence[StageResult]) -> float:
    """The straight lines over the path, at most 1; a stage without a gate flown through counts with its path."""
    path = sum(stage.path_m for stage in flight)
    straight = sum(stage.path_m / max(stage.path_ratio or 1.0, 1.0) for stage in flight)
    return straight / path if path else 1.0
