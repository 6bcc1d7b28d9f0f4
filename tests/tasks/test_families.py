"""What the generators promise: one right answer, no leaks, nothing held out in training."""

import itertools
import re
from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cognitivedrone.errors import TaskError
from cognitivedrone.references import PERSON_ATTRIBUTES
from cognitivedrone.tasks import (
    BASE_FAMILIES,
    HARD_FAMILIES,
    facts,
    people,
    train_task,
    validate_task,
    vocabulary,
    wording,
)
from cognitivedrone.tasks.families import generator
from cognitivedrone.tasks.families.memory import memory_track
from cognitivedrone.tasks.generate import HELD_OUT, TRAIN, Draw, held_out_pair, plural
from cognitivedrone.types import Task

SAMPLES = 3000
SUM = re.compile(r"[\d(][\d+*()-]*[+*-][\d+*()-]*\d\)?")


@pytest.fixture(scope="module")
def train() -> list[Task]:
    return [train_task(i, seed=11) for i in range(SAMPLES)]


def concept(label: str) -> tuple[str, str]:
    kind, rest = label.split("/", 1)
    return kind, rest.rpartition("@")[0]


def style(label: str) -> str:
    return label.rpartition("@")[2]


def value(expression: str) -> int:
    assert re.fullmatch(r"[\d+*()-]+", expression)
    return int(eval(expression))  # noqa: S307 - digits and signs only, as asserted


def test_an_unknown_family_is_named_with_its_neighbours() -> None:
    with pytest.raises(TaskError, match="did you mean 'letters'"):
        generator("leters")
    with pytest.raises(TaskError, match="PYTHONPATH"):
        generator("no_such_module:family")


# ---- facts and people


def test_facts_speak_of_known_things_and_never_contradict_themselves() -> None:
    assert len(facts.FACTS) >= 60
    for fact in facts.FACTS:
        assert set(fact.true) | set(fact.false) <= set(facts.KIND_OF), fact.phrases
        assert not set(fact.true) & set(fact.false)
        assert fact.true
        assert len(fact.false) >= 2
        assert len(fact.phrases) >= 2
    assert not set(facts.HEALTHY) & set(facts.UNHEALTHY)
    assert set(facts.HEALTHY) | set(facts.UNHEALTHY) <= set(vocabulary.FOODS)
    phrases = [phrase for fact in facts.FACTS for phrase in fact.phrases]
    assert len(phrases) == len(set(phrases))


def test_enough_can_be_said_of_people() -> None:
    assert len({feature.phrase for feature in people.FEATURES}) == len(people.FEATURES) >= 25
    for feature in people.FEATURES:
        for name, values in (*feature.wanted.items(), *feature.doubtful.items()):
            assert set(values) <= set(PERSON_ATTRIBUTES[name]), feature.phrase
        assert "skin" not in feature.wanted


def test_no_two_of_the_cast_differ_in_less_than_two_things_one_can_see() -> None:
    assert len(people.CAST) >= 48
    alike = {"round": "glasses", "curly": "afro", "shaved_sides": "long", "stubble": "none"}
    looks = {
        name: {
            key: alike.get(shown, shown)
            for key, shown in people.seen(identity).items()
            if key in people.IDENTITY and key != "skin"
        }
        for name, identity in people.CAST.items()
    }
    for identity in people.CAST.values():
        assert all(shown in PERSON_ATTRIBUTES[key] for key, shown in identity.items())
        assert set(identity) <= set(people.IDENTITY)
    for (first, a), (second, b) in itertools.combinations(looks.items(), 2):
        assert sum(a[key] != b[key] for key in a) >= 2, (first, second)


@pytest.mark.parametrize(
    ("phrase", "person", "expected"),
    [
        ("a red hat", {"hat": "hat", "hat_color": "red"}, True),
        ("a red hat", {"hat": "hat", "hat_color": "blue"}, False),
        ("a red hat", {"hat": "beanie", "hat_color": "red"}, None),
        ("a red hat", {}, False),
        ("curly hair", {"hair": "curly"}, True),
        ("curly hair", {"hair": "curly", "hat": "beanie"}, None),
        ("a bald head", {"hat": "hat"}, None),
        ("blond hair", {"hair_color": "blond", "hair": "bald"}, None),
        ("glasses", {"glasses": "round"}, True),
        ("glasses", {"glasses": "sunglasses"}, None),
        ("a blazer", {"clothes": "blazer"}, True),
        ("a blazer", {"clothes": "blazer", "hat": "hijab"}, None),
        ("a moustache", {}, False),
    ],
)
def test_what_holds_of_a_person(phrase: str, person: people.Person, expected: bool | None) -> None:
    (feature,) = [feature for feature in people.FEATURES if feature.phrase == phrase]
    assert feature.holds(person) is expected


def test_a_person_label_is_canonical() -> None:
    person = {"glasses": "round", "hair": "long", "beard": "none", "skin": "tan"}
    assert people.person_label(person, "sky") == "person/skin=tan,hair=long,glasses=round@sky"
    assert people.person_label({}, "sand") == "person/skin=light@sand"
    assert people.parse_person("skin=tan,hair=long,glasses=round") == {
        "skin": "tan",
        "hair": "long",
        "glasses": "round",
    }


# ---- one right answer


def test_every_training_task_is_well_formed(train: list[Task]) -> None:
    for task in train:
        validate_task(task, task.id)
    assert Counter(task.family for task in train) == dict.fromkeys(BASE_FAMILIES, SAMPLES // 10)


def test_a_training_task_depends_on_seed_and_index_alone() -> None:
    assert train_task(123, seed=4) == train_task(123, seed=4)
    assert train_task(123, seed=4) != train_task(123, seed=5)
    with pytest.raises(TaskError, match="negative"):
        train_task(-1)


def described(instruction: str) -> list[people.Feature]:
    """The features that a sentence names, by their longest phrases."""
    found = []
    for feature in sorted(people.FEATURES, key=lambda feature: -len(feature.phrase)):
        instruction, n = re.subn(rf"\b{re.escape(feature.phrase)}\b", "#", instruction)
        found += [feature] * n
    return found


def test_exactly_one_person_fits_a_description(train: list[Task]) -> None:
    cases: list[tuple[str, Any, int]]
    cases = [(task.instruction, task.labels, task.target) for task in train if task.family == "attributes"]
    for draw in (Draw(np.random.default_rng([3, i]), TRAIN, i % 3) for i in range(200)):
        puzzle = generator("conjunction")(draw)
        cases.append((puzzle.instruction, [panel.label for panel in puzzle.panels], draw.target))
    for instruction, labels, target in cases:
        features = described(instruction)
        assert features, instruction
        shown = [people.parse_person(concept(label)[1]) for label in labels]
        fits = [all(feature.holds(person) is True for feature in features) for person in shown]
        fails = [any(feature.holds(person) is False for feature in features) for person in shown]
        assert fits == [i == target for i in range(3)]
        assert fails == [i != target for i in range(3)]


def test_sums_have_the_value_of_the_right_panel(train: list[Task]) -> None:
    checked = 0
    for task in train:
        if task.family in ("math", "math_board"):
            text = concept(task.board)[1] if task.board else SUM.search(task.instruction)[0]
            assert value(text) == int(task.options[task.target]), task
            assert 0 <= value(text) <= 20
            checked += 1
    assert checked == SAMPLES // 5


def test_facts_hold_for_the_right_panel_alone(train: list[Task]) -> None:
    by_phrase = {phrase: fact for fact in facts.FACTS for phrase in fact.phrases}
    checked = 0
    for task in train:
        if task.family != "association":
            continue
        matches = [p for p in by_phrase if re.search(rf"\b{re.escape(p)}\b", task.instruction)]
        if not matches or concept(task.labels[0])[0] in ("number", "letter"):
            continue
        fact = by_phrase[max(matches, key=len)]
        for i, option in enumerate(task.options):
            assert option in (fact.true if i == task.target else fact.false), task
        checked += 1
    assert checked > 200


def test_lookalikes_never_meet_where_animals_are_named(train: list[Task]) -> None:
    for task in train:
        if task.family == "animals":
            for group in vocabulary.LOOKALIKES:
                assert len(group.intersection(task.options)) <= 1


@pytest.mark.parametrize("family", [family for family in HARD_FAMILIES if family != "memory"])
def test_hard_families_make_well_formed_puzzles(family: str) -> None:
    for i in range(150):
        draw = Draw(np.random.default_rng([5, i]), TRAIN, i % 3)
        puzzle = generator(family)(draw)
        assert "{" not in puzzle.instruction
        assert len({panel.option for panel in puzzle.panels}) == 3
        assert all(re.fullmatch(r"\w+/[^@]+@[\w-]+", panel.label) for panel in puzzle.panels)


def hard(family: str, count: int = 300) -> list[tuple[str, tuple[str, ...], int, str | None]]:
    drawn = []
    for draw in (Draw(np.random.default_rng([7, i]), TRAIN, i % 3) for i in range(count)):
        puzzle = generator(family)(draw)
        drawn.append((puzzle.instruction, tuple(panel.option for panel in puzzle.panels), draw.target, puzzle.board))
    return drawn


def test_relations_point_at_the_target() -> None:
    for instruction, options, target, _ in hard("relations"):
        spots = {option: i for i, option in enumerate(options) if re.search(rf"the {option}\b", instruction)}
        where = next(iter(spots.values()))
        if "between" in instruction:
            assert target == 1
            assert set(spots.values()) == {0, 2}
        elif "farthest" in instruction:
            assert abs(target - where) == 2
        else:
            step = 2 if "two places" in instruction else 1
            assert target - where == (step if "right" in instruction else -step)


def test_counts_are_right() -> None:
    for instruction, options, target, _ in hard("counting"):
        counts = [{c.split("=")[0].split("/")[1]: int(c.split("=")[1]) for c in o.split("+")} for o in options]
        if "more" in instruction:
            more, fewer = re.search(r"more (.+) than (.+)", instruction).groups()
            truth = [
                {plural(k): n for k, n in c.items()}[more] > {plural(k): n for k, n in c.items()}[fewer] for c in counts
            ]
        else:
            totals = [sum(c.values()) for c in counts]
            if "exactly" in instruction:
                wanted = wording.NUMBER_WORDS.index(re.search(r"exactly (\w+)", instruction)[1])
            else:
                wanted = max(totals) if "most" in instruction else min(totals)
            truth = [total == wanted for total in totals]
        assert truth == [i == target for i in range(3)]


def test_two_steps_lead_to_the_right_number() -> None:
    for instruction, options, target, board in hard("two_step"):
        if board:
            step, direction = re.search(r"(\d+) (more|less)", instruction).groups()
            answer = value(concept(board)[1]) + int(step) * (1 if direction == "more" else -1)
        elif "result of" in instruction:
            answer = value(SUM.search(instruction)[0])
        else:
            first, second = instruction.split(", then ")
            a, b = (int(n) for n in re.findall(r"\d+", first))
            answer = {"Add": a + b, "Sub": b - a, "Mul": a * b}[first[:3]]
            c = int(re.search(r"\d+", second)[0])
            answer = {"add": answer + c, "tak": answer - c, "mul": answer * c}[second[:3]]
        assert int(options[target]) == answer


def test_memory_tracks_can_be_answered_from_the_gates_flown_through() -> None:
    ordinals = {"first": 0, "second": 1, "third": 2, "fourth": 3}
    recalled = 0
    for seed in range(100):
        rng = np.random.default_rng([9, seed])
        targets = [int(rng.integers(3)) for _ in range(3 + seed % 3)]
        puzzles = memory_track(Draw(rng, TRAIN, 0), targets)
        right = [puzzle.panels[target].option for puzzle, target in zip(puzzles, targets, strict=True)]
        shown: set[str] = set()
        for stage, puzzle in enumerate(puzzles):
            options = [panel.option for panel in puzzle.panels]
            text = puzzle.instruction
            back = None
            if "just flown" in text:
                back = stage - 1
            elif match := re.search(r"stage (\d)", text):
                back = int(match[1]) - 1
            elif match := re.search(r"the (\w+) gate you flew", text):
                back = ordinals[match[1]]
            if back is not None:
                assert right[stage] == right[back]
                assert set(options) <= shown
                recalled += 1
            elif "no gate has shown" in text:
                assert [option for option in options if option not in shown] == [right[stage]]
            else:
                assert right[stage] in text
            shown |= set(options)
    assert recalled > 100


# ---- nothing leaks


@pytest.mark.parametrize(
    "traits_of",
    [
        lambda task, i: {style(task.labels[i])} - {vocabulary.LOGO_STYLE},
        *(lambda task, i, key=key: {getattr(task.gates[i], key)} for key in ("size", "shape", "color")),
    ],
    ids=["style, font or background", "size", "shape", "color"],
)
def test_the_target_does_not_depend_on_the_look_of_panel_or_gate(
    train: list[Task], traits_of: Callable[[Task, int], set[str]]
) -> None:
    rates: dict[str, list[bool]] = defaultdict(list)
    for task, i in itertools.product(train, range(3)):
        for trait in traits_of(task, i):
            rates[trait].append(i == task.target)
    for name, hits in rates.items():
        # Five standard deviations of chance.
        assert abs(np.mean(hits) - 1 / 3) < 5 * np.sqrt(2 / 9 / len(hits)), name


# ---- nothing held out in training


def test_ingredients_of_train_and_unseen_are_disjoint() -> None:
    assert not TRAIN.held_out
    assert HELD_OUT.held_out
    for name in ("fonts", "styles", "backgrounds", "frames", "cast"):
        assert getattr(TRAIN, name)
        assert getattr(HELD_OUT, name)
        assert not set(getattr(TRAIN, name)) & set(getattr(HELD_OUT, name)), name
    lists = [value for name, value in vars(wording).items() if name.isupper() and "FRAMES" not in name]
    lists = [phrases for phrases in lists if phrases is not wording.NUMBER_WORDS]
    lists += [fact.phrases for fact in facts.FACTS]
    shown = {phrase for phrases in lists for phrase in TRAIN.wordings(phrases)}
    kept = {phrase for phrases in lists for phrase in HELD_OUT.wordings(phrases)}
    assert len(kept) == len(lists)
    assert not shown & kept
    pairs = [(a, b) for a in range(21) for b in range(21)]
    assert all(held_out_pair(a, b) == held_out_pair(b, a) for a, b in pairs)
    assert all(TRAIN.pair_allowed(a, b) != HELD_OUT.pair_allowed(a, b) for a, b in pairs)


def held_out_ingredients(task: Task) -> set[str]:
    """Which kinds of held-out ingredients a task contains."""
    found = set()
    for label in (*task.labels, *([task.board] if task.board else [])):
        if style(label) in (*vocabulary.HELD_OUT_FONTS, *vocabulary.HELD_OUT_STYLES, *vocabulary.HELD_OUT_BACKGROUNDS):
            found.add("style")
    for frame in wording.HELD_OUT_FRAMES:
        if re.fullmatch(re.escape(frame).replace(r"\{x\}", ".+"), task.instruction):
            found.add("wording")
    if set(task.options) & set(people.HELD_OUT_CAST):
        found.add("stranger")
    for text in (task.instruction, task.board or ""):
        if match := SUM.search(text):
            operands = [int(n) for n in re.findall(r"\d+", match[0])]
            if any(held_out_pair(a, b) for a, b in itertools.combinations(operands, 2)):
                found.add("pair")
    return found


def test_training_tasks_show_nothing_held_out(train: list[Task]) -> None:
    for task in train:
        assert held_out_ingredients(task) == set(), task


def test_the_same_check_finds_what_unseen_tasks_are_made_of() -> None:
    for family in BASE_FAMILIES:
        for i in range(30):
            puzzle = generator(family)(Draw(np.random.default_rng([13, i]), HELD_OUT, i % 3))
            a, b, c = puzzle.panels
            task = train_task(0)
            task = Task(
                id="x", category=task.category, family=family, instruction=puzzle.instruction, directive=task.directive,
                options=(a.option, b.option, c.option), labels=(a.label, b.label, c.label), target=i % 3,
                gates=task.gates, board=puzzle.board,
            )  # fmt: skip
            found = held_out_ingredients(task)
            assert "wording" in found
            assert family == "logos" or "style" in found
            assert ("stranger" in found) == (family == "people")
            assert ("pair" in found) == (family in ("math", "math_board"))
            if family == "people":
                assert sum(option in people.HELD_OUT_CAST for option in task.options) == 1
