"""Suites of pictures that training never shows: its sentences and things, in drawing styles that are held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cognitivedrone.errors import LabelError, TaskError
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.tasks.build import Dealer
from cognitivedrone.tasks.families import generator
from cognitivedrone.tasks.format import task_to_json
from cognitivedrone.tasks.generate import TRAIN, Draw, Puzzle
from cognitivedrone.tasks.suites import Suite, digest_of, finish
from cognitivedrone.tasks.vocabulary import TRAIN_STYLES
from cognitivedrone.types import Task

PICTURES = "open-v2:pictures"
STYLES: tuple[str, ...] = ("openmoji", "fxemoji", "icon-park", "openclipart")
"""Its sets: those of `vocabulary.HELD_OUT_PICTURE_SETS` that show animals, foods and objects."""
PICTURE_FAMILIES: tuple[str, ...] = ("animals", "food", "association")
"""Families whose panels are drawings. Letters, numbers, logos and people have no drawing style."""
_TRIES = 10_000


def pictures_suite(
    pack: LabelPack,
    styles: Sequence[str],
    *,
    name: str = PICTURES,
    size: int = 300,
    seed: int = 0,
    families: Sequence[str] = PICTURE_FAMILIES,
) -> Suite:
    """A suite of `size` single tasks, in equal numbers of each family, whose drawings are all in `styles`.

    Every picture is in `pack`; a style need not show every thing. The styles occur equally often, to within one task of
    a family. A pure function of its arguments.
    Raises `TaskError` if a style is one of training, or the pack has too few of the things.
    """
    if trained := sorted(set(styles) & set(TRAIN_STYLES)):
        raise TaskError(f"{name}: the style {trained[0]!r} is shown in training; give styles that are held out")
    if not styles:
        raise TaskError(f"{name}: no style is given; name at least one that is held out")
    rng = np.random.default_rng([5, seed])
    dealer = Dealer(rng)
    tasks: list[Task] = []
    for number, family in enumerate(families):
        count = size // len(families) + (number < size % len(families))
        asked: set[tuple[str, frozenset[str]]] = set()
        dealt = zip(dealer.stages(count), dealer.hand(f"style of {family}", styles, count), strict=True)
        for (target, gates), style in dealt:
            puzzle = _puzzle(pack, Draw(rng, replace(TRAIN, styles=(style,)), target), family, asked)
            tasks.append(finish(puzzle, task_id="?", family=family, target=target, gates=gates))
    order = rng.permutation(len(tasks))
    tracks = tuple((replace(tasks[which], id=f"{name}/{index:04d}"),) for index, which in enumerate(order))
    return Suite(name, digest_of([task_to_json(task) for task in track] for track in tracks), tracks)


def _puzzle(pack: LabelPack, draw: Draw, family: str, asked: set[tuple[str, frozenset[str]]]) -> Puzzle:
    """A new puzzle of drawings that the pack has; adds it to `asked`."""
    style = draw.pools.styles[0]
    for _ in range(_TRIES):
        puzzle = generator(family)(draw)
        question = puzzle.instruction, frozenset(panel.option for panel in puzzle.panels)
        labels = [panel.label for panel in puzzle.panels]
        # An association may be about numbers or letters, which are not drawings.
        drawn = all(label.endswith(f"@{style}") for label in labels)
        if drawn and question not in asked and all(_has(pack, label) for label in labels):
            asked.add(question)
            return puzzle
    raise TaskError(f"the label pack has too few pictures of style {style!r} for tasks of the family {family!r}")


def _has(pack: LabelPack, label: str) -> bool:
    try:
        pack.image(label)
    except LabelError:
        return False
    return True
