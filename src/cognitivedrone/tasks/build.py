"""Generates the fixed suites: `python -m cognitivedrone.tasks.build [FOLDER]` writes the same files every time.

Suites written by hand (`AUTHORED`) or made from a label pack (`PICTURED`) are not among them; `suite_text` gives their
files the same form.

Positions of the right answer and looks of the gates are dealt from shuffled cycles, not drawn independently: over a
suite, and over every family in it, positions, colours, shapes and sizes are as equally frequent as possible.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from cognitivedrone.files import replace_file
from cognitivedrone.layout import draw_layout, draw_swaying
from cognitivedrone.tasks.families import BASE_FAMILIES, FAMILIES, generator
from cognitivedrone.tasks.families.absent import KINDS, LOOKS, absent_puzzle
from cognitivedrone.tasks.families.clutter import KINDS as OBSTACLES
from cognitivedrone.tasks.families.clutter import MOVERS, cluttered, crossed, several
from cognitivedrone.tasks.families.memory import memory_track
from cognitivedrone.tasks.families.mission_tasks import mission_tracks
from cognitivedrone.tasks.families.racing import INSTRUCTIONS, single_gate
from cognitivedrone.tasks.format import task_to_json
from cognitivedrone.tasks.generate import HELD_OUT, TRAIN, Draw, Pools, Puzzle
from cognitivedrone.tasks.suites import BUILT, digest_of, file_of, finish
from cognitivedrone.types import CATEGORIES, COLORS, SHAPES, SIZES, Gate, Task, Track

T = TypeVar("T")

HARD_SHARES: dict[str, int] = {
    "conjunction": 25,
    "exclusion": 25,
    "relations": 13,
    "negation": 13,
    "counting": 12,
    "distraction": 12,
    "comparison": 15,
    "two_step": 15,
    "memory": 20,
}
"""Tasks of each family in `hard`, 50 per category."""
MEMORY_TRACKS: tuple[int, ...] = (3, 4, 4, 4, 5)
"""Numbers of stages of the memory tracks."""
STAGES_A_TRACK = 5
HARD_IN_PLACES: dict[str, int] = dict.fromkeys(
    ("conjunction", "exclusion", "comparison", "two_step"), 10
) | dict.fromkeys(("relations", "negation", "counting", "distraction"), 5)
"""Tasks of the harder families in `places`, 20 per category; every third task of the suite has another layout."""
_SIZES = {
    "test": 300, "unseen": 150, "smoke": 30, "track": 100, "layouts": 300, "clutter": 200, "moving": 120, "gates": 90,
    "swaying": 120,
}  # fmt: skip
LOOKS_ASKED = 20
"""Tasks of `absent` that name a gate by its looks; the other 180 are of the ten base families in equal numbers."""
RACES = 20
"""Tracks of `race`, each of `STAGES_A_TRACK` stages."""


def equal_shares(total: int) -> dict[str, int]:
    """Tasks for each base family: equal shares per category, and within it per family, to within one."""
    shares: dict[str, int] = {}
    for category, of_category in zip(CATEGORIES, _split(total, len(CATEGORIES)), strict=True):
        families = [family for family in BASE_FAMILIES if FAMILIES[family] == category]
        shares |= dict(zip(families, _split(of_category, len(families)), strict=True))
    return shares


def _split(total: int, parts: int) -> list[int]:
    return [total // parts + (i < total % parts) for i in range(parts)]


class Dealer:
    """Deals targets and gates so that all values occur equally often: repeated cycles, cut into shuffled hands."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._dealt: dict[str, int] = {}

    def hand(self, name: str, values: Sequence[T], count: int) -> list[T]:
        """The next `count` values of an endless, shuffled cycle."""
        start = self._dealt.get(name, 0)
        self._dealt[name] = start + count
        cards = [values[i % len(values)] for i in range(start, start + count)]
        return [cards[i] for i in self._rng.permutation(count)]

    def stages(self, count: int) -> list[tuple[int, tuple[Gate, Gate, Gate]]]:
        """Target and gates of `count` tasks."""
        targets = self.hand("target", (0, 1, 2), count)
        colors = self.hand("color", COLORS, count)
        right = list(zip(self.hand("size", SIZES, count), self.hand("shape", SHAPES, count), strict=True))
        sizes = self.hand("other size", SIZES, 2 * count)
        # The other gates use the shapes in reverse order, so that the remainders of both cycles complement each other.
        shapes = self.hand("other shape", SHAPES[::-1], 2 * count)
        dealt = []
        for i, (target, color) in enumerate(zip(targets, colors, strict=True)):
            rest = [COLORS[k] for k in self._rng.permutation(len(COLORS)) if COLORS[k] != color]
            gates = [Gate(sizes[2 * i + k], shapes[2 * i + k], rest[k]) for k in range(2)]
            gates.insert(target, Gate(*right[i], color))
            dealt.append((target, (gates[0], gates[1], gates[2])))
        return dealt


def build_suite(name: str) -> list[Track]:
    """The tracks of a suite of `BUILT`."""
    rng = np.random.default_rng([2, BUILT.index(name)])
    dealer = Dealer(rng)
    bare = name.partition(":")[2]
    special = {"race": _races, "absent": _absent, "missions": _missions}.get(bare)
    tracks = special(rng, dealer) if special else _choices(bare, rng, dealer)
    ids = iter(range(sum(map(len, tracks))))
    return [tuple(replace(task, id=f"{name}/{next(ids):04d}") for task in track) for track in tracks]


def _choices(name: str, rng: np.random.Generator, dealer: Dealer) -> list[list[Task]]:
    """The tracks of a suite of single choices."""
    pools = HELD_OUT if name == "unseen" else TRAIN
    if name == "hard":
        shares = {family: count for family, count in HARD_SHARES.items() if family != "memory"}
    elif name == "places":
        shares = equal_shares(200 - sum(HARD_IN_PLACES.values())) | HARD_IN_PLACES
    else:
        shares = equal_shares(_SIZES[name])
    tasks = [task for family, count in shares.items() for task in _family(rng, dealer, pools, family, count)]
    if name == "places":
        tasks = [_laid_out(rng, task) if number % 3 == 0 else task for number, task in enumerate(tasks)]
    if name == "layouts":
        tasks = [_laid_out(rng, task) for task in tasks]
    if name == "clutter":
        kinds, counts = dealer.hand("obstacle", OBSTACLES, len(tasks)), dealer.hand("count", range(2, 9), len(tasks))
        tasks = [cluttered(rng, *each) for each in zip(tasks, kinds, counts, strict=True)]
    if name == "moving":
        kinds, counts = dealer.hand("obstacle", MOVERS, len(tasks)), dealer.hand("count", range(1, 6), len(tasks))
        tasks = [crossed(rng, *each) for each in zip(tasks, kinds, counts, strict=True)]
    if name == "gates":
        counts = dealer.hand("count", range(2, 7), len(tasks))
        tasks = [several(rng, *each) for each in zip(tasks, counts, strict=True)]
    if name == "swaying":
        tasks = [replace(task, layout=draw_swaying(rng, task.gates, board=task.board is not None)) for task in tasks]
    if name == "track":
        n_tracks = len(tasks) // STAGES_A_TRACK
        tracks = [_shuffled(rng, tasks[i::n_tracks]) for i in range(n_tracks)]
    else:
        tracks = [[task] for task in _shuffled(rng, tasks)]
    if name == "hard":
        tracks += _memory(rng, dealer)
    return tracks


def _absent(rng: np.random.Generator, dealer: Dealer) -> list[list[Task]]:
    """Tasks where no gate matches the instruction, no two with the same question and the same options."""
    asked: set[tuple[str, frozenset[str]]] = set()
    tasks = []
    for kind in KINDS:
        for _, gates in dealer.stages(LOOKS_ASKED if kind == LOOKS else 18):
            while (question := _question(puzzle := absent_puzzle(Draw(rng, TRAIN, 0), kind, gates))) in asked:
                pass
            asked.add(question)
            tasks.append(finish(puzzle, task_id="?", family="absent", target=0, gates=gates))
    return [[task] for task in _shuffled(rng, tasks)]


def _missions(rng: np.random.Generator, _: Dealer) -> list[list[Task]]:
    return list(mission_tracks(rng))


def _laid_out(rng: np.random.Generator, task: Task) -> Task:
    return replace(task, layout=draw_layout(rng, task.gates, board=task.board is not None))


def _races(_: np.random.Generator, dealer: Dealer) -> list[list[Task]]:
    """Tracks of single gates, with one instruction per track."""
    dealt = iter(dealer.stages(RACES * STAGES_A_TRACK))
    return [
        [
            finish(single_gate(instruction), task_id="?", family="race", target=target, gates=gates)
            for target, gates in itertools.islice(dealt, STAGES_A_TRACK)
        ]
        for instruction in dealer.hand("instruction", INSTRUCTIONS, RACES)
    ]


def _family(rng: np.random.Generator, dealer: Dealer, pools: Pools, family: str, count: int) -> list[Task]:
    """Tasks of one family, no two with the same question and the same options."""
    asked: set[tuple[str, frozenset[str]]] = set()
    tasks = []
    for target, gates in dealer.stages(count):
        while True:
            puzzle = generator(family)(Draw(rng, pools, target))
            question = _question(puzzle)
            if question not in asked:
                break
        asked.add(question)
        tasks.append(finish(puzzle, task_id="?", family=family, target=target, gates=gates))
    return tasks


def _question(puzzle: Puzzle) -> tuple[str, frozenset[str]]:
    board = "" if puzzle.board is None else puzzle.board.partition("@")[0]
    return f"{puzzle.instruction} {board}", frozenset(panel.option for panel in puzzle.panels)


def _memory(rng: np.random.Generator, dealer: Dealer) -> list[list[Task]]:
    dealt = iter(dealer.stages(sum(MEMORY_TRACKS)))
    tracks = []
    for length in MEMORY_TRACKS:
        stages = [next(dealt) for _ in range(length)]
        puzzles = memory_track(Draw(rng, TRAIN, 0), [target for target, _ in stages])
        tracks.append(
            [
                finish(puzzle, task_id="?", family="memory", target=target, gates=gates)
                for puzzle, (target, gates) in zip(puzzles, stages, strict=True)
            ]
        )
    return tracks


def _shuffled(rng: np.random.Generator, items: list[T]) -> list[T]:
    return [items[i] for i in rng.permutation(len(items))]


def suite_text(name: str, tracks: Iterable[Track]) -> str:
    """The file of a fixed suite: its digest, and one task per line."""
    content = [[task_to_json(task) for task in track] for track in tracks]
    lines = ",\n".join("[" + ",\n".join(json.dumps(task, separators=(",", ":")) for task in t) + "]" for t in content)
    return f'{{"name":"{name}","digest":"{digest_of(content)}","tracks":[\n{lines}\n]}}\n'


def main(folder: Path) -> None:
    """Write every suite of `BUILT` into a folder."""
    for name in BUILT:
        path = folder / file_of(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, suite_text(name, build_suite(name)).encode())
        sys.stdout.write(f"{path}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "suites")
