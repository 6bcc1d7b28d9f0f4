"""The table of facts never contradicts the facts of the suites, which were written apart from it."""

from __future__ import annotations

import pytest

from cognitivedrone.tasks import facts, knowledge

SAME = {
    # First phrase of a fact of the suites: the value that means the same in the table.
    "the animal that lays eggs": ("birth", "eggs"),
    "the animal that can fly": ("can", "fly"),
    "the animal that lives in the sea": ("habitat", "sea"),
    "the insect": ("class", "insect"),
    "the animal with eight legs": ("legs", "eight legs"),
    "the animal without legs": ("legs", "no legs"),
    "the animal with black and white stripes": ("pattern", "black and white stripes"),
    "the animal with a trunk": ("parts", "a trunk"),
    "the animal with a very long neck": ("parts", "a long neck"),
    "the animal that gives us milk": ("gives", "milk"),
    "the animal that makes honey": ("gives", "honey"),
    "the animal that gives us wool": ("gives", "wool"),
    "the animal with a shell": ("covering", "shell"),
    "the animal that carries its young in a pouch": ("parts", "a pouch"),
    "the animal with a hump": ("parts", "a hump"),
    "the king of the animals": ("known_for", "king of the jungle"),
    "the animal that spins a web": ("can", "spin"),
    "the animal that barks": ("sound", "barks"),
    "the animal that meows": ("sound", "meows"),
    "the animal that crows in the morning": ("sound", "crows"),
    "the animal with spines": ("covering", "spines"),
    "the animal that builds dams": ("can", "build dams"),
    "the farm animal": ("family", "livestock"),
    "the animal that people keep as a pet": ("lives_with", "pet"),
    "the reptile": ("class", "reptile"),
    "the animal with eight arms": ("parts", "eight arms"),
    "the animal that eats bamboo": ("diet", "bamboo"),
    "the animal that can sting": ("parts", "a stinger"),
    "the animal that can repeat words": ("can", "talk"),
    "the animal that a tadpole turns into": ("young", "tadpole"),
    "the largest animal of all": ("size", "biggest"),
    "the fruit": ("group", "fruit"),
    "the vegetable": ("group", "vegetable"),
    "the sour fruit": ("taste", "sour"),
    "the yellow fruit": ("colour", "yellow"),
    "the drink with alcohol": ("contains", "alcohol"),
    "the frozen dessert": ("temperature", "frozen"),
    "the meat": ("group", "meat"),
    "the Japanese dish": ("from", "Japan"),
    "the Italian dish": ("from", "Italy"),
    "the Mexican dish": ("from", "Mexico"),
    "the food that bees make": ("from", "bees"),
    "the spicy food": ("taste", "hot and spicy"),
    "the salty food": ("taste", "salty"),
    "the food for a birthday": ("contains", "candles"),
    "the fruit with a stone inside": ("contains", "a stone"),
    "the food that grows under the ground": ("grows", "under the ground"),
    "the vegetable that makes you cry": ("contains", "tears"),
    "the food that hens lay": ("is", "laid"),
    "something that keeps you dry": ("used_to", "keep off rain"),
    "something you can sit on": ("used_to", "sit"),
    "something you sleep in": ("used_to", "sleep"),
    "something that tells the time": ("category", "clock"),
    "something that cuts": ("used_to", "cut"),
    "the tool for driving nails": ("used_to", "hit nails"),
    "something that opens a lock": ("used_to", "open locks"),
    "the musical instrument": ("category", "musical instrument"),
    "the instrument with strings": ("has", "strings"),
    "the ball": ("category", "ball"),
    "something you wear on your feet": ("worn_on", "feet"),
    "something you wear on your head": ("worn_on", "head"),
    "something that keeps your hands warm": ("used_to", "warm fingers"),
    "the vehicle that flies": ("used_to", "fly people"),
    "the vehicle with two wheels": ("has", "two wheels"),
    "the vehicle that runs on rails": ("used_to", "run on rails"),
    "the vehicle that floats on water": ("moves", "floats on water"),
    "something for putting out fires": ("used_to", "put out fires"),
    "the vehicle that brings people to the hospital": ("used_to", "carry the sick"),
    "the vehicle that works on fields": ("used_to", "plough"),
    "something for looking at the stars": ("used_to", "see far things"),
    "something that measures a fever": ("used_to", "measure temperature"),
    "what a doctor listens to your heart with": ("used_to", "hear the heart"),
    "something that gives light": ("category", "light"),
    "something to write with": ("category", "writing tool"),
    "something to read": ("used_to", "read"),
    "something for cleaning your teeth": ("used_to", "brush teeth"),
    "something for sweeping the floor": ("used_to", "sweep"),
    "something that takes pictures": ("used_to", "take photos"),
    "something that shows where north is": ("used_to", "find north"),
    "the plant that lives in the desert": ("used_to", "store water in spines"),
    "the flower": ("category", "flower"),
    "something to do sums with": ("used_to", "count"),
    "what appears in the sky after rain": ("used_to", "many colours after rain"),
    "something that spits lava": ("used_to", "erupt"),
    "something that attracts iron": ("used_to", "attract iron"),
    "what you need when you jump out of an airplane": ("used_to", "fall slowly"),
    "something for climbing up high": ("used_to", "climb"),
    "what holds a ship in place": ("used_to", "hold ships"),
    "something to put on a cut": ("used_to", "cover a wound"),
}
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
