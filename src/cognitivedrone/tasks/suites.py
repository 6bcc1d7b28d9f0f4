"""Suites: named, hashed lists of tracks. `open-v1:train` is generated on demand, the others are committed files.

From the tasks that a plan names to the suite that is flown.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, overload

import numpy as np

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.plan import Scenario
from cognitivedrone.tasks.directives import HOLD, write_directive
from cognitivedrone.tasks.families import BASE_FAMILIES, FAMILIES, HARD_FAMILIES, generator
from cognitivedrone.tasks.format import read_tasks, task_from_json, task_to_json
from cognitivedrone.tasks.generate import TRAIN, Draw, Generator, Pools, Puzzle, Scene
from cognitivedrone.tasks.published import task_files
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.text.printable import unprintable
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate, Task, Track

VERSION = "open-v1"
TRAIN_NAME = f"{VERSION}:train"
BUILT: tuple[str, ...] = (
    *(f"{VERSION}:{name}" for name in ("test", "unseen", "smoke", "track", "hard", "race")),
    *(f"open-v2:{name}" for name in ("test", "layouts", "absent")),
    "open-v3:missions",
    "open-v3:clutter",
    "open-v3:places",
    "open-v3:moving",
    "open-v3:gates",
    "open-v3:swaying",
)
"""Fixed suites that `tasks.build` generates. A suite's position here seeds it: add new ones at the end."""
AUTHORED: tuple[str, ...] = ("open-v2:words", "open-v3:words", "open-v3:photos", "open-v3:wild")
"""Fixed suites written by hand: their files are the source."""
PICTURED: tuple[str, ...] = ("open-v2:pictures",)
"""Fixed suites made from what a label pack draws (`tasks.families.pictures`)."""
FIXED: tuple[str, ...] = BUILT + AUTHORED + PICTURED
SUITES: tuple[str, ...] = (TRAIN_NAME, *FIXED)
TEST_ONLY: frozenset[str] = frozenset(name for name in FIXED if not name.startswith(f"{VERSION}:"))
"""Suites that no training data may be collected from."""
CONDITIONS: Mapping[str, Mapping[str, str | float]] = {
    "open-v3:wild": {"appearance": "varied", "wind": 2.0},
    "open-v3:places": {"appearance": "photo", "place": "kept"},
}
"""Options of `plan.Scenario` that belong to a suite's definition: it is scored with no others."""
DEFAULT_TRAIN_SIZE = 300
UNLIMITED = 10**9
"""A size beyond any suite file or training run: requests all available tasks."""

ABOUT: dict[str, str] = {
    TRAIN_NAME: "practice: generated from a seed, without end",
    "open-v1:test": "practised: ingredients of train, drawn once",
    "open-v1:unseen": "held out: drawing style, fonts, faces, wordings, operands",
    "open-v1:smoke": "practised: a quick check",
    "open-v1:track": "practised: tracks of 5 stages",
    "open-v1:hard": "practised: families that training draws anew; most sentences recur",
    "open-v1:race": "practised: tracks of single gates",
    "open-v2:test": "practised ingredients, drawn anew",
    "open-v2:layouts": "held out: the gate layouts; the rest as test",
    "open-v2:absent": "held out: no gate matches the instruction",
    "open-v2:words": "held out: sentences as people type them",
    "open-v2:pictures": "held out: whole sets of drawings, each by other artists",
    "open-v3:words": "held out: long, indirect and misspelt sentences",
    "open-v3:photos": "held out: photographs on the panels",
    "open-v3:missions": "missions: one sentence for up to 4 stages and a landing; 50 of 150 typed, held out",
    "open-v3:clutter": "obstacles in the way, empty frames, landmarks; the rest as test and layouts",
    "open-v3:moving": "gates in two rows; something moves across the way; the rest as test",
    "open-v3:gates": "2 to 6 gates: two or three with panels, and empty frames; the rest as test",
    "open-v3:swaying": "gates that move to and fro; the rest as test and layouts",
    "open-v3:places": "held out: photographed places around the stage; the rest as test, hard and layouts",
    "open-v3:wild": "held out: pictures in bad light, sentences and layouts; varied room, wind",
}
"""What each suite tests: what is held out from training, or that its tasks are practised."""

_GATE_LOOKS = tuple((size, shape) for size in SIZES for shape in SHAPES)
_COLOR_ORDERS = tuple((a, b, c) for a in COLORS for b in COLORS for c in COLORS if len({a, b, c}) == 3)


@dataclass(frozen=True, slots=True)
class Suite:
    """Tracks in flight order."""

    name: str
    digest: str
    """SHA-256 of the content as canonical JSON, hexadecimal."""
    tracks: Sequence[Track]

    @property
    def n_tasks(self) -> int:
        """Number of tasks in all tracks."""
        if isinstance(self.tracks, TrainTracks):
            return len(self.tracks)
        return sum(len(track) for track in self.tracks)


def digest_of(tracks: Iterable[Iterable[dict[str, Any]]]) -> str:
    """SHA-256 of tracks of JSON tasks, independent of white space and key order."""
    content = [list(track) for track in tracks]
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(canonical.encode("ascii")).hexdigest()


def finish(puzzle: Puzzle, *, task_id: str, family: str, target: int, gates: tuple[Gate, Gate, Gate]) -> Task:
    """The complete task of a puzzle and its gates, with its directive."""
    a, b, c = puzzle.panels
    return Task(
        id=task_id,
        category=FAMILIES[family],
        family=family,
        instruction=puzzle.instruction,
        directive=HOLD if puzzle.absent else write_directive(gates[target]),
        options=(a.option, b.option, c.option),
        labels=(a.label, b.label, c.label),
        target=None if puzzle.absent else target,
        gates=gates,
        board=puzzle.board,
        only=target if puzzle.alone else None,
    )


def train_task(index: int, seed: int = 0) -> Task:
    """Task `index` of the training suite of a seed: families in rotation, all randomness from (seed, index)."""
    if index < 0 or seed < 0:
        raise TaskError(f"{TRAIN_NAME}: index {index} and seed {seed} must not be negative")
    family = BASE_FAMILIES[index % len(BASE_FAMILIES)]
    return drawn_task(family, np.random.default_rng([1, seed, index]), f"{TRAIN_NAME}/{seed}-{index}")


def drawn_task(
    family: str, rng: np.random.Generator, task_id: str, pools: Pools = TRAIN, make: Generator | None = None
) -> Task:
    """A random task of a family, from training or other ingredients.

    `make` replaces the family's own generator.
    """
    draw = Draw(rng, pools, target=int(rng.integers(3)))
    colors = draw.pick(_COLOR_ORDERS)
    looks = [draw.pick(_GATE_LOOKS) for _ in colors]
    a, b, c = (Gate(size, shape, color) for (size, shape), color in zip(looks, colors, strict=True))
    puzzle = (make or generator(family))(draw)
    first, second, third = (panel.label for panel in puzzle.panels)
    scene = Scene((first, second, third), (a, b, c), draw.target)
    puzzle = replace(puzzle, instruction=pools.completed(rng, puzzle.instruction, scene))
    return finish(puzzle, task_id=task_id, family=family, target=draw.target, gates=(a, b, c))


class TrainTracks(Sequence[Track]):
    """The first `size` training tasks of a seed as tracks of one stage, generated on access."""

    def __init__(self, size: int, seed: int) -> None:
        self._indices = range(size)
        self._seed = seed

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, index: int) -> Track: ...
    @overload
    def __getitem__(self, index: slice) -> list[Track]: ...
    def __getitem__(self, index: int | slice) -> Track | list[Track]:
        if isinstance(index, slice):
            return [(train_task(i, self._seed),) for i in self._indices[index]]
        return (train_task(self._indices[index], self._seed),)


def suite_of_tasks(name: str, tasks: Iterable[Task]) -> Suite:
    """A suite of single tasks, each a track of one stage."""
    return suite_of_tracks(name, [(task,) for task in tasks])


def suite_of_tracks(name: str, tracks: Sequence[Track]) -> Suite:
    """A suite of these tracks."""
    return Suite(name, digest_of([task_to_json(task) for task in track] for track in tracks), tuple(tracks))


def load_suite(name: str, *, size: int | None = None, seed: int = 0) -> Suite:
    """A suite by name, such as "open-v1:test".

    `open-v1:train` has `size` tasks (default 300), of which task i depends only on (seed, i); its digest covers
    name, seed, size and the first tasks. For a fixed suite, `size` keeps the first tracks and `seed` has no effect.
    A size of `UNLIMITED` requests all available tasks.
    Raises `TaskError` for an unknown name, a bad size, or a suite file whose content does not match its hash.
    """
    if name not in SUITES:
        raise _unknown(name)
    if size is not None and size < 1:
        raise TaskError(f"suite {name!r}: size {size} must be at least 1")
    if name == TRAIN_NAME:
        tracks = TrainTracks(DEFAULT_TRAIN_SIZE if size is None else size, seed)
        head = [task_to_json(task) for (task,) in tracks[: 2 * len(BASE_FAMILIES)]]
        return Suite(name, digest_of([[{"name": name, "seed": seed, "size": len(tracks)}], head]), tracks)
    suite = _fixed_suite(name)
    if size is None or size >= len(suite.tracks):
        return suite
    kept = suite.tracks[:size]
    return Suite(f"{name}[:{size}]", digest_of([task_to_json(t) for t in track] for track in kept), kept)


def open_suite(name: str, tasks: Path | None = None, *, size: int | None = None, seed: int = 0) -> Suite:
    """The suite of the options --suite and --tasks: the tasks of a file or folder, or a suite by name.

    `tasks` takes precedence over `name`, which may also be a file or folder; `size` and `seed` are those of
    `load_suite`. Raises `TaskError` for unknown names and malformed files.
    """
    if tasks is None and not name.strip():
        raise TaskError(f"the name of the suite is empty; {did_you_mean('open-v1', SUITES)}")
    path = Path(name) if tasks is None else tasks
    if tasks is not None or (name not in SUITES and path.exists()):
        return suite_from_files(path)
    return load_suite(name, size=size, seed=seed)


def track_at(suite: Suite, episode: int) -> Track:
    """The tasks of an episode, counted from 0; raises `TaskError` if there is no such episode."""
    if not 0 <= episode < len(suite.tracks):
        raise TaskError(f"suite {suite.name!r} has episodes 0 to {len(suite.tracks) - 1}, not {episode}")
    return suite.tracks[episode]


def _unknown(name: str) -> TaskError:
    """The error for an unknown suite name."""
    # Where versions share a bare name, the typed version is meant, or else the earliest.
    version = name.partition(":")[0]
    order = sorted(SUITES, key=lambda suite: suite.startswith(f"{version}:"), reverse=True)
    bare = {suite.partition(":")[2]: suite for suite in reversed(order)}
    near = difflib.get_close_matches(name.rpartition(":")[2].lower(), bare, n=1, cutoff=0.6)
    if name in FAMILIES:
        where = f"{VERSION}:{'hard' if name in HARD_FAMILIES else 'test'}"
        where = {"race": f"{VERSION}:race", "absent": "open-v2:absent"}.get(name, where)
        return TaskError(f"{name!r} is a family of tasks, not a suite; {where!r} holds such tasks")
    if near:
        return TaskError(f"unknown suite {name!r}; did you mean {bare[near[0]]!r}?")
    if "/" in name or name.endswith(".json"):
        return TaskError(f"there is no suite and no task file {name!r}; {did_you_mean(name, SUITES)}")
    return TaskError(f"unknown suite {name!r}; {did_you_mean(name, SUITES)}")


def file_of(name: str) -> str:
    """The file of a fixed suite below `suites/`: "open-v1/test.json" of "open-v1:test"."""
    version, _, bare = name.partition(":")
    return f"{version}/{bare}.json"


@functools.cache
def _fixed_suite(name: str) -> Suite:
    file_name = file_of(name)
    text = resources.files("cognitivedrone.tasks").joinpath("suites", file_name).read_text(encoding="utf-8")
    content = parse_json(text)
    digest = digest_of(content["tracks"])
    if digest != content["digest"]:
        raise TaskError(f"suite {name!r}: the content of suites/{file_name} does not match its hash; reinstall")
    tracks = tuple(
        tuple(task_from_json(obj, where=f"{name}[{index}]") for obj in track)
        for index, track in enumerate(content["tracks"])
    )
    return Suite(name, digest, tracks)


def suite_from_files(path: Path) -> Suite:
    """A user's own suite: a task file, or a folder of them, in the published layout.

    What a folder contributes, `published.task_files` says. Every task is a track of one stage, except that tasks of the
    same mission that follow one another are the stages of one, up to its landing. Raises `TaskError` with file, index
    and fix.
    """
    path = Path(path)
    if problem := unprintable(path.name):
        raise TaskError(f"{path}: the name holds {problem}; give the file or folder another name")
    tasks: dict[str, Task] = {}
    contents: dict[frozenset[Any], Path] = {}
    for file in task_files(path):
        read = read_tasks(file)
        content = frozenset((task.instruction, task.options, task.gates, task.target) for task in read)
        if len(read) > 1 and (same := contents.setdefault(content, file)) != file:
            raise TaskError(f"{same} and {file} hold the same tasks; remove one of them, or give one alone")
        for index, task in enumerate(read):
            if task.id in tasks:
                raise TaskError(f"{file}[{index}]: the id {task.id!r} is taken by an earlier task; give it another")
            tasks[task.id] = task
    tracks: list[Track] = []
    for task in tasks.values():
        before = tracks[-1][-1] if tracks else None
        if before is not None and task.mission is not None and task.mission == before.mission and not before.landing:
            tracks[-1] += (task,)
        else:
            tracks.append((task,))
    return suite_of_tracks(path.name or str(path), tracks)


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
