"""Problems in words: every family in its share, nothing that is there is called absent, and the same for a seed."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from cognitivedrone.models.words.calculator import calculate, evaluate
from cognitivedrone.reasoners.scene_text import STAGES
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks import FAMILIES, load_suite
from cognitivedrone.tasks.people import CAST, FEATURES, parse_person
from cognitivedrone.tasks.suites import AUTHORED
from cognitivedrone.training.language import problems
from cognitivedrone.training.language.fact_questions import FACTS
from cognitivedrone.training.language.places import PLACE_FAMILIES
from cognitivedrone.training.language.problems import (
    ABSENT,
    ALONE,
    NAMED,
    NAMES,
    SHARES,
    UNKNOWN_NAMES,
    Mix,
    Problem,
    Problems,
)
from cognitivedrone.training.perception.attributes import AttributeIndex

PLAIN = Mix(
    slips=0.0, facts=0.0, named=0.0, places=0.0, directives=0.0, relabelled=0.0, unknown_people=0.0, absent=0.0,
    unreadable=0.0,
)  # fmt: skip
INDEX = AttributeIndex()


def drawn(mix: Mix, count: int, seed: int = 0) -> list[Problem]:
    rng, problems = np.random.default_rng(seed), Problems(mix)
    return [problem for _ in range(count) for problem in problems.draw(rng)]


@pytest.fixture(scope="module")
def varied() -> list[Problem]:
    return drawn(Mix(earlier=0.3), 1500)


def test_a_problem_is_a_sentence_a_scene_and_an_answer(varied: list[Problem]) -> None:
    assert {problem.family for problem in varied} == set(NAMES) - {"race", "landing", "taught"}
    for problem in varied:
        assert problem.sentence.strip()
        assert len(problem.labels) == len(problem.gates) == 3
        assert len({gate.color for gate in problem.gates}) == 3
        assert problem.target in (0, 1, 2, ABSENT)
        if problem.family == "absent":
            assert problem.target == ABSENT


def test_the_same_seed_draws_the_same_problems(varied: list[Problem]) -> None:
    assert drawn(Mix(earlier=0.3), 200) == varied[: len(drawn(Mix(earlier=0.3), 200))]
    assert drawn(Mix(earlier=0.3), 50, seed=1) != drawn(Mix(earlier=0.3), 50)


@pytest.mark.parametrize("families", [SHARES, ALONE], ids=["reasoner", "alone"])
def test_families_occur_in_their_shares(families: dict[str, float]) -> None:
    assert set(families) <= set(FAMILIES)
    found = Counter()
    rng, problems = np.random.default_rng(2), Problems(replace(PLAIN, families=dict(families)))
    for _ in range(2000):
        found[problems.draw(rng)[0].family] += 1
    assert found.keys() == families.keys()
    for family, share in families.items():
        assert found[family] / 2000 == pytest.approx(share / sum(families.values()), abs=0.03), family


@pytest.mark.parametrize(
    ("name", "families"), [("facts", {FACTS}), ("named", {NAMED}), ("places", set(PLACE_FAMILIES))]
)
def test_facts_names_and_places_have_their_shares(name: str, families: set[str]) -> None:
    mix = replace(PLAIN, families={"animals": 0.8, "counting": 0.2}, **{name: 0.3})
    problems = drawn(mix, 600)
    # Places are asked for among the panels of base families alone.
    share = 0.3 * 0.8 if name == "places" else 0.3
    assert np.mean([problem.family in families for problem in problems]) == pytest.approx(share, abs=0.06)
    assert not any(problem.target == ABSENT for problem in problems)
    assert {problem.family for problem in problems} <= families | {"animals", "counting"}


def test_slips_change_the_spelling_of_their_share_of_sentences_and_nothing_else() -> None:
    mix = replace(PLAIN, families={"animals": 1.0})
    changed = 0
    for seed in range(60):
        plain, slipped = (drawn(replace(mix, slips=share), 1, seed)[0] for share in (0.0, 1.0))
        assert replace(slipped, sentence=plain.sentence, labels=plain.labels) == plain
        changed += slipped.sentence != plain.sentence
    assert changed > 40
    some = [drawn(replace(mix, slips=0.3), 1, seed)[0].sentence for seed in range(150)]
    without = [drawn(mix, 1, seed)[0].sentence for seed in range(150)]
    assert np.mean([one != other for one, other in zip(some, without, strict=True)]) == pytest.approx(0.3, abs=0.12)


def test_directives_and_unreadable_panels_have_their_shares() -> None:
    directives = drawn(replace(PLAIN, families=dict(ALONE), directives=0.2), 800)
    # Absent tasks have no gate that a directive could name.
    present = 1 - ALONE["absent"] / sum(ALONE.values())
    assert np.mean([p.family == "directive" for p in directives]) == pytest.approx(0.2 * present, abs=0.05)
    for problem in directives:
        if problem.family == "directive":
            assert problem.target != ABSENT
    unread = drawn(replace(PLAIN, families={"animals": 1.0}, unreadable=0.2), 400)
    lost = [label == "unknown/picture" for problem in unread for label in problem.labels]
    assert np.mean(lost) == pytest.approx(0.2, abs=0.04)
    # What is asked for may be among them, and is still the answer.
    assert any(problem.labels[problem.target] == "unknown/picture" for problem in unread)


@pytest.mark.parametrize("family", ["animals", "letters", "math", "exclusion", "conjunction"])
def test_what_is_asked_for_can_be_taken_away(family: str) -> None:
    problems = drawn(replace(PLAIN, families={family: 1.0}, absent=0.5), 150)
    plain = drawn(replace(PLAIN, families={family: 1.0}), 150)
    gone = [problem for problem in problems if problem.target == ABSENT]
    assert len(gone) / len(problems) == pytest.approx(0.5, abs=0.12)
    # Only wrong panels are left, one of them twice.
    assert all(len({tuple(INDEX.of(label)) for label in problem.labels}) <= 2 for problem in gone)
    assert not any(problem.target == ABSENT for problem in plain)


@pytest.mark.parametrize("family", ["counting", "comparison"])
def test_nothing_is_taken_away_where_the_other_panels_decide(family: str) -> None:
    assert not any(
        problem.target == ABSENT for problem in drawn(replace(PLAIN, families={family: 1.0}, absent=1.0), 60)
    )


def test_only_the_wrong_panels_of_the_same_problem_are_left() -> None:
    for seed in range(60):
        plain, gone = (
            drawn(replace(PLAIN, families={"letters": 1.0}, absent=share), 1, seed)[0] for share in (0.0, 1.0)
        )
        assert plain.sentence == gone.sentence
        assert gone.target == ABSENT
        wrong = {label for place, label in enumerate(plain.labels) if place != plain.target}
        assert set(gone.labels) == wrong


def test_values_of_sums_are_right(varied: list[Problem]) -> None:
    checked = 0
    for problem in varied:
        if problem.family not in ("math", "two_step") or problem.target == ABSENT:
            continue
        if problem.labels[problem.target] == "unknown/picture":
            continue
        kind, _, concept = problem.labels[problem.target].partition("/")
        if kind == "number":
            on_board = None if problem.board is None else evaluate(problem.board.partition("/")[2].rpartition("@")[0])
            assert calculate(problem.sentence, on_board) == int(concept.rpartition("@")[0]), problem
            checked += 1
    assert checked > 40


def test_tracks_are_remembered_stage_by_stage(varied: list[Problem]) -> None:
    memory = [problem for problem in varied if problem.family == "memory"]
    assert memory
    for problem in memory:
        assert len(problem.before) < STAGES
        if "same thing as the gate you have just" in problem.sentence:
            labels, flown = problem.before[-1]
            assert labels[flown].rpartition("@")[0] == problem.labels[problem.target].rpartition("@")[0]
    assert any(problem.before for problem in memory)


def test_earlier_stages_that_say_nothing_have_their_share(varied: list[Problem]) -> None:
    others = [problem for problem in varied[50:] if problem.family != "memory"]
    assert np.mean([bool(problem.before) for problem in others]) == pytest.approx(0.3, abs=0.05)
    for problem in others:
        assert len(problem.before) < STAGES
        assert all(flown in (0, 1, 2) for _, flown in problem.before)
    assert not any(p.before for p in drawn(Mix(), 200) if p.family != "memory")


def test_what_a_person_lacks_is_asked_for_alone() -> None:
    mix = replace(PLAIN, families={"exclusion": 1.0})
    never, always = (drawn(replace(mix, lacking=share), 200) for share in (0.0, 1.0))
    for problem in drawn(replace(mix, lacking=1.0, typed=0.0), 200):
        named = [feature for feature in FEATURES if feature.phrase in problem.sentence]
        absent = max(named, key=lambda feature: len(feature.phrase))
        holds = [absent.holds(parse_person(parse_reference(label).concept)) for label in problem.labels]
        assert holds.pop(problem.target) is False, problem
        assert holds == [True, True], problem
    assert len({problem.sentence for problem in always}) > 150
    assert not {problem.sentence for problem in never} & {problem.sentence for problem in always}


def test_unknown_people_are_asked_for_by_an_unknown_name() -> None:
    mix = replace(PLAIN, families={"people": 1.0}, unknown_people=0.5)
    problems = drawn(mix, 300)
    known = [any(name in problem.sentence for name in CAST) for problem in problems]
    assert np.mean(known) == pytest.approx(0.5, abs=0.1)
    strange = [p for p, cast in zip(problems, known, strict=True) if not cast]
    listed = [any(name in problem.sentence for name in UNKNOWN_NAMES) for problem in strange]
    assert 0.5 < np.mean(listed) < 0.9
    assert not {*UNKNOWN_NAMES} & {*CAST}


def test_what_is_held_out_is_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    before = [problem.sentence for problem in drawn(PLAIN, 300)]
    kept = frozenset(problems.plain(sentence) for sentence in before[:200])
    monkeypatch.setattr(problems, "held_out_sentences", lambda: kept)
    after = [problem.sentence for problem in drawn(PLAIN, 300)]
    assert not kept & {problems.plain(sentence) for sentence in after}


@pytest.mark.parametrize("name", AUTHORED)
def test_the_sentences_of_typed_suites_are_held_out(name: str) -> None:
    sentences = [task.instruction for track in load_suite(name).tracks for task in track]
    assert len(sentences) >= 200
    assert all(
        problems.is_held_out(variant) for text in sentences for variant in (text, text.upper() + "!", f"{text}.")
    )
    assert not problems.is_held_out("Fly through the small red round gate")
