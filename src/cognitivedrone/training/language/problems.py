"""Problems in words: a sentence, a scene described by labels, and the right gate. What language is trained with.

They are drawn from the generators of all families with training ingredients, then varied: any question about the
scene instead of the task's own, more wordings, unknown names, what is asked for taken away, earlier stages.
"""

from __future__ import annotations

import functools
import re
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from cognitivedrone.models.eyes.finder import SLOTS
from cognitivedrone.models.words.text_encoder import words_of
from cognitivedrone.reasoners.scene_text import STAGES
from cognitivedrone.references import PERSON_ATTRIBUTES
from cognitivedrone.tasks import BASE_FAMILIES, FAMILIES, HARD_FAMILIES, knowledge, load_suite, wording
from cognitivedrone.tasks.families.human import person_lacking, person_with, random_features
from cognitivedrone.tasks.families.memory import memory_track
from cognitivedrone.tasks.families.symbols import RIVALS
from cognitivedrone.tasks.generate import TRAIN, Draw, Pools, Puzzle, article, words
from cognitivedrone.tasks.people import CAST, IDENTITY, TRAIN_CAST, person_label, seen
from cognitivedrone.tasks.suites import AUTHORED, drawn_task
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.tasks.vocabulary import ANIMALS, FOODS, OBJECTS
from cognitivedrone.training.language.fact_questions import FACTS, FactQuestions
from cognitivedrone.training.language.places import PLACE_FAMILIES, ask_place
from cognitivedrone.training.language.questions import ask
from cognitivedrone.training.language.typing_noise import typed
from cognitivedrone.training.language.wordings import TYPED, wordings_of
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate, Task

NAMED = "named"
"""Family of these problems."""
THINGS: tuple[str, ...] = (
    *(f"animal/{name}" for name in ANIMALS),
    *(f"food/{name}" for name in FOODS),
    *(f"object/{name}" for name in OBJECTS),
)
SAME_KIND = 0.7
"""Share of scenes whose wrong panels are of the right one's kind."""

_CONFUSED = (
    ("object/car", "object/taxi"),
    ("object/mobile_phone", "object/telephone"),
    ("object/watch", "object/alarm_clock"),
    ("object/house", "object/castle"),
    ("object/light_bulb", "object/candle"),
    ("object/package", "object/gift"),
    ("object/boot", "object/sneaker"),
    ("object/sailboat", "object/canoe"),
    ("object/socks", "object/gloves"),
    ("object/couch", "object/chair"),
    ("object/paintbrush", "object/toothbrush"),
    ("object/envelope", "object/mailbox"),
    ("object/umbrella", "object/parachute"),
    ("food/burger", "food/sandwich"),
    ("food/shortcake", "food/birthday_cake"),
    ("food/shortcake", "food/cupcake"),
    ("food/birthday_cake", "food/cupcake"),
    ("food/peanuts", "food/chestnut"),
    ("food/ramen", "food/spaghetti"),
    ("food/pie", "food/shortcake"),
    ("food/fried_shrimp", "food/sushi"),
    ("food/egg", "animal/chicken"),
    ("food/tea", "food/coffee"),
    ("food/wine", "food/champagne"),
    ("food/soda", "food/bubble_tea"),
    ("food/soda", "food/juice_box"),
    ("food/chicken_leg", "food/steak"),
    ("food/bread", "food/sandwich"),
    ("object/globe", "object/map"),
)
"""Food and objects that look alike or share one of the names in `wordings/thing_names.txt`."""
_OF_ANIMALS = re.compile(r"animal|beast|critter|creature|friend|wild|poor|\bpet\b|feed|bites|ran away|hiding|scared")
"""Wordings that suit animals alone."""
_PLURAL = re.compile(r"(?<![aious])s$")


def named_thing(draw: Draw) -> Puzzle:
    """A thing by its name, beside two others that nobody would call so."""
    right = draw.pick(THINGS)
    kind, _, concept = right.partition("/")
    alike = draw.chance(SAME_KIND)
    wrong = [thing for thing in clearly_other(right) if not alike or thing.startswith(f"{kind}/")]
    name = words(concept)
    slots = {"x": name, "a": "some" if _PLURAL.search(name) else article(name)}
    nouns = draw.pools.wordings(wording.ANIMALS, slots)
    if kind != "animal":
        nouns = [noun for noun in nouns if not _OF_ANIMALS.search(noun)]
    panels = [draw.drawing(*thing.split("/")) for thing in (right, *draw.sample(wrong, 2))]
    return draw.puzzle(draw.frame(draw.pick(nouns).format(**slots)), panels[0], panels[1:])


@functools.cache
def clearly_other(thing: str) -> tuple[str, ...]:
    """The things for which another thing cannot be taken, by its looks or its name, in the order of `THINGS`."""
    return tuple(other for other in THINGS if other not in _called(thing) and thing not in _called(other))


@functools.cache
def _called(thing: str) -> frozenset[str]:
    """The things that might be called by the name of a thing, itself among them."""
    kind, _, concept = thing.partition("/")
    name = words(concept)
    called = {thing, *(other for other in THINGS if set(name.split()) & set(words(other.partition("/")[2]).split()))}
    if kind == "animal":
        called |= {f"animal/{rival}" for rival in RIVALS[concept]}
    called |= {pair[1 - pair.index(thing)] for pair in _CONFUSED if thing in pair}
    for claim in knowledge.claims():
        if thing in claim.true and name in (claim.value, claim.head):  # a fish, and all fish
            called |= claim.true
    return frozenset(called)


def lacking(draw: Draw) -> Puzzle:
    """A person who lacks a feature that the two others have."""
    (absent,) = random_features(draw, 1)
    sentence = draw.say(
        "lacking",
        "Fly through the gate with the person who does not have {absent}",
        "Fly to the gate with the person without {absent}",
        absent=absent.phrase,
    )
    others = [draw.portrait(person_with(draw, [absent])) for _ in range(2)]
    return draw.puzzle(sentence, draw.portrait(person_lacking(draw, [], absent)), others)


UNKNOWN_NAMES = wordings_of("NAMES", whole=False)
"""Names of unknown people. No vocabulary of a training run has them among its trained words, so that another unknown
name is read alike: by its word vector and its spelling."""
_INVENTED = 0.3  # share of unknown people with a name that nobody has
_SYLLABLES = [consonant + vowel for consonant in "bdfgklmnprstvz" for vowel in "aeio"]
_ALIKE = 0.6  # share of unknown identities that look much like a known person


def with_unknown_person(rng: np.random.Generator, task: Task) -> Task:
    """A task of the family `people` about an unknown identity, who may look much like a known person."""
    near = rng.random() < _ALIKE
    while True:
        person = {key: values[int(rng.integers(len(values)))] for key, values in PERSON_ATTRIBUTES.items()}
        if near:
            like = CAST[TRAIN_CAST[int(rng.integers(len(TRAIN_CAST)))]]
            kept = set(rng.permutation(IDENTITY)[: len(IDENTITY) - 3].tolist())
            person |= {key: like.get(key, PERSON_ATTRIBUTES[key][0]) for key in kept}
        looks = seen(person)
        if all(sum(looks[k] != seen(CAST[n]).get(k) for k in IDENTITY if k != "skin") >= 2 for n in TRAIN_CAST):
            break
    first, second, third = (
        person_label(person, label.rpartition("@")[2]) if gate == task.target else label
        for gate, label in enumerate(task.labels)
    )
    instruction = task.instruction.replace(task.options[right_gate(task)], _unknown_name(rng))
    return replace(task, labels=(first, second, third), instruction=instruction)


def _unknown_name(rng: np.random.Generator) -> str:
    if rng.random() >= _INVENTED:
        return UNKNOWN_NAMES[int(rng.integers(len(UNKNOWN_NAMES)))]
    return "".join(_SYLLABLES[int(k)] for k in rng.integers(len(_SYLLABLES), size=int(rng.integers(2, 4)))).capitalize()


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
