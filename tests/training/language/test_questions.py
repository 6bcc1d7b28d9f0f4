"""Questions about existing scenes have one right answer, whoever reads them, and only the words of training."""

import itertools
import re
from collections import Counter
from typing import Any

import numpy as np
import pytest

from cognitivedrone.errors import LabelError, TaskError
from cognitivedrone.tasks import facts, parse_directive, people, train_task, vocabulary, wording
from cognitivedrone.tasks.generate import TRAIN, held_out_pair
from cognitivedrone.training.language.questions import DIRECTIVE, Question, ask, families
from cognitivedrone.types import Gate, Task

TASKS = 500
GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("small", "round", "blue"))
NOUNS = {
    "attributes": (wording.ATTRIBUTES,),
    "people": (wording.PEOPLE,),
    "letters": (wording.LETTERS,),
    "digits": (wording.DIGITS,),
    "logos": (wording.LOGOS,),
    "animals": (wording.ANIMALS,),
    "math": (wording.MATH,),
    "math_board": (wording.MATH_BOARD,),
    "food": (wording.HEALTHY, wording.UNHEALTHY),
    "association": (
        *(fact.phrases for fact in facts.FACTS),
        *(wording.LARGEST, wording.SMALLEST, wording.EVEN, wording.ODD, wording.VOWEL, wording.CONSONANT),
    ),
}
"""What may be said in each family, as lists of phrases that mean the same."""


@pytest.fixture(scope="module")
def tasks() -> list[Task]:
    return [train_task(i, seed=21) for i in range(TASKS)]


@pytest.fixture(scope="module")
def asked(tasks: list[Task]) -> list[tuple[Task, Question]]:
    """Every family that is possible for every gate, and some directives."""
    rng = np.random.default_rng(1)
    found = []
    for task in tasks:
        scene = task.labels, task.board, task.gates
        for target in range(3):
            for family in (*families(*scene, target), DIRECTIVE, None, None):
                found.append((task, ask(rng, *scene, target, family)))
    return found


# ---- reading a question back, without the module's own tables


def fill(template: str) -> re.Pattern[str]:
    """A pattern that reads the fields of a template back."""
    fields = {"{x}": "(?P<x>.+)", "{a}": "(?P<a>an?)", "{word}": "(?P<word>[a-z]+)"}
    return re.compile("".join(fields.get(part, re.escape(part)) for part in re.split(r"(\{\w+\})", template)))


FRAMES = {frame: fill(frame) for frame in TRAIN.frames}
TEMPLATES = {
    family: {phrase: (fill(phrase), phrases) for phrases in lists for phrase in phrases[:-1]}
    for family, lists in NOUNS.items()
}


def read(question: Question) -> tuple[str, str, dict[str, str], tuple[str, ...]]:
    """Frame, phrase, fields of the phrase and the list it is from; the most literal phrase that fits."""
    ((frame, noun),) = [(f, m["x"]) for f, p in FRAMES.items() if (m := p.fullmatch(question.text))]
    fits = [
        (phrase, match.groupdict(), phrases)
        for phrase, (pattern, phrases) in TEMPLATES[question.family].items()
        if (match := pattern.fullmatch(noun))
    ]
    assert fits, question
    # The most literal reading; "the number seven" is one of the word rather than of the figure.
    return frame, *max(fits, key=lambda fit: (len(re.sub(r"\{\w+\}", "", fit[0])), "word" in fit[1]))


def concepts(task: Task) -> list[str]:
    return [label.split("/", 1)[1].rpartition("@")[0] for label in task.labels]


def value(expression: str) -> int:
    assert re.fullmatch(r"[\d+*()-]+", expression)
    return int(eval(expression))  # noqa: S307 - digits and signs only, as asserted


def persons(task: Task) -> list[people.Person]:
    return [people.parse_person(concept) for concept in concepts(task)]


def check_attributes(task: Task, question: Question) -> None:
    text = read(question)[2]["x"]
    found = []
    for feature in sorted(people.FEATURES, key=lambda feature: -len(feature.phrase)):
        text, n = re.subn(rf"\b{re.escape(feature.phrase)}\b", "#", text)
        found += [feature] * n
    assert text in ("#", "# and #")
    for i, person in enumerate(persons(task)):
        if i == question.target:
            assert all(feature.holds(person) is True for feature in found)
        else:
            assert any(feature.holds(person) is False for feature in found)


def check_people(task: Task, question: Question) -> None:
    name = read(question)[2]["x"]
    assert name in people.TRAIN_CAST
    looks = [people.seen(person) for person in persons(task)]
    wanted = people.seen(people.CAST[name])
    same = [all(look[key] == wanted[key] for key in people.IDENTITY) for look in looks]
    assert same == [i == question.target for i in range(3)]


def check_name(task: Task, question: Question) -> None:
    fields = read(question)[2]
    said = fields["x"] if "x" in fields else str(wording.NUMBER_WORDS.index(fields["word"]))
    plain = [re.sub("[_ ]", "", concept).lower() for concept in concepts(task)]
    assert [p == re.sub("[ .']", "", said).lower() for p in plain] == [i == question.target for i in range(3)]
    if question.family == "animals":
        right = concepts(task)[question.target]
        assert "a" not in fields or fields["a"] == ("an" if right[0] in "aeiou" else "a")
        for group in vocabulary.LOOKALIKES:
            assert right not in group or len(group.intersection(concepts(task))) == 1


def check_math(task: Task, question: Question) -> None:
    text = read(question)[2]["x"]
    operands = [int(n) for n in re.findall(r"\d+", text)]
    assert len(operands) in (2, 3)
    assert max(operands) <= 20
    assert not any(held_out_pair(a, b) for a, b in itertools.combinations(operands, 2))
    assert [int(c) == value(text) for c in concepts(task)] == [i == question.target for i in range(3)]


def check_math_board(task: Task, question: Question) -> None:
    read(question)
    answer = value(task.board.split("/")[1].rpartition("@")[0])
    assert [int(c) == answer for c in concepts(task)] == [i == question.target for i in range(3)]


def check_food(task: Task, question: Question) -> None:
    healthy = read(question)[3] is wording.HEALTHY
    for i, concept in enumerate(concepts(task)):
        assert concept in (facts.HEALTHY if healthy == (i == question.target) else facts.UNHEALTHY)


def check_association(task: Task, question: Question) -> None:
    phrases = read(question)[3]
    shown = concepts(task)
    rules = {
        wording.LARGEST: lambda c: int(c) == max(map(int, shown)),
        wording.SMALLEST: lambda c: int(c) == min(map(int, shown)),
        wording.EVEN: lambda c: int(c) % 2 == 0,
        wording.ODD: lambda c: int(c) % 2 == 1,
        wording.VOWEL: lambda c: c in "AEIOU",
        wording.CONSONANT: lambda c: c not in "AEIOU",
    }
    if phrases in rules:
        assert [rules[phrases](c) for c in shown] == [i == question.target for i in range(3)]
        if phrases in (wording.EVEN, wording.ODD):
            assert "0" not in shown
        if phrases in (wording.VOWEL, wording.CONSONANT):
            assert not {"Y", "W"}.intersection(shown)
        return
    (fact,) = [fact for fact in facts.FACTS if fact.phrases == phrases]
    for i, concept in enumerate(shown):
        assert concept in (fact.true if i == question.target else fact.false)


def check_directive(task: Task, question: Question) -> None:
    size, color, shape = parse_directive(question.text)
    fits = [
        size in (None, gate.size) and color in (None, gate.color) and shape in (None, gate.shape) for gate in task.gates
    ]
    assert fits == [i == question.target for i in range(3)]


CHECKS = {
    "attributes": check_attributes,
    "people": check_people,
    **dict.fromkeys(("letters", "digits", "logos", "animals"), check_name),
    "math": check_math,
    "math_board": check_math_board,
    "food": check_food,
    "association": check_association,
    DIRECTIVE: check_directive,
}


@pytest.mark.parametrize("family", CHECKS)
def test_a_question_is_true_of_its_target_alone(asked: list[tuple[Task, Question]], family: str) -> None:
    cases = [(task, question) for task, question in asked if question.family == family]
    assert len(cases) >= 50
    for task, question in cases:
        CHECKS[family](task, question)


def test_a_task_s_own_family_can_ask_for_its_target(tasks: list[Task]) -> None:
    for task in tasks:
        assert task.family in families(task.labels, task.board, task.gates, task.target), task


# ---- words


def test_every_wording_of_training_comes_up_and_no_other(tasks: list[Task]) -> None:
    rng = np.random.default_rng(2)
    frames: Counter[str] = Counter()
    phrases: Counter[str] = Counter()
    for task in tasks:
        for family in families(task.labels, task.board, task.gates, task.target):
            for _ in range(8):
                # `read` fails on whatever is not a training frame around a training phrase.
                frame, phrase, _, _ = read(ask(rng, task.labels, task.board, task.gates, task.target, family))
                frames[frame] += 1
                phrases[phrase] += 1
    assert set(frames) == set(TRAIN.frames)
    assert max(frames.values()) < 1.3 * min(frames.values())
    lists = [group for name, groups in NOUNS.items() if name != "association" for group in groups]
    assert {phrase for group in lists for phrase in group[:-1]} <= set(phrases)


def test_directives_use_words_of_training_and_vary(asked: list[tuple[Task, Question]]) -> None:
    known = {word for task, _ in asked for text in (task.instruction, task.directive) for word in text.split()}
    directives = [(task, question) for task, question in asked if question.family == DIRECTIVE]
    assert {word for _, question in directives for word in question.text.split()} <= known
    plain = [
        question.text == f"Fly through the {g.size} {g.color} {g.shape} gate"
        for task, question in directives
        for g in (task.gates[question.target],)
    ]
    assert 0.65 < np.mean(plain) < 0.75
    texts = {ask(np.random.default_rng(i), ("letter/A@lora",) * 3, None, GATES, 1, DIRECTIVE).text for i in range(2000)}
    assert {"Take the green gate", "Go to the small square green gate", "Please fly through the square gate"} <= texts
    assert not any(re.search(r"the (small|big) gate", text) for text in texts)


def test_every_fact_can_be_asked() -> None:
    for fact in facts.FACTS:
        names = (fact.false[0], fact.true[0], fact.false[1])
        labels: Any = tuple(f"{facts.KIND_OF[name]}/{name}@noto" for name in names)
        assert "association" in families(labels, None, GATES, 1)
        texts = {ask(np.random.default_rng(i), labels, None, GATES, 1, "association").text for i in range(60)}
        assert any(fact.phrases[0] in text for text in texts)
        assert not any(re.search(rf" {re.escape(fact.phrases[-1])}( and |$)", text) for text in texts)


# ---- what must not be asked


CAST = {name: people.person_label(people.CAST[name], "sky") for name in people.CAST}
DOUBLE = people.person_label(people.CAST["Bella"] | {"hair_color": "blond", "skin": "tan"}, "sky")


@pytest.mark.parametrize(
    ("labels", "board", "expected"),
    [
        (("animal/cat@noto", "animal/lion@noto", "animal/elephant@noto"), None, ("association",)),
        (("animal/leopard@noto", "animal/lion@noto", "animal/cat@noto"), None, ()),
        (("animal/fox@noto", "animal/fox@fluent", "animal/bee@noto"), None, ()),
        (("animal/fox@noto", "food/pear@noto", "animal/ant@noto"), None, ()),
        (("logo/apple@color", "logo/go@color", "logo/java@color"), None, ("logos",)),
        (("logo/apple@color", "food/apple@noto", "logo/java@color"), None, ()),
        (("food/pear@noto", "food/pizza@noto", "food/kiwi@noto"), None, ()),
        (("food/tomato@noto", "food/pizza@noto", "food/fries@noto"), None, ("food",)),
        (("food/tomato@noto", "food/pizza@noto", "food/milk@noto"), None, ()),
        (("letter/Y@lora", "letter/A@lora", "letter/E@lora"), None, ("letters",)),
        (("letter/X@lora", "letter/A@lora", "letter/E@lora"), None, ("letters", "association")),
        (("letter/O@lora", "number/0@lora", "letter/E@lora"), None, ()),
        (("number/8@lora", "number/9@lora", "number/0@lora"), None, ("digits", "math")),
        (("number/8@lora", "number/9@lora", "number/7@lora"), None, ("digits", "math", "association")),
        (("number/8@lora", "number/9@lora", "number/0@lora"), "sum/4+4@lora", ("digits", "math", "math_board")),
        (("number/8@lora", "number/9@lora", "number/0@lora"), "sum/4+5@lora", ("digits", "math")),
        (("number/8@lora", "number/8@oswald", "number/0@lora"), "sum/4+4@lora", ()),
        (("number/99@lora", "number/9@lora", "number/0@lora"), None, ()),
        (("several/animal/cat=3@noto", "several/animal/cat=2@noto", "several/animal/cat=1@noto"), None, ()),
        (("person/anna@sky", CAST["Emil"], CAST["Hana"]), None, ()),
        ((CAST["Bella"], CAST["Nadia"], CAST["Hana"]), None, ("attributes", "people")),
        ((CAST["Bella"], DOUBLE, CAST["Hana"]), None, ("attributes",)),
        ((CAST["Uma"], CAST["Emil"], CAST["Hana"]), None, ("attributes",)),
        ((CAST["Bella"], CAST["Bella"], CAST["Hana"]), None, ()),
    ],
)  # fmt: skip
def test_only_what_is_beyond_doubt_is_asked(
    labels: tuple[str, str, str], board: str | None, expected: tuple[str, ...]
) -> None:
    assert families(labels, board, GATES, 0) == expected
    question = ask(np.random.default_rng(0), labels, board, GATES, 0)
    assert question.family in (expected or (DIRECTIVE,))


def test_wrong_questions_are_refused() -> None:
    rng = np.random.default_rng(0)
    labels = ("letter/A@lora", "letter/B@lora", "letter/C@lora")
    with pytest.raises(TaskError, match="did you mean 'letters'"):
        ask(rng, labels, None, GATES, 0, "leters")
    with pytest.raises(
        TaskError, match=r"'animals' cannot ask for gate 1 .* possible: letters, association, directive"
    ):
        ask(rng, labels, None, GATES, 0, "animals")
    with pytest.raises(TaskError, match="the target is 0, 1 or 2"):
        families(labels, None, GATES, 3)
    with pytest.raises(TaskError, match="three different colors"):
        ask(rng, labels, None, (GATES[0], GATES[0], GATES[1]), 2, DIRECTIVE)
    with pytest.raises(LabelError, match="kind/concept@style"):
        families(("A", "B", "C"), None, GATES, 0)
