"""From the tasks that a plan names to the suite that is flown."""

from __future__ import annotations

import dataclasses

from cognitivedrone.plan import Scenario
from cognitivedrone.tasks.suites import DEFAULT_TRAIN_SIZE, TRAIN_NAME, Suite, open_suite
from cognitivedrone.types import Track

TRACK_LENGTH = 5
"""Stages of a track that --track makes."""


def suite_of(scenario: Scenario, episodes: int | None = None) -> Suite:
    """The tasks of a scenario, chained into tracks where it asks for that; at least `episodes` of an endless suite.

    Raises `TaskError` for unknown names and malformed files.
    """
    # Of a fixed suite no size is asked for: its first episodes are the same flights, however many follow.
    size = episodes or DEFAULT_TRAIN_SIZE if scenario.suite == TRAIN_NAME else None
    suite = open_suite(scenario.suite, scenario.tasks, size=size, seed=scenario.seed)
    return chain(suite) if scenario.track else suite


def how_many(scenario: Scenario, episodes: int | None) -> str:
    """A notice of how much of an endless suite is flown; empty for other suites."""
    if scenario.tasks is not None or scenario.suite != TRAIN_NAME:
        return ""
    return (
        f"{TRAIN_NAME} has no end; its first {episodes or DEFAULT_TRAIN_SIZE} tasks of seed {scenario.seed} are flown,"
        " --episodes N for others"
    )


def chain(suite: Suite, length: int = TRACK_LENGTH) -> Suite:
    """The suite with its single tasks chained, in order, into tracks of `length` (the last may be shorter).

    Tasks that are in tracks already stay there. The digest is that of the tasks, and stays.
    """
    tracks: list[Track] = []
    loose: Track = ()
    for track in suite.tracks:
        if len(track) > 1:
            tracks.append(track)
            continue
        loose += track
        if len(loose) == length:
            tracks.append(loose)
            loose = ()
    return dataclasses.replace(suite, tracks=(*tracks, loose) if loose else tuple(tracks))
