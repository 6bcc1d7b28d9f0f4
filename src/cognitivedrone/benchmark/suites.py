"""Which tasks a run flies."""

from __future__ import annotations

import dataclasses

from cognitivedrone.benchmark.config import RunConfig
from cognitivedrone.tasks import Suite, open_suite
from cognitivedrone.tasks.suites import DEFAULT_TRAIN_SIZE, TRAIN_NAME
from cognitivedrone.types import Track

TRACK_LENGTH = 5
"""Stages of a track that --track makes."""


def suite_of(config: RunConfig) -> Suite:
    """The tasks that a run flies, chained into tracks where it asks for that."""
    # Of a fixed suite no size is asked for: its first episodes are the same flights, however many follow.
    size = config.episodes or DEFAULT_TRAIN_SIZE if config.suite == TRAIN_NAME else None
    suite = open_suite(config.suite, config.tasks, size=size, seed=config.seed)
    return chain(suite) if config.track else suite


def how_many(config: RunConfig) -> str:
    """What to say of a suite without an end: how much of it a run flies; nothing of others."""
    if config.tasks is not None or config.suite != TRAIN_NAME:
        return ""
    count = config.episodes or DEFAULT_TRAIN_SIZE
    return f"{TRAIN_NAME} has no end; its first {count} tasks of seed {config.seed} are flown, --episodes N for others"


def chain(suite: Suite, length: int = TRACK_LENGTH) -> Suite:
    """The suite with its single tasks chained, in order, into tracks of `length` (the last may be shorter).

    Tasks that already stand in tracks stay there. The digest is that of the tasks, and stays.
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
