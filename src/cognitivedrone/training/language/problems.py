"""Problems in words: a sentence, a scene described by labels, and the right gate. What language is trained with.

They are drawn from the generators of all families with training ingredients, then varied: any question about the
scene instead of the task's own, more wordings, unknown names, what is asked for taken away, earlier stages.
"""

from __future__ import annotations

import functools
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from cognitivedrone.models.eyes.finder import SLOTS
from cognitivedrone.models.words.text_encoder import words_of
from cognitivedrone.reasoners.scene_text import STAGES
from cognitivedrone.tasks import BASE_FAMILIES, FAMILIES, HARD_FAMILIES, load_suite
from cognitivedrone.tasks.families.memory import memory_track
from cognitivedrone.tasks.generate import TRAIN, Draw, Pools
from cognitivedrone.tasks.suites import AUTHORED, drawn_task
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.training.language.fact_questions import FACTS, FactQuestions
from cognitivedrone.training.language.named_things import NAMED, lacking, named_thing, with_unknown_person
from cognitivedrone.training.language.places import PLACE_FAMILIES, ask_place
from cognitivedrone.training.language.questions import ask
from cognitivedrone.training.language.typing_noise import typed
from cognitivedrone.training.language.wordings import TYPED
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate, Task


def is_held_out(sentence: str) -> bool:
    """Whether a suite written by hand has this sentence, whatever its case and punctuation."""
    return plain(sentence) in held_out_sentences()


def plain(sentence: str) -> str:
    """The words of a sentence, in lower case and without punctuation."""
    return " ".join(word for word in words_of(sentence) if word.isalnum())


@functools.cache
def held_out_sentences() -> frozenset[str]:
    """All sentences of those suites, as `plain` writes them."""
    return frozenset(
        plain(task.instruction) for name in AUTHORED for track in load_suite(name).tracks for task in track
    )


ABSENT = SLOTS
"""The right answer if no gate matches the instruction."""

SHARES: dict[str, float] = {
    **dict.fromkeys(BASE_FAMILIES, 1.0),
    **dict.fromkeys(HARD_FAMILIES, 0.7),
    "association": 3.0, "people": 1.5, "attributes": 1.5, "comparison": 1.0, "memory": 0.4, "absent": 1.5,
}  # fmt: skip
"""How often the families of a reasoner occur, relative to each other."""
ALONE: dict[str, float] = {
    "math": 0.12, "association": 0.14, "math_board": 0.06, "food": 0.05, "attributes": 0.08, "people": 0.08,
    "animals": 0.03, "letters": 0.02, "digits": 0.02, "logos": 0.02,
    "exclusion": 0.1, "comparison": 0.08, "two_step": 0.08, "negation": 0.06, "distraction": 0.03, "conjunction": 0.03,
    "absent": 0.1,
}  # fmt: skip
"""The same for a network that sees each gate by itself: neither other gates, nor earlier stages, nor counts."""


@dataclass(frozen=True, slots=True)
class Mix:
    """Distribution of problems."""

    families: dict[str, float] = field(default_factory=lambda: dict(SHARES))
    """How often the families occur, relative to each other."""
    typed: float = 0.6
    """Share of problems in the wordings of the corpus, as people type them (`wordings.TYPED`)."""
    slips: float = 0.15
    """Share of sentences with typing noise (`typing_noise.typed`)."""
    facts: float = 0.2
    """Share of problems from the table of facts."""
    named: float = 0.08
    """Share of problems that ask for an animal, food or object by its name."""
    places: float = 0.06
    """Share of problems that ask by a gate's place, its look, or the order of what panels show."""
    directives: float = 0.06
    """Share of sentences that are directives already."""
    relabelled: float = 0.3
    """Share of base tasks that ask for any of their gates, in other words."""
    unknown_people: float = 0.4
    """Share of tasks about people that ask for an unknown identity among known ones."""
    absent: float = 0.06
    """Share of problems from which what is asked for is taken away, beside those of the family `absent`."""
    unreadable: float = 0.05
    """Share of panels that show something that was never taught; what is asked for may be among them."""
    earlier: float = 0.0
    """Share of problems on a track, after irrelevant earlier stages."""
    lacking: float = 0.0
    """Share of exclusions that only name what the person lacks (`lacking.lacking`)."""


@dataclass(frozen=True, slots=True)
class Problem:
    """A sentence, a scene and the right gate."""

    sentence: str
    family: str
    labels: tuple[str, str, str]
    gates: tuple[Gate, Gate, Gate]
    board: str | None
    target: int
    """0 to 2 from left to right, or `ABSENT`."""
    before: tuple[tuple[tuple[str, ...], int], ...] = ()
    """Earlier stages of the track: labels of their panels, and the gate that was flown through."""


class Problems:
    """Draws problems from the training ingredients."""

    def __init__(self, mix: Mix) -> None:
        self.mix = mix
        self._families = tuple(mix.families)
        self._shares = np.array(list(mix.families.values())) / sum(mix.families.values())
        self._past: deque[tuple[tuple[str, ...], int]] = deque(maxlen=STAGES - 1)

    def draw(self, rng: np.random.Generator) -> list[Problem]:
        """One problem, or all problems of a memory track; never with a sentence that is held out."""
        problems = self._worded(rng)
        while any(is_held_out(problem.sentence) for problem in problems):
            problems = self._worded(rng)
        if problems[0].family == "memory":
            return problems
        problem = self._varied(rng, problems[0])
        if self.mix.earlier and rng.random() < self.mix.earlier:
            problem = replace(problem, before=tuple(list(self._past)[: int(rng.integers(1, STAGES))]))
        if problem.target != ABSENT:
            self._past.append((problem.labels, problem.target))
        return [problem]

    def take(self, rng: np.random.Generator, count: int) -> list[Problem]:
        """So many problems."""
        found: list[Problem] = []
        while len(found) < count:
            found += self.draw(rng)
        return found[:count]

    def _worded(self, rng: np.random.Generator) -> list[Problem]:
        problems = self._draw(rng)
        if rng.random() < self.mix.slips:
            problems = [replace(problem, sentence=typed(problem.sentence, rng)) for problem in problems]
        return problems

    def _draw(self, rng: np.random.Generator) -> list[Problem]:
        pools = TYPED if rng.random() < self.mix.typed else TRAIN
        chance = rng.random()
        if chance < self.mix.facts:
            return [problem_of(drawn_task("association", rng, FACTS, pools, make=_fact_questions().puzzle), FACTS)]
        if chance < self.mix.facts + self.mix.named:
            return [problem_of(drawn_task("animals", rng, NAMED, pools, make=named_thing), NAMED)]
        family = self._families[int(rng.choice(len(self._families), p=self._shares))]
        if chance < self.mix.facts + self.mix.named + self.mix.places and family in BASE_FAMILIES:
            problem = problem_of(drawn_task(family, rng, family, pools))
            question = ask_place(rng, problem.labels, problem.gates, int(rng.integers(3)))
            return [replace(problem, sentence=question.text, target=question.target, family=question.family)]
        if family == "memory":
            return _track(rng, pools)
        lone = family == "exclusion" and self.mix.lacking > 0 and rng.random() < self.mix.lacking
        task = drawn_task(family, rng, family, pools, make=lacking if lone else None)
        if family == "people" and rng.random() < self.mix.unknown_people:
            task = with_unknown_person(rng, task)
            return [problem_of(task)]
        problem = problem_of(task)
        if problem.target == ABSENT:
            return [problem]
        if rng.random() < self.mix.directives:
            question = ask(rng, task.labels, task.board, task.gates, right_gate(task), "directive")
            return [replace(problem, sentence=question.text, family="directive")]
        if family in BASE_FAMILIES and rng.random() < self.mix.relabelled:
            question = ask(rng, task.labels, task.board, task.gates, int(rng.integers(3)), None, pools)
            return [replace(problem, sentence=question.text, target=question.target, family=question.family)]
        return [problem]

    def _varied(self, rng: np.random.Generator, problem: Problem) -> Problem:
        """What is asked for is taken away, or some panels cannot be read."""
        if problem.family in ("directive", "absent", *PLACE_FAMILIES):
            return problem
        labels, target = list(problem.labels), problem.target
        if rng.random() < self.mix.absent and problem.family in _BY_CONTENT:
            wrong = [label for place, label in enumerate(labels) if place != target]
            labels[target], target = wrong[int(rng.integers(2))], ABSENT
        for place in range(3):
            if rng.random() < self.mix.unreadable:
                labels[place] = "unknown/picture"
        return replace(problem, labels=(labels[0], labels[1], labels[2]), target=target)


_fact_questions = functools.cache(FactQuestions)


def problem_of(task: Task, family: str | None = None) -> Problem:
    """A task as a problem."""
    target = ABSENT if task.target is None else task.target
    return Problem(task.instruction, family or task.family, task.labels, task.gates, task.board, target)


NAMES: tuple[str, ...] = (*FAMILIES, "directive", FACTS, NAMED, *PLACE_FAMILIES, "taught")
"""Families of problems."""
_BY_CONTENT = (
    frozenset(BASE_FAMILIES) | {FACTS, NAMED} | {"exclusion", "negation", "distraction", "conjunction", "two_step"}
)
"""Families whose wrong panels are wrong by themselves, whatever the others show."""


def draw_gates(rng: np.random.Generator) -> tuple[Gate, Gate, Gate]:
    """Three gates of different colours."""
    sizes, shapes = (rng.integers(len(names), size=3) for names in (SIZES, SHAPES))
    a, b, c = (
        Gate(SIZES[size], SHAPES[shape], COLORS[color])
        for size, shape, color in zip(sizes, shapes, rng.permutation(3), strict=True)
    )
    return a, b, c


def _track(rng: np.random.Generator, pools: Pools) -> list[Problem]:
    targets = [int(target) for target in rng.integers(3, size=int(rng.integers(3, 6)))]
    puzzles = memory_track(Draw(rng, pools, targets[0]), targets)
    before: list[tuple[tuple[str, ...], int]] = []
    problems = []
    for puzzle, target in zip(puzzles, targets, strict=True):
        first, second, third = (panel.label for panel in puzzle.panels)
        labels = first, second, third
        problems.append(Problem(puzzle.instruction, "memory", labels, draw_gates(rng), None, target, tuple(before)))
        before.append((labels, target))
    return problems
