"""Tasks whose answer is not there: that it truly is not, their files, and what may hold them."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.collect.collector import Job, open_suite
from cognitivedrone.collect.recipe import RECIPES
from cognitivedrone.errors import DataError, TaskError
from cognitivedrone.plan import TaskSource
from cognitivedrone.tasks import BASE_FAMILIES, read_tasks, train_task, write_tasks
from cognitivedrone.tasks.directives import declines, fitting_gate, looks_asked, parse_directive
from cognitivedrone.tasks.facts import FACTS, HEALTHY, UNHEALTHY
from cognitivedrone.tasks.families.absent import _UNLIKE, KINDS, LOOKS, absent_puzzle
from cognitivedrone.tasks.families.human import _BY_PHRASE
from cognitivedrone.tasks.families.reasoning import CONSONANTS, EVEN, ODD, VOWELS
from cognitivedrone.tasks.families.symbols import RIVALS, logo_name
from cognitivedrone.tasks.format import task_from_json, task_to_json
from cognitivedrone.tasks.generate import TRAIN, Draw
from cognitivedrone.tasks.matching import asks_the_same
from cognitivedrone.tasks.people import CAST, IDENTITY, parse_person
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.tasks.wording import CONSONANT, NUMBER_WORDS, VOWEL
from cognitivedrone.tasks.wording import HEALTHY as GOOD
from cognitivedrone.tasks.wording import UNHEALTHY as BAD
from cognitivedrone.types import Gate

GATES = (Gate("big", "round", "red"), Gate("small", "round", "blue"), Gate("big", "square", "green"))
SEEDS = range(150)


def puzzle(kind, seed):
    return absent_puzzle(Draw(np.random.default_rng([7, KINDS.index(kind), seed]), TRAIN, 0), kind, GATES)


def shown(puzzle):
    """Kinds and concepts of the panels."""
    return [tuple(panel.label.rpartition("@")[0].split("/", 1)) for panel in puzzle.panels]


def puzzles(kind):
    """Many of a kind: each with its sentence and what its panels show."""
    for seed in SEEDS:
        made = puzzle(kind, seed)
        yield made, made.instruction, shown(made)


def numbers_asked(text):
    """The value of a sum, or a number in figures or words."""
    sums = re.findall(r"[\d(][\d()+*-]*", text)
    if sums:
        return eval(sums[-1])  # noqa: S307  (made of digits, signs and brackets)
    return next(i for i, word in reversed([*enumerate(NUMBER_WORDS)]) if re.search(rf"\b{word}\b", text))


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_draw_gives_the_same_task_of_three_different_panels(kind):
    for seed in SEEDS:
        made = puzzle(kind, seed)
        assert made == puzzle(kind, seed)
        assert made.absent
        assert len({panel.option for panel in made.panels}) == 3


@pytest.mark.parametrize("kind", ["letters", "digits", "math", "math_board"])
def test_no_panel_shows_the_letter_or_number(kind):
    for made, sentence, panels in puzzles(kind):
        if kind == "letters":
            (asked,) = re.findall(r"\b[A-Z]\b", sentence.replace("I want", ""))
            assert ("letter", asked) not in panels
            assert "number" not in dict(panels)
        else:
            text = made.board.partition("@")[0].partition("/")[2] if made.board else sentence
            assert ("number", str(numbers_asked(text))) not in panels
            assert "letter" not in dict(panels)


def test_no_panel_shows_the_animal_or_one_like_it():
    for _, sentence, panels in puzzles("animals"):
        asked = {name for name in RIVALS if re.search(rf"\b{name.replace('_', ' ')}\b", sentence)}
        assert asked
        for what, name in panels:
            assert what != "animal" or not asked & {name, *RIVALS[name]}


def test_no_panel_shows_the_logo():
    for _, sentence, panels in puzzles("logos"):
        for what, name in panels:
            assert what == "person" or not re.search(rf"\b{re.escape(logo_name(name))}\b", sentence)


def people(panels):
    return [parse_person(concept) for what, concept in panels if what == "person"]


def test_no_person_shows_all_features_and_each_clearly_lacks_one():
    for _, sentence, panels in puzzles("attributes"):
        asked = [feature for phrase, feature in _BY_PHRASE.items() if re.search(rf"\b{phrase}\b", sentence)]
        assert asked
        for person in people(panels):
            assert any(feature.holds(person) is False for feature in asked), sentence


def test_no_person_has_the_name():
    for _, sentence, panels in puzzles("people"):
        name = next(name for name in CAST if re.search(rf"\b{name}\b", sentence))
        for person in people(panels):
            assert any(person.get(part) != CAST[name].get(part) for part in IDENTITY)


def test_every_food_and_every_thing_is_on_the_false_side():
    for _, sentence, panels in puzzles("food"):
        good = any(re.search(rf"\b{noun}\b", sentence) for noun in GOOD)
        assert {name for what, name in panels if what == "food"} <= set(UNHEALTHY if good else HEALTHY)
    for _, sentence, panels in puzzles("association"):
        facts = [fact for fact in FACTS if any(f" {phrase}" in sentence for phrase in fact.phrases)]
        if panels[0][0] in ("letter", "number"):
            sides = {"odd": EVEN, "even": ODD, "vowel": CONSONANTS, "consonant": VOWELS}
            wrong = next(side for word, side in sides.items() if re.search(rf"\b{word}\b", sentence))
            assert {name for _, name in panels} <= set(map(str, wrong))
        else:
            assert any({name for _, name in panels} <= set(fact.false) for fact in facts)
    assert GOOD != BAD
    assert VOWEL != CONSONANT


def test_no_gate_has_the_look_that_is_asked_for():
    for _, sentence, _ in puzzles(LOOKS):
        size, color, shape = parse_directive(sentence)
        assert shape is not None
        assert color is None
        assert fitting_gate(sentence, GATES) is None
        assert all((gate.shape, size or gate.size) != (shape, gate.size) for gate in GATES)


def test_other_kinds_of_panels_are_shown_in_some_tasks():
    for kind in _UNLIKE:
        kinds = Counter(shown(puzzle(kind, seed))[0][0] for seed in SEEDS)
        assert 0.1 < 1 - kinds.most_common(1)[0][1] / kinds.total() < 0.4


def test_a_drawn_task_has_no_target_and_goes_through_a_file(tmp_path: Path):
    tasks = [drawn_task("absent", np.random.default_rng(seed), f"mine/{seed}") for seed in range(20)]
    write_tasks(tmp_path / "absent.json", tasks)
    assert read_tasks(tmp_path / "absent.json") == tasks
    assert task_to_json(tasks[0])["correct"] is None
    assert '"correct": null' in (tmp_path / "absent.json").read_text()
    assert asks_the_same(tasks[0].instruction, tasks[0])
    assert not asks_the_same("Fly through the red gate", tasks[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"correct": 2}, "correct is 2, but in the family 'absent' no gate is right; make it null"),
        ({"family": "animals", "category": "symbol_understanding"}, "correct is null.*for the family 'absent'"),
        ({"category": "reasoning"}, "family and category must both be 'absent'"),
        ({"prompt_simpler": "Fly through the big red round gate"}, "in the family 'absent' it is 'Hold position'"),
        ({"only": 1}, "only gate 1 stands, but the right gate is none"),
    ],
)
def test_malformed_absent_tasks(change, message):
    good = task_to_json(drawn_task("absent", np.random.default_rng(3), "mine/3"))
    with pytest.raises(TaskError, match=message):
        task_from_json(good | change, where="here")


def test_unknown_kinds():
    draw = Draw(np.random.default_rng(0), TRAIN, 0)
    with pytest.raises(TaskError, match="did you mean 'animals'"):
        absent_puzzle(draw, "animal")
    assert set(KINDS) == {*BASE_FAMILIES, LOOKS}


@pytest.mark.parametrize("text", ["Hold position", "hold position.", " HOLD POSITION! "])
def test_what_declines(text):
    assert declines(text)
    assert not declines(text + " at the red gate")
    assert parse_directive(text) == (None, None, None)


def test_collecting_refuses_them(tmp_path: Path):
    tasks = [train_task(0), drawn_task("absent", np.random.default_rng(0), "mine/0")]
    write_tasks(tmp_path / "mine.json", tasks)
    recipe = replace(RECIPES["debug"], episodes=2)
    with pytest.raises(DataError, match="in task 'mine/0' no gate is right"):
        open_suite(Job(TaskSource(tasks=tmp_path / "mine.json"), recipe, 2))
    assert open_suite(Job(TaskSource(tasks=tmp_path / "mine.json"), replace(recipe, episodes=1), 1)).n_tasks == 2


@pytest.mark.parametrize(
    ("text", "looks"),
    [
        ("Fly through the big triangle gate", ("big", None, "triangle")),
        ("Please go through the little blue gate!", ("small", "blue", None)),
        ("I want you to fly to the gate that is round and red", (None, "red", "round")),
        ("Request transit via the green portal, over", (None, "green", None)),
        ("Fly over the red gate", None),
        ("Fly through the gate", None),
        ("Fly through the round one", None),
        ("Fly to the gate with the ring", None),
        ("Fly through the bigger gate", None),
        ("Fly through the red or the blue gate", None),
        ("Not the red gate", None),
        ("Fly through the small gate with the dog", None),
        ("", None),
    ],
)
def test_a_sentence_that_asks_for_looks_alone_is_known_from_others(text, looks):
    assert looks_asked(text) == looks
