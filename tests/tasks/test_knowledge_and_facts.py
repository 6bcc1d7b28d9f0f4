"""The table of facts never contradicts the facts of the suites, which were written apart from it."""

import csv
from pathlib import Path

import pytest

from cognitivedrone.tasks import facts, knowledge

with (Path(__file__).parent / "sentences" / "same_facts.csv").open(encoding="utf-8") as file:
    SAME = {phrase: (name, value) for phrase, name, value in csv.reader(file)}
"""First phrase of a fact of the suites: the property and value that mean the same in the table."""
CLASSES = {
    "bird": ("class", "bird"), "mammal": ("class", "mammal"), "insect": ("class", "insect"),
    "reptile": ("class", "reptile"), "fish": ("class", "fish"), "fruit": ("group", "fruit"),
    "vegetable": ("group", "vegetable"), "drink": ("group", "drink"), "dessert": ("group", "sweet"),
    "meat": ("group", "meat"), "dish": ("group", "ready meal"), "pastry": ("group", "baked goods"),
    "tool": ("category", "tool"), "furniture": ("category", "furniture"), "clothing": ("category", "clothing"),
    "vehicle": ("category", "vehicle"), "instrument": ("category", "musical instrument"),
    "ball": ("category", "ball"), "flower": ("category", "flower"),
}  # fmt: skip
CLAIMS = {(claim.property, claim.value): claim for claim in knowledge.claims()}


def things(names: tuple[str, ...]) -> set[str]:
    return {f"{facts.KIND_OF[name]}/{name}" for name in names}


@pytest.mark.parametrize("fact", facts.FACTS, ids=lambda fact: fact.phrases[0])
def test_no_fact_of_the_suites_is_contradicted(fact: facts.Fact) -> None:
    if fact.phrases[0] not in SAME:
        pytest.skip("the table has no single value that means this")
    claim = CLAIMS[SAME[fact.phrases[0]]]
    assert not things(fact.true) & claim.false
    assert not things(fact.false) & claim.true


def test_most_facts_of_the_suites_are_compared() -> None:
    assert {fact.phrases[0] for fact in facts.FACTS} >= SAME.keys()
    assert len(SAME) >= 0.85 * len(facts.FACTS)


@pytest.mark.parametrize("group", facts.GROUPS)
def test_no_group_is_contradicted(group: str) -> None:
    assert not things(tuple(facts.GROUPS[group])) & CLAIMS[CLASSES[group]].false


def test_healthy_and_unhealthy_food_agree() -> None:
    for names, value in ((facts.HEALTHY, "healthy"), (facts.UNHEALTHY, "unhealthy")):
        assert not things(names) & CLAIMS["healthy", value].false
    assert not things(facts.HEALTHY) & CLAIMS["healthy", "unhealthy"].true
    assert not things(facts.UNHEALTHY) & CLAIMS["healthy", "healthy"].true
