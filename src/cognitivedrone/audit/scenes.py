"""Changes of a task's scene or sentence, and of a mission. Pure functions of a task or track and a random generator.

Each returns the changed task with the gate that is then right, or the changed track; None where the change does not
apply.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cognitivedrone.layout import GATE_HEIGHT, GATE_XY, GATE_YAWS, draw_layout, is_clear
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.tasks.missions import sub_goals
from cognitivedrone.tasks.people import FEATURES, parse_person
from cognitivedrone.types import Gate, GatePlace, Layout, Task, Track

Change = Callable[[np.random.Generator, Task], Task | None]
TrackChange = Callable[[np.random.Generator, Track], Track | None]

BLANK = "."
"""The shortest instruction that a task may have, without any word."""
_WORDS = [
    "the", "of", "and", "to", "in", "is", "was", "for", "on", "as", "with", "by", "at", "from", "are",
    "this", "which", "or", "has", "an", "were", "not", "but", "had", "its", "they", "also", "their",
    "one", "more", "when", "there", "been", "can", "would", "about", "time", "after", "over", "into",
    "most", "through", "during", "between", "under", "while", "before",
]  # fmt: skip
_POLITE = ("{x}", "Could you please {y}?", "Hello, {y}. Thank you!", "If you don't mind, {y}")
_LAYOUTS = 200


def blank(_: np.random.Generator, task: Task) -> Task | None:
    """No words. A sum on a board is left out: it asks by itself."""
    return None if task.board is not None else replace(task, instruction=BLANK)


def random_words(rng: np.random.Generator, task: Task) -> Task | None:
    """As many words as before, which mean nothing together and name nothing; none beside a board."""
    if task.board is not None:
        return None
    words = rng.choice(_WORDS, size=max(3, len(task.instruction.split())))
    return replace(task, instruction=" ".join(words.tolist()))


def random_letters(rng: np.random.Generator, task: Task) -> Task | None:
    """As many words as before, of random letters; none beside a board."""
    if task.board is not None:
        return None
    lengths = rng.integers(3, 9, size=max(3, len(task.instruction.split())))
    letters = np.array(list(string.ascii_lowercase))
    return replace(task, instruction=" ".join("".join(rng.choice(letters, size=size)) for size in lengths))


def ask_for_another(step: int) -> Change:
    """The sentence asks for the gate `step` places further on, by what its panel shows."""

    def change(_: np.random.Generator, task: Task) -> Task | None:
        if task.target is None:
            return None
        target = (task.target + step) % 3
        phrase = phrase_of(task.labels, target)
        if phrase is None:
            return None
        return _aimed(replace(task, instruction=f"Fly through the gate with {phrase}"), target)

    return change


def ask_plainly(_: np.random.Generator, task: Task) -> Task | None:
    """The sentence asks for the same gate, in the same plain words."""
    phrase = None if task.target is None else phrase_of(task.labels, task.target)
    return replace(task, instruction=f"Fly through the gate with {phrase}") if phrase else None


def phrase_of(labels: tuple[str, str, str], target: int) -> str | None:
    """A noun phrase that holds for the panel at `target` alone; None if there is no plain one."""
    shown = [parse_reference(label) for label in labels]
    right = shown[target]
    if len({(each.kind, each.concept) for each in shown}) < 3:
        return None
    if right.kind == "person":
        people = [parse_person(each.concept) if "=" in each.concept else None for each in shown]
        for feature in FEATURES:
            holds = [None if person is None else feature.holds(person) for person in people]
            if holds[target] is True and all(other is False for i, other in enumerate(holds) if i != target):
                return f"the person with {feature.phrase}"
        return None
    if right.kind not in ("animal", "food", "object", "logo", "letter", "number"):
        return None
    noun = right.concept.replace("_", " ")
    return (
        f"the {noun} logo" if right.kind == "logo" else f"the {right.kind} {noun}" if len(noun) < 3 else f"the {noun}"
    )


def turned_panels(step: int) -> Change:
    """Panels move `step` gates on; what is asked for moves with them."""

    def change(_: np.random.Generator, task: Task) -> Task | None:
        if task.target is None or task.layout is not None:
            return None
        order = [(place - step) % 3 for place in range(3)]
        return _aimed(_panels(task, order), order.index(task.target))

    return change


def mirrored_panels(_: np.random.Generator, task: Task) -> Task | None:
    """The outer two panels change places."""
    if task.target is None or task.layout is not None:
        return None
    return _aimed(_panels(task, [2, 1, 0]), 2 - task.target)


def turned_looks(*names: str) -> Change:
    """Each gate gets the named parts of the look of the gate before it; the panels stay."""

    def change(_: np.random.Generator, task: Task) -> Task | None:
        if task.target is None:
            return None
        first, second, third = (
            replace(gate, **{name: getattr(task.gates[(place - 1) % 3], name) for name in names})
            for place, gate in enumerate(task.gates)
        )
        return _aimed(replace(task, gates=(first, second, third)), task.target)

    return change


def mirrored_stage(_: np.random.Generator, task: Task) -> Task | None:
    """Left and right exchanged: gates with their panels. Pictures and sentence stay."""
    if task.target is None or task.layout is not None or task.obstacles or task.landmark:
        return None
    first, second, third = reversed(task.gates)
    return _aimed(replace(_panels(task, [2, 1, 0]), gates=(first, second, third)), 2 - task.target)


def polite(_: np.random.Generator, task: Task) -> Task:
    """A polite frame around the sentence."""
    noun = task.instruction.strip()
    frame = _POLITE[1 + len(noun) % 3]
    return replace(task, instruction=frame.format(y=(noun[:1].lower() + noun[1:]).rstrip(".!?")))


def unpunctuated(_: np.random.Generator, task: Task) -> Task:
    """Small letters, no punctuation, as typed in a hurry."""
    words = re.sub(r"[.,!?;:]+(?=\s|$)", "", task.instruction)
    return replace(task, instruction=words[:1].lower() + words[1:] if len(words.split()[0]) > 1 else words)


def misspelt(rng: np.random.Generator, task: Task) -> Task:
    """Two neighbouring letters exchanged in one word of more than four."""
    words = task.instruction.split(" ")
    long = [place for place, word in enumerate(words) if len(word) > 4 and word.isalpha()]
    if long:
        place = long[int(rng.integers(len(long)))]
        at = int(rng.integers(1, len(words[place]) - 2))
        word = words[place]
        words[place] = word[:at] + word[at + 1] + word[at] + word[at + 2 :]
    return replace(task, instruction=" ".join(words))


def moved_gates(share: float) -> Change:
    """Gates moved and turned by up to `share` of what a random layout allows (1.5 m, 29 degrees)."""

    def change(rng: np.random.Generator, task: Task) -> Task | None:
        if task.target is None or task.layout is not None or task.only is not None or task.obstacles or task.landmark:
            return None
        for _ in range(_LAYOUTS):
            layout = _between(draw_layout(rng, task.gates, board=task.board is not None), share)
            if is_clear(layout, board=task.board is not None):
                return replace(task, layout=layout)
        return None

    return change


def _between(layout: Layout, share: float) -> Layout:
    first, second, third = (
        GatePlace(
            round(float(xy[0] + share * (place.x - xy[0])), 2),
            round(float(xy[1] + share * (place.y - xy[1])), 2),
            round(float(GATE_HEIGHT + share * (place.height - GATE_HEIGHT)), 2),
            round(float(yaw + share * (place.yaw - yaw)), 3),
        )
        for place, xy, yaw in zip(layout, GATE_XY, GATE_YAWS, strict=True)
    )
    return first, second, third


def _panels(task: Task, order: list[int]) -> Task:
    """The task with panel `order[i]` above gate i."""
    (a, b, c), (x, y, z) = ([field[place] for place in order] for field in (task.labels, task.options))
    return replace(task, labels=(a, b, c), options=(x, y, z))


def _aimed(task: Task, target: int) -> Task:
    gate: Gate = task.gates[target]
    return replace(task, target=target, directive=write_directive(gate))


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
