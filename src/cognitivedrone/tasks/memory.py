"""Tracks on which a later instruction speaks of an earlier gate: no single frame can answer it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.generate import Draw, Puzzle, words
from cognitivedrone.tasks.hard import PLAIN_THINGS

_ORDINALS = ("first", "second", "third", "fourth", "fifth")


def memory_track(draw: Draw, targets: Sequence[int]) -> list[Puzzle]:
    """Puzzles of one track, a target each: the first names a thing, the others refer to gates already flown through.

    Wrong panels come from what earlier stages have shown wherever possible, so to recognise is not enough: one must
    know which gate was flown through, and when.
    """
    fresh = draw.sample(PLAIN_THINGS, len(PLAIN_THINGS))
    right = [fresh.pop()]
    shown = [right[0], fresh.pop(), fresh.pop()]
    puzzles = [_puzzle(draw, targets[0], f"Fly through the gate with the {words(right[0])}", shown)]
    for stage in range(1, len(targets)):
        if stage >= 2 and draw.chance(0.25):
            answer = fresh.pop()
            sentence = "Fly through the gate with the thing that no gate has shown before"
            options = [answer, *draw.sample(shown, 2)]
        else:
            back = draw.below(stage)
            answer = right[back]
            sentence = draw.pick(
                (
                    f"Fly through the gate with the same thing as the {_ORDINALS[back]} gate you flew through",
                    f"Fly to what you flew to at stage {back + 1} of this track",
                )
            )
            if back == stage - 1 and draw.chance(0.5):
                sentence = "Fly through the gate with the same thing as the gate you have just flown through"
            options = [answer, *draw.sample([name for name in shown if name != answer], 2)]
        puzzles.append(_puzzle(draw, targets[stage], sentence, options))
        right.append(answer)
        shown += [name for name in options if name not in shown]
    return puzzles


def _puzzle(draw: Draw, target: int, instruction: str, names: Sequence[str]) -> Puzzle:
    panels = [draw.drawing(KIND_OF[name], name) for name in names]
    return replace(draw, target=target).puzzle(instruction, panels[0], panels[1:])
