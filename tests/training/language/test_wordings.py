"""The corpus of wordings: nothing is repeated or held out, every slot can be filled; and noise of typing."""

import re
from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest

from cognitivedrone.models.words.calculator import calculate
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks import BASE_FAMILIES, FAMILIES, facts, train_task, vocabulary, wording
from cognitivedrone.tasks.families.hard import KINDS
from cognitivedrone.tasks.families.memory import memory_track
from cognitivedrone.tasks.families.symbols import logo_name
from cognitivedrone.tasks.generate import HELD_OUT, TRAIN, Draw, words
from cognitivedrone.tasks.people import FEATURES, HELD_OUT_CAST
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.tasks.vocabulary import HELD_OUT_FONTS, HELD_OUT_STYLES, LETTERS, LOGOS
from cognitivedrone.training.language.problems import THINGS
from cognitivedrone.training.language.questions import ask, families
from cognitivedrone.training.language.typing_noise import typed
from cognitivedrone.training.language.wordings import COLORED, LISTS, SHOWN, TYPED, corpus, slots_of, wordings_of
from cognitivedrone.types import Gate

LINES = [(name, head, line) for name, file in corpus().items() for head, lines in file.items() for line in lines]
SLOTS = {
    "FRAMES": {"x"}, "ATTRIBUTES": {"x"}, "PEOPLE": {"x"}, "LETTERS": {"x"}, "DIGITS": {"x", "word"}, "LOGOS": {"x"},
    "ANIMALS": {"x", "a"}, "MATH": {"x"}, "conjunction": {"x"}, "exclusion": {"present", "absent"},
    "lacking": {"absent"},
    "relations between": {"x", "y"}, "negation neither": {"first", "second"}, "negation not": {"first"},
    "counting more": {"x", "y"}, "counting exactly": {"x", "n", "word"}, "distraction": {"right", "other", "third"},
    "two_step words": {"begin", "first", "then"}, "two_step brackets": {"x"}, "two_step more": {"n"},
    "two_step less": {"n"}, "memory named": {"x"}, "memory nth": {"nth"}, "memory stage": {"n"},
    "comparison number first": {"n"}, "comparison number last": {"n"}, "look": {"x", "not1", "not2"},
    "look exclusive": {"not1", "not2"}, "look odd": {"not1"}, "look shape": {"x"},
    "worn": {"x"}, **{f"the person with a {{color}} {worn}": {"color"} for worn in COLORED},
    "beside next": {"x"}, "beside next but not": {"x", "y"}, "beside opposite": {"x"}, "order count mid": {"x"},
    **{f"relations {side}": {"x"} for side in ("left", "right", "directly left", "directly right", "two left",
                                               "two right", "farthest")},
    **{f"counting {which}": {"x"} for which in ("most", "fewest")},
}  # fmt: skip
"""Slots by heading, beside {other} and {gate}; headings that are not here have no others."""


def test_no_line_is_repeated_below_one_heading() -> None:
    seen = Counter((head, line) for _, head, line in LINES)
    assert [key for key, count in seen.items() if count > 1] == []
    assert not set(wordings_of("FRAMES", whole=False)) & set(TRAIN.frames)
    for first, name in LISTS.items():
        given = TRAIN.wordings((first, "held out"))
        assert not set(wordings_of(name, whole=False)) & set(given), name


def test_slots_are_legal() -> None:
    for name, head, line in LINES:
        legal = SLOTS.get(head.name, set()) | ({"other", "gate"} if head.name != "distraction" else {"gate"})
        assert set(slots_of(line)) <= legal, (name, head, line)
        assert head.name != "FRAMES" or slots_of(line).count("x") == 1, line
        assert not re.search(r"\s\s|\t", line), line
        assert line.isprintable(), line


def test_every_heading_extends_something() -> None:
    headings = {head for _, head, _ in LINES}
    lists = {*LISTS.values()}
    renamed = {*SHOWN, *KINDS}
    filled = {phrases[0].format(**slots) for phrases, slots in _filled()}
    colored = {f"the person with a {{color}} {worn}" for worn in COLORED}
    known = lists | renamed | filled | colored | {"FRAMES", "NAMES", "worn"}
    assert {head.name for head in headings if not head.whole} <= known
    assert renamed <= {head.name for head in headings}
    for name in lists:
        assert wordings_of(name, whole=False), name
        assert wordings_of(name, whole=True), name


def _filled() -> Iterator[tuple[tuple[str, ...], dict[str, str]]]:
    """Lists of synonymous phrases, and what their slots can be filled with."""
    yield from ((wording.ATTRIBUTES, {"x": feature.phrase}) for feature in FEATURES)
    yield from ((wording.LETTERS, {"x": letter}) for letter in LETTERS)
    yield from ((wording.DIGITS, {"x": str(number), "word": word}) for number, word in enumerate(wording.NUMBER_WORDS))
    yield from ((wording.LOGOS, {"x": logo_name(logo)}) for logo in LOGOS)
    yield from ((wording.ANIMALS, {"x": words(thing.partition("/")[2]), "a": "a"}) for thing in THINGS)


def test_a_phrase_can_have_wordings_of_its_own() -> None:
    redhead, hat, both = (
        TYPED.wordings(wording.ATTRIBUTES, {"x": described})
        for described in ("red hair", "a blue hat", "glasses and a blue hat")
    )
    assert "the redhead" in redhead
    assert "the {color} hat" not in hat
    assert {"that blue hat", "the one wearing {x}"} <= {*hat}
    assert "that blue hat" not in both
    assert "the one wearing {x}" in both
    for every in (redhead, hat):
        own = [line for line in every if line not in TYPED.wordings(wording.ATTRIBUTES)]
        assert 0.2 < len(own) / len(every) < 0.45
    lists = _filled()
    assert sum(len(TYPED.wordings(phrases, slots)) > len(TYPED.wordings(phrases)) for phrases, slots in lists) > 180


def test_what_people_show_and_kinds_have_other_names() -> None:
    texts = [drawn_task("attributes", np.random.default_rng([4, i]), "task", TYPED).instruction for i in range(600)]
    assert any("specs" in text or "spectacles" in text for text in texts)
    assert any("glasses" in text for text in texts)
    assert any(re.search(r"\ba (red|blue|green|yellow|black|white) (wool|knit)", text) for text in texts)
    texts = [drawn_task("negation", np.random.default_rng([4, i]), "task", TYPED).instruction for i in range(200)]
    assert any("edible" in text for text in texts)


def said(phrase: str) -> str:
    return phrase.replace("{x}", "").strip().lower()


def test_nothing_held_out_is_among_them() -> None:
    lists = [value for key, value in vars(wording).items() if key in LISTS.values()]
    lists += [fact.phrases for fact in facts.FACTS]
    assert len(lists) == len(LISTS)
    held_out = {said(phrase) for phrases in lists for phrase in HELD_OUT.wordings(phrases)} - {""}
    openings = {frame.partition("{x}")[0].strip().lower() for frame in wording.HELD_OUT_FRAMES}
    assert all(openings)
    for name, head, line in LINES:
        plain = said(line)
        assert not any(kept in plain for kept in held_out), (name, head, line)
        assert not any(opening in line.lower() for opening in openings), (name, head, line)
        assert not any(re.search(rf"\b{person}\b", line) for person in HELD_OUT_CAST), (name, head, line)


@pytest.mark.parametrize("family", [family for family in FAMILIES if family not in ("memory", "race", "landing")])
def test_tasks_are_typed_in_many_ways_with_training_ingredients(family: str) -> None:
    typed, plain = (
        [drawn_task(family, np.random.default_rng([9, i]), "task", pools) for i in range(150)]
        for pools in (TYPED, TRAIN)
    )
    assert len({task.instruction for task in typed}) > 100
    if family in BASE_FAMILIES:
        assert len({task.instruction for task in typed} - {task.instruction for task in plain}) > 75
    for task in typed:
        assert not re.search(r"[{}\x1f]", task.instruction), task.instruction
        assert task.instruction.strip()
        assert not set(task.options) & set(HELD_OUT_CAST)
        styles = {label.rpartition("@")[2] for label in task.labels}
        assert not styles & {*HELD_OUT_FONTS, *HELD_OUT_STYLES}


def test_a_memory_track_is_typed_in_many_ways() -> None:
    texts = set()
    for seed in range(40):
        track = memory_track(Draw(np.random.default_rng(seed), TYPED, 0), [0, 1, 2, 1])
        texts |= {puzzle.instruction for puzzle in track}
    assert len(texts) > 80
    assert not any("{" in text for text in texts)


def test_another_panel_and_another_gate_are_named_by_what_they_are() -> None:
    corrected = 0
    for i in range(400):
        task = drawn_task("animals", np.random.default_rng([3, i]), "task", TYPED)
        right, *_ = (task.labels[task.target],)
        names = [parse_reference(label).concept.replace("_", " ") for label in task.labels]
        called = names[task.target], *wordings_of(f"the {names[task.target]}", whole=False)
        assert any(name in task.instruction for name in called), (right, task.instruction)
        found = re.search(r"\bnot the (\w+(?: \w+)?)(?: (?:gate|one))?\b", task.instruction)
        if found is not None and any(found[1].startswith(name) for name in names):
            corrected += 1
            assert not found[1].startswith(names[task.target]) or names[task.target] in ("chick",), task.instruction
    assert corrected > 10


def test_questions_are_asked_in_typed_words_too() -> None:
    gates = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("small", "round", "blue"))
    labels = ("logo/go@color", "logo/php@color", "logo/java@color")
    texts = {ask(np.random.default_rng(i), labels, None, gates, 1, None, TYPED).text for i in range(1500)}
    assert len(texts) > 120
    known_for = wordings_of("the PHP logo", whole=False)
    assert all("PHP" in text or any(line in text for line in known_for) for text in texts)
    assert any("Java" in text for text in texts)
    assert any(re.search(r"\bred\b|\bblue\b", text) for text in texts)
    assert families(labels, None, gates, 1) == ("logos",)


SENTENCES = [train_task(i, 3).instruction for i in range(250)]


def test_most_sentences_change_and_many_only_a_little() -> None:
    pairs = [(s, typed(s, np.random.default_rng([1, i]))) for i, s in enumerate(SENTENCES)]
    assert np.mean([a != b for a, b in pairs]) > 0.6
    assert np.mean([a.lower() == b.lower() for a, b in pairs]) > 0.25
    assert len({typed(SENTENCES[0], np.random.default_rng(i)) for i in range(40)}) > 10


def test_figures_and_sums_stay() -> None:
    for i, sentence in enumerate(SENTENCES):
        noisy = typed(sentence, np.random.default_rng([2, i]))
        assert re.findall(r"\d+", noisy) == re.findall(r"\d+", sentence), noisy
        assert calculate(noisy) == calculate(sentence), noisy
    words = "what do you get if you take four from nine, then double it"
    assert all(calculate(typed(words, np.random.default_rng(i))) == 10 for i in range(60))


@pytest.mark.parametrize("letter", [letter for letter in vocabulary.LETTERS if letter != "I"])
def test_names_of_letters_stay(letter: str) -> None:
    for seed in range(12):
        assert letter in re.findall(
            r"\b[A-Z]\b", typed(f"Please fly through the gate with the letter {letter}", np.random.default_rng(seed))
        )


def test_a_thing_never_becomes_another_thing() -> None:
    names = {name.replace("_", " ") for name in (*vocabulary.ANIMALS, *vocabulary.FOODS, *vocabulary.OBJECTS)}
    for name in sorted(names):
        for seed in range(8):
            noisy = typed(f"the {name}", np.random.default_rng(seed)).lower()
            rest = re.sub(r"^\W*\w+ ", "", noisy)
            assert rest == name or rest not in names, (name, noisy)


def test_a_number_word_stays() -> None:
    for word in ("seven", "twelve", "twenty"):
        assert all(word in typed(f"the number {word}", np.random.default_rng(seed)).lower() for seed in range(40))
