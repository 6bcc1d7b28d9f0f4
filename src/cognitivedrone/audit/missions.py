"""Changes of a mission: pure functions of a track and a random generator.

Each returns the track that is flown instead, or None where the change does not apply.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cognitivedrone.audit.scenes import phrase_of
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.tasks.missions import sub_goals
from cognitivedrone.types import Task, Track

TrackChange = Callable[[np.random.Generator, Track], Track | None]


def in_order(*, swapped: bool) -> TrackChange:
    """Two gates of the mission, asked for in plain words in their order, or in the other one.

    Both stages show both things, so that only the sentence says which comes first. The scenes are those of the mission,
    the same in either order; a landing and what else the sentence asks for are left out.
    """

    def change(rng: np.random.Generator, track: Track) -> Track | None:
        stages = [task for task in track if not task.landing and task.board is None and task.target is not None]
        for first, second in ((one, two) for number, one in enumerate(stages) for two in stages[number + 1 :]):
            shown = [_shown(task, rng.permutation(3).tolist(), first, second) for task in (first, second)]
            phrases = [phrase_of(shown[0].labels, shown[0].labels.index(_right(task))) for task in (first, second)]
            if None in phrases:
                continue
            asked = [0, 1] if not swapped else [1, 0]
            sentence = f"First {phrases[asked[0]]}, then {phrases[asked[1]]}"
            if len(sub_goals(sentence)) == 2:
                rights = [_right((first, second)[number]) for number in asked]
                return tuple(_asked(task, right, sentence) for task, right in zip(shown, rights, strict=True))
        return None

    return change


def _right(task: Task) -> str:
    """The label of the right gate."""
    return task.labels[task.target or 0]


def _shown(task: Task, order: list[int], first: Task, second: Task) -> Task:
    """The task with the right panels of both, and a wrong one of the first, from left to right in `order`."""
    other = next((place for place in range(3) if first.labels[place] not in (_right(first), _right(second))), 0)
    panels = [(each.labels[place], each.options[place]) for each, place in (
        (first, first.target or 0), (second, second.target or 0), (first, other)
    )]  # fmt: skip
    (a, x), (b, y), (c, z) = (panels[place] for place in order)
    return replace(task, labels=(a, b, c), options=(x, y, z))


def _asked(task: Task, right: str, mission: str) -> Task:
    target = task.labels.index(right)
    phrase = phrase_of(task.labels, target)
    directive = write_directive(task.gates[target])
    said = f"Fly through the gate with {phrase}"
    return replace(task, target=target, directive=directive, instruction=said, mission=mission)
