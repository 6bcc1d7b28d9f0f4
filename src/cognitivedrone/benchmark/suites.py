"""Which tasks a run flies."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from cognitivedrone.benchmark.run_types import RunConfig
from cognitivedrone.tasks import Suite, load_suite, suite_from_files
from cognitivedrone.tasks.suites import TRAIN_NAME
from cognitivedrone.types import Track

TRACK_LENGTH = 5
"""Stages of a track that --track makes."""


def open_suite(name: str, *, size: int | None = None, seed: int = 0) -> Suite:
    """A suite by its name, or the tasks of a file or folder.

    `size` and `seed` are for suites that are generated. Raises `TaskError` for unknown names and malformed files.
    """
    path = Path(name)
    return suite_from_files(path) if path.exists() else load_suite(name, size=size, seed=seed)


def suite_of(config: RunConfig) -> Suite:
    """The tasks that a run flies, chained into tracks where it asks for that."""
    if config.tasks is not None:
        suite = suite_from_files(config.tasks)
    elif config.suite == TRAIN_NAME:
        suite = load_suite(config.suite, size=config.episodes, seed=config.seed)
    else:
        # Not `size=config.episodes`: the first episodes of a suite are the same flights, however many follow.
        suite = load_suite(config.suite)
    return chain(suite) if config.track else suite


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
