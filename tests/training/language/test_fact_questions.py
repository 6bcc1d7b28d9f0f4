"""Questions from the table of facts: always exactly one right gate, in grammatical sentences."""

import hashlib
import re
from collections import Counter
from typing import Any

import numpy as np
import pytest

from cognitivedrone.errors import LabelError, TaskError
from cognitivedrone.tasks import knowledge
from cognitivedrone.tasks.generate import TRAIN, Draw
from cognitivedrone.tasks.knowledge import Phrase
from cognitivedrone.tasks.suites import train_task
from cognitivedrone.training.language import fact_phrasing as say
from cognitivedrone.training.language.fact_questions import FactQuestions, Pair, Ways
from cognitivedrone.training.language.questions import ask
from cognitivedrone.training.language.wordings import TYPED
from cognitivedrone.types import Gate

GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("small", "round", "blue"))
QUESTIONS = FactQuestions()
TABLE = knowledge.table()


def labels(*things: str) -> Any:
    return tuple(f"{thing}@{'color' if thing.startswith('logo') else 'noto'}" for thing in things)


def holds(index: int, thing: str) -> bool | None:
    claim = QUESTIONS.claims[index]
    return TABLE.holds(thing, claim.property, claim.value)


def fits(pair: Pair, thing: str) -> bool | None:
    """Whether both halves of a pair fit a thing: three-valued logic."""
    halves = [(holds(pair.head, thing), pair.deny == "head"), (holds(pair.other, thing), pair.deny == "other")]
    known = [None if value is None else value != deny for value, deny in halves]
    return False if False in known else None if None in known else True


def test_random_scenes_have_exactly_one_right_gate_for_every_possible_question() -> None:
    rng = np.random.default_rng(5)
    asked = Counter()
    for number in range(600):
        puzzle = QUESTIONS.puzzle(Draw(rng, TYPED, number % 3))
        shown = tuple(panel.label for panel in puzzle.panels)
        ways = QUESTIONS.ways(shown, number % 3)
        things = [label.rpartition("@")[0] for label in shown]
        right = things.pop(number % 3)
        assert ways
        for index in ways.one:
            assert holds(index, right) is True
            assert [holds(index, thing) for thing in things] == [False, False]
        for index in ways.no:
            assert holds(index, right) is False
            assert [holds(index, thing) for thing in things] == [True, True]
        for pair in ways.two[:40]:
            assert fits(pair, right) is True
            assert [fits(pair, thing) for thing in things] == [False, False]
        asked.update(one=len(ways.one), no=len(ways.no), two=len(ways.two))
        assert 3 <= len(puzzle.instruction) <= 220
    assert min(asked.values()) > 100


def test_debatable_things_are_never_options_of_a_question_about_it() -> None:
    ways = QUESTIONS.ways(labels("food/tomato", "object/bus", "food/beer"), 0)
    assert not {QUESTIONS.claims[i].value for i in ways.one} & {"fruit", "vegetable"}
    assert not QUESTIONS.ways(labels("animal/cat", "animal/cat", "animal/dog"), 0).one
    assert QUESTIONS.ways(labels("person/anna", "letter/A", "number/3"), 0) == Ways((), (), ())


def test_two_claims_at_once() -> None:
    scene = labels("animal/penguin", "animal/eagle", "animal/polar_bear")
    pairs = QUESTIONS.ways(scene, 0).two
    named = {(QUESTIONS.claims[p.head].head, p.deny, QUESTIONS.claims[p.other].value) for p in pairs}
    assert ("bird", "other", "fly") in named
    rng = np.random.default_rng(0)
    texts = {QUESTIONS.sentence(Draw(rng, TRAIN, 0), Ways((), (), pairs)) for _ in range(3000)}
    assert any(re.search(r"bird that cannot fly", text) for text in texts)
    red = QUESTIONS.ways(labels("food/strawberry", "food/lemon", "object/fire_engine"), 0).two
    texts = {QUESTIONS.sentence(Draw(rng, TRAIN, 0), Ways((), (), red)) for _ in range(3000)}
    assert any(re.search(r"(a|the) red (citrus )?fruit", text) for text in texts)


def test_denial_is_grammatical() -> None:
    cases = {
        Phrase("verb", "barks"): "does not bark",
        Phrase("verb", "carries loads"): "does not carry loads",
        Phrase("verb", "has a trunk"): "does not have a trunk",
        Phrase("verb", "catches mice"): "does not catch mice",
        Phrase("verb", "goes moo"): "does not go moo",
        Phrase("verb", "is red"): "is not red",
        Phrase("gap", "you can sit on"): "you cannot sit on",
        Phrase("gap", "you eat soup with"): "you do not eat soup with",
    }
    assert {phrase: say.denied(phrase) for phrase in cases} == cases
    for phrase in (
        Phrase("verb", "never makes a sound"),
        Phrase("verb", "hatched"),
        Phrase("gap", "a carpenter works with"),
        Phrase("verb", "loves carrots and hops"),
        Phrase("clause", "it barks"),
    ):
        assert not say.negatable(phrase)


VERBS = {phrase.text.split()[0] for claim in QUESTIONS.claims for phrase in claim.phrases if phrase.form == "verb"}


def test_verb_phrases_begin_with_a_verb_that_fits_one_thing() -> None:
    other = """ate beat became began blew built buried came carried caused died fell followed gave grew lived lost made
        roamed stored swallowed turned used can can't could doesn't hasn't may must never would twinkles,"""
    assert not {verb for verb in VERBS if not verb.endswith("s")} - set(other.split())


def test_every_form_has_frames_of_its_own() -> None:
    rng = np.random.default_rng(3)
    phrases = {form: Phrase(form, f"X{form}X") for form in knowledge.FORMS}
    for form, phrase in phrases.items():
        texts = {say.sentence(Draw(rng, TRAIN, 0), phrase) for _ in range(400)}
        assert len(texts) >= 7
        assert all(f"X{form}X" in text and "{" not in text for text in texts)
        if form in ("verb", "clause"):
            assert not any(re.search(rf"gate (?:with|that shows|under) X{form}X", text) for text in texts)


# ---- beside the other questions


def draws(seed: int) -> str:
    digest = hashlib.sha256()
    rng = np.random.default_rng(seed)
    for index in range(300):
        task = train_task(index, seed=17)
        pools = TYPED if index % 2 else TRAIN
        question = ask(rng, task.labels, task.board, task.gates, index % 3, None, pools)
        digest.update(repr(question).encode())
    return digest.hexdigest()


def test_questions_are_drawn_as_before() -> None:
    assert draws(9) == BEFORE


BEFORE = "aeb2316e1f4e6c0f2966cd4b19d8edb3edfd567db02498c6dddeee584a244edd"


def test_a_scene_of_another_form_is_refused() -> None:
    scene = labels("animal/owl", "animal/cow", "animal/shark")
    with pytest.raises(TaskError, match="the target is 0, 1 or 2"):
        QUESTIONS.ways(scene, 3)
    with pytest.raises(LabelError, match="kind/concept@style"):
        QUESTIONS.ways(("A", "B", "C"), 0)
