"""Tasks of missions: one stage for each sub-goal, generated or typed by people.

A generated mission is checked while it is made: its sentence, read by `missions.read`, has as many sub-goals as
the track has stages, of the same kinds. A typed one is not: whether a pilot understands it is the question.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import resources

import numpy as np

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import vocabulary
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.families import generator
from cognitivedrone.tasks.families.hard import PLAIN_THINGS
from cognitivedrone.tasks.generate import TRAIN, Draw, Panel, Puzzle, article, words
from cognitivedrone.tasks.missions import pad_directive, read
from cognitivedrone.tasks.suites import finish
from cognitivedrone.types import COLORS, SHAPES, SIZES, Color, Gate, SubGoal, Task, Track

GENERATED = 100
_FAMILIES = ("animals", "food", "association", "letters", "digits", "math")
_KINDS = ("animal", "food", "object")
_SAID = {"animal": "any animal", "food": "anything to eat", "object": "any object that is not alive and no food"}
_BEGINS = re.compile(
    r"(?:fly|go|head|take|pass|visit|pick|choose|find|look for|get|steer|aim|make for|do|through|thru|to|into|under|"
    r"the|a|an|any|some|whatever|whoever|whichever|what|who|one|something|its?|that|come|back|if)\b",
    re.I,
)
_CALCULATES = re.compile(
    r"\b(?:subtract|multiply|divide|take away|add|plus|minus|less|double|halve|put \w+ back|decide|your head)\b", re.I
)
_PADS = (
    Panel("left pad", "number/1@inter"),
    Panel("middle pad", "number/2@inter"),
    Panel("right pad", "number/3@inter"),
)
"""Every task has options and labels; those of pads are not shown."""
_CLAUSE = re.compile(r"(?:Fly|Go|Head|Take|Pass|Steer)\b[^,.;?]*")


@dataclass(frozen=True, slots=True)
class _Stage:
    """What stands at one stage: the right panel first, or a pad's colour."""

    panels: tuple[Panel, Panel, Panel] | None
    family: str = "animals"
    pad: Color | None = None
    forbidden: Color | None = None
    """Colour of the gate under the second panel, which would fit, too."""


def mission_tracks(rng: np.random.Generator) -> Iterator[list[Task]]:
    """The tracks of the suite: generated ones, then those that people typed."""
    makers = [_sequence] * 40 + [_twice] * 12 + [_condition] * 18 + [_constraint] * 16 + [_memory] * 14
    for number in rng.permutation(len(makers))[:GENERATED]:
        yield list(_fitting(rng, makers[number]))
    for sentence, *stages in typed_missions():
        yield list(_track(rng, sentence, [(stage, _said(stage)) for stage in (_typed(rng, each) for each in stages)]))


def typed_missions() -> list[list[str]]:
    """Each sentence that people typed, and its stages as they are written in `typed_missions.txt`."""
    text = resources.files("cognitivedrone.tasks.missions").joinpath("typed_missions.txt").read_text(encoding="utf-8")
    return [line.split(" | ") for line in text.splitlines() if line and not line.startswith("#")]


def mission_track(rng: np.random.Generator, sentence: str, stages: Sequence[_Stage]) -> Track:
    """The track of a mission, each stage with its part of the sentence. Raises `TaskError` if they do not belong."""
    goals = read(sentence).goals
    kinds = ["land" if stage.pad else "fly" for stage in stages]
    plain = all(goal.kind == "land" or _is_plain(goal) for goal in goals)
    # Two parts, of which the first is a condition: a landing makes clear that they are two.
    plain = plain and (len(goals) > 2 or kinds[-1] == "land" or not sentence.startswith("If"))
    plain = plain and not sentence.startswith("Start with this")  # none is in the published suite, which is drawn again
    if ["land" if goal.kind == "land" else "fly" for goal in goals] != kinds or read(sentence).problem or not plain:
        raise TaskError(f"{sentence!r} has the sub-goals {[goal.instruction for goal in goals]}, not {kinds}")
    return _track(rng, sentence, [(stage, goal.instruction) for stage, goal in zip(stages, goals, strict=True)])


def _is_plain(goal: SubGoal) -> bool:
    """Whether a part begins as the suite's parts do, and asks for no calculation in words."""
    part = goal.instruction.removeprefix("Fly to ")
    return _BEGINS.match(part) is not None and _CALCULATES.search(part) is None


def _track(rng: np.random.Generator, sentence: str, stages: Sequence[tuple[_Stage, str]]) -> Track:
    return tuple(replace(_task(rng, stage, phrase), mission=sentence) for stage, phrase in stages)


def _said(stage: _Stage) -> str:
    """A typed stage in plain words."""
    if stage.panels is None:
        return pad_directive(stage.pad)
    kind = stage.panels[0].label.partition("/")[0]
    noun = words(stage.panels[0].option)
    named = {"letter": f"letter {noun}", "number": f"number {noun}", "logo": f"{noun} logo"}.get(kind, noun)
    return f"Fly through the gate with the {named}"


def _task(rng: np.random.Generator, stage: _Stage, instruction: str) -> Task:
    draw = Draw(rng, TRAIN, int(rng.integers(3)))
    target, colors = draw.target, draw.sample(COLORS, 3)
    if stage.pad is not None:
        return landing_task(stage.pad, target, colors, "?")
    assert stage.panels is not None  # noqa: S101  (a stage has panels or a pad)
    right, second, third = stage.panels
    places = [place for place in range(3) if place != target]
    if draw.chance(0.5):
        places.reverse()
    if stage.forbidden is not None:
        colors.remove(stage.forbidden)
        colors.insert(places[0], stage.forbidden)
    panels = [right] * 3
    panels[places[0]], panels[places[1]] = second, third
    gates = [Gate(draw.pick(SIZES), draw.pick(SHAPES), color) for color in colors]
    puzzle = Puzzle(instruction, (panels[0], panels[1], panels[2]))
    return finish(puzzle, task_id="?", family=stage.family, target=target, gates=(gates[0], gates[1], gates[2]))


def landing_task(pad: Color, target: int, colors: Sequence[Color], task_id: str) -> Task:
    """Three pads from left to right, of which the one of the colour `pad`, at `target`, is right.

    The others have the other `colors` in their order.
    """
    rest = [color for color in colors if color != pad]
    gates = tuple(Gate("big", "round", color) for color in [*rest[:target], pad, *rest[target:]])
    directive = pad_directive(pad)
    puzzle = Puzzle(directive, _PADS)
    task = finish(puzzle, task_id=task_id, family="landing", target=target, gates=(gates[0], gates[1], gates[2]))
    return replace(task, directive=directive, landing=True)


def _fitting(rng: np.random.Generator, maker: Callable[[Draw], tuple[str, list[_Stage]]]) -> Track:
    """A mission of one kind; one whose parts would be misread is drawn again."""
    while True:
        sentence, stages = maker(Draw(rng, TRAIN, 0))
        try:
            return mission_track(rng, sentence, stages)
        except TaskError:
            continue


def _clause(draw: Draw) -> tuple[str, _Stage]:
    """A stage of one of the families, and its sentence as a part of a longer one."""
    while True:
        family = draw.pick(_FAMILIES)
        puzzle = generator(family)(replace(draw, target=0))
        if puzzle.board is None and _CLAUSE.fullmatch(puzzle.instruction) and len(puzzle.instruction) < 90:
            phrase = puzzle.instruction
            return phrase[0].lower() + phrase[1:], _Stage(puzzle.panels, family)


def _thing(draw: Draw, name: str, others: Sequence[str], **more: Color) -> _Stage:
    first, second, third = (draw.drawing(KIND_OF[each], each) for each in (name, *others))
    return _Stage((first, second, third), "animals" if KIND_OF[name] == "animal" else "association", **more)


def _pad(draw: Draw) -> tuple[str, _Stage]:
    color = draw.pick(COLORS)
    phrase = draw.pick(("land on the {} pad", "touch down on the {} pad", "come down on the {} pad"))
    return phrase.format(color), _Stage(None, "landing", pad=color)


def _sequence(draw: Draw) -> tuple[str, list[_Stage]]:
    parts = [_clause(draw) for _ in range(2 if draw.chance(0.5) else 3)]
    if draw.chance(0.7):
        parts.append(_pad(draw))
    first, *middle, last = (phrase for phrase, _ in parts)
    form = draw.pick(
        (("First {}", ", then {}", ", and finally {}"), ("Start with this: {}", "; after that {}", "; then {}"),
         ("{}", ", then {}", ", then {}"), ("To begin with, {}", ", afterwards {}", ", and at the end {}"))
    )  # fmt: skip
    text = form[0].format(first) + "".join(form[1].format(each) for each in middle) + form[2].format(last)
    return text[0].upper() + text[1:], [stage for _, stage in parts]


def _twice(draw: Draw) -> tuple[str, list[_Stage]]:
    name, *others = draw.sample(PLAIN_THINGS, 5)
    phrase, stage = _pad(draw) if draw.chance(0.5) else _clause(draw)
    stages = [_thing(draw, name, others[:2]), _thing(draw, name, others[2:]), stage]
    return f"Fly through the gate with the {words(name)} {draw.pick(('twice', 'two times'))}, then {phrase}", stages


def _condition(draw: Draw) -> tuple[str, list[_Stage]]:
    wanted, spare, *others = draw.sample(PLAIN_THINGS, 4)
    there = draw.chance(0.5)
    stage = _thing(draw, wanted, [spare, others[0]]) if there else _thing(draw, spare, others)
    phrase, last = _pad(draw) if draw.chance(0.6) else _clause(draw)
    noun = f"{article(words(wanted))} {words(wanted)}"
    form = draw.pick(
        ("If there is {0}, take it, otherwise the {1}; then {2}",
         "First, if you see {0}, fly to it, otherwise to the {1}, then {2}")
    )  # fmt: skip
    return form.format(noun, words(spare), phrase), [stage, last]


def _constraint(draw: Draw) -> tuple[str, list[_Stage]]:
    color = draw.pick(COLORS)
    kinds = draw.sample(_KINDS, 2)
    stages, parts = [], []
    for kind in kinds:
        right, fits = draw.sample([name for name in PLAIN_THINGS if KIND_OF[name] == kind], 2)
        other = draw.pick([name for name in PLAIN_THINGS if KIND_OF[name] != kind])
        stages.append(_thing(draw, right, [fits, other], forbidden=color))
        parts.append(_SAID[kind])
    never = draw.pick(("but never through {}", "but stay away from the {} gates", "never through the {} gate"))
    return f"First {parts[0]}, then {parts[1]}, {never.format(color)}", stages


def _memory(draw: Draw) -> tuple[str, list[_Stage]]:
    names = draw.sample(PLAIN_THINGS, 6)
    stages = [_thing(draw, names[0], names[2:4]), _thing(draw, names[1], names[4:6])]
    back = draw.below(2)
    stages.append(_thing(draw, names[back], [names[2], names[1 - back]]))
    again = (
        "fly through the gate with the same thing as the first gate you flew through",
        "fly through the gate with the same thing as the second gate you flew through",
    )[back]
    text = f"First the {words(names[0])}, then the {words(names[1])}, then {again}"
    if draw.chance(0.5):
        phrase, stage = _pad(draw)
        return f"{text}, and finally {phrase}", [*stages, stage]
    return text, stages


def _typed(rng: np.random.Generator, stage: str) -> _Stage:
    """A stage as it is written in `typed_missions.txt`."""
    draw = Draw(rng, TRAIN, 0)
    if stage in COLORS:
        return _Stage(None, "landing", pad=next(color for color in COLORS if color == stage))
    names = stage.split()
    forbidden = next((color for color in COLORS if names[1].endswith(f"!{color}")), None)
    first, second, third = (_shown(draw, name.partition("!")[0]) for name in names)
    kind = first.label.partition("/")[0]
    family = {"letter": "letters", "number": "digits", "animal": "animals", "logo": "logos"}.get(kind, "association")
    return _Stage((first, second, third), family, forbidden=forbidden)


def _shown(draw: Draw, name: str) -> Panel:
    if name.isdigit():
        return draw.glyph("number", name)
    if name in vocabulary.LETTERS:
        return draw.glyph("letter", name)
    if name in vocabulary.LOGOS:
        return Panel(name, f"logo/{name}@{vocabulary.LOGO_STYLE}")
    return draw.drawing(KIND_OF[name], name)
