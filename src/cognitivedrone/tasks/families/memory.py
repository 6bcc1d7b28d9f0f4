"""Memory tracks: later instructions refer to earlier gates, so no single frame can answer them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.families.hard import PLAIN_THINGS
from cognitivedrone.tasks.generate import Draw, Puzzle, words

_NAMED = 2
"""Number of stages at the beginning of a track that name their thing."""
_ORDINALS = ("first", "second", "third", "fourth", "fifth")


def memory_track(draw: Draw, targets: Sequence[int]) -> list[Puzzle]:
    """Puzzles of one track, one per target: the first two name a thing, the others refer to gates flown through before.

    For the latter, wrong panels repeat panels of earlier stages wherever possible, so recognition is not enough: the
    policy must remember which gate it flew through, and when.
    """
    fresh = draw.sample(PLAIN_THINGS, len(PLAIN_THINGS))
    right: list[str] = []
    shown: list[str] = []
    puzzles: list[Puzzle] = []
    for stage, target in enumerate(targets):
        if stage < _NAMED:
            answer = fresh.pop()
            sentence = draw.say("memory named", "Fly through the gate with the {x}", x=words(answer))
            options = [answer, fresh.pop(), fresh.pop()]
        elif stage > _NAMED and draw.chance(0.4):
            answer = fresh.pop()
            sentence = draw.say("memory new", "Fly through the gate with the thing that no gate has shown before")
            options = [answer, *draw.sample(shown, 2)]
        else:
            answer = draw.pick(sorted(set(right)))
            back = draw.pick([earlier for earlier, name in enumerate(right) if name == answer])
            sentence = _recall(draw, back, stage)
            options = [answer, *draw.sample([name for name in shown if name != answer], 2)]
        panels = [draw.drawing(KIND_OF[name], name) for name in options]
        puzzles.append(replace(draw, target=target).puzzle(sentence, panels[0], panels[1:]))
        right.append(answer)
        shown += [name for name in options if name not in shown]
    return puzzles


def _recall(draw: Draw, back: int, stage: int) -> str:
    """Refers to the thing of stage `back` without naming it."""
    sentences = [
        ("memory nth", "Fly through the gate with the same thing as the {nth} gate you flew through"),
        ("memory stage", "Fly to what you flew to at stage {n} of this track"),
    ]
    if back == stage - 1:
        sentences.append(
            ("memory last", "Fly through the gate with the same thing as the gate you have just flown through")
        )
    name, sentence = draw.pick(sentences)
    return draw.say(name, sentence, nth=_ORDINALS[back], n=back + 1)
