"""The table of facts: complete, closed, never against the facts of the suites, and every claim can be asked for."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import facts, knowledge, suites, vocabulary, wording
from cognitivedrone.tasks.knowledge import tables
from cognitivedrone.training.language import fact_phrasing

TABLE = knowledge.table()
CLAIMS = knowledge.claims()
THINGS = {f"{kind}/{concept}" for kind, (_, concepts) in tables.FILES.items() for concept in concepts}


def claim(name: str, value: str) -> knowledge.Claim:
    (found,) = [each for each in CLAIMS if (each.property, each.value) == (name, value)]
    return found


def test_a_claim_is_closed_over_the_kinds_of_its_property() -> None:
    for each in CLAIMS:
        assert each.true, each
        assert not each.true & each.false
        assert each.true | each.false <= THINGS
        kinds = {thing.partition("/")[0] for thing in each.true}
        rest = {t for t in THINGS if t.partition("/")[0] in kinds} - each.true - each.false
        for thing in rest:
            assert each.value in TABLE.entries[thing][each.property].debatable, (each.property, each.value, thing)


def test_a_phrase_never_means_two_things_that_exclude_each_other() -> None:
    said: dict[tuple[str, str], list[knowledge.Claim]] = {}
    for each in CLAIMS:
        for phrase in each.phrases:
            said.setdefault((phrase.form, phrase.text.casefold()), []).append(each)
    clashes = [
        (text, first.value, second.value, sorted(first.true & second.false))
        for (_, text), group in said.items()
        for first in group
        for second in group
        if first.true & second.false
    ]
    assert not clashes


@pytest.mark.parametrize(
    ("thing", "name", "value", "holds"),
    [
        ("animal/penguin", "can", "fly", False),
        ("animal/penguin", "class", "bird", True),
        ("animal/octopus", "legs", "eight legs", None),
        ("food/tomato", "group", "fruit", None),
        ("food/lemon", "taste", "sour", True),
        ("food/beer", "class", "bird", False),
        ("food/beer", "legs", "four legs", None),
        ("object/teddy_bear", "kind", "animal", None),
        ("logo/linux", "class", "bird", None),
        ("person/anna", "class", "bird", None),
    ],
)
def test_what_holds(thing: str, name: str, value: str, holds: bool | None) -> None:
    assert TABLE.holds(thing, name, value) is holds


def test_one_class_for_every_animal_and_one_number_of_legs() -> None:
    for animal in vocabulary.ANIMALS:
        entries = TABLE.entries[f"animal/{animal}"]
        assert len(entries["class"].values) == 1, animal
        legs = entries["legs"].values - {"more than four legs"}
        assert len(legs) + bool(entries["legs"].debatable) >= 1, animal
        assert len(legs) <= 1, animal


@pytest.mark.parametrize(
    ("narrow", "wide"),
    [
        (("class", "insect"), ("legs", "six legs")),
        (("class", "bird"), ("covering", "feathers")),
        (("family", "big cat"), ("family", "cat")),
        (("class", "mammal"), ("skeleton", "vertebrate")),
        (("contains", "alcohol"), ("group", "drink")),
        (("group", "citrus"), ("group", "fruit")),
        (("group", "fruit"), ("group", "plant")),
        (("category", "flower"), ("category", "plant")),
        (("category", "plant"), ("nature", "living thing")),
        (("category", "emergency vehicle"), ("category", "vehicle")),
        (("has", "four wheels"), ("has", "wheels")),
        (("worn_on", "feet"), ("worn_on", "any part of the body")),
        (("type", "Linux distribution"), ("type", "operating system")),
    ],
)
def test_what_follows_from_something_else_is_in_the_table_too(narrow: tuple[str, str], wide: tuple[str, str]) -> None:
    assert claim(*narrow).true <= claim(*wide).true


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (("skeleton", "vertebrate"), ("skeleton", "invertebrate")),
        (("healthy", "healthy"), ("healthy", "unhealthy")),
        (("nature", "warm-blooded"), ("nature", "cold-blooded")),
        (("object_size", "fits in a pocket"), ("object_size", "bigger than a person")),
        (("texture", "liquid"), ("is", "solid")),
        (("kept", "indoors"), ("kept", "outdoors")),
        (("nature", "living thing"), ("nature", "without life")),
        (("size", "fits in a hand"), ("size", "bigger than a person")),
        (("diet", "plants only"), ("diet", "meat")),
        (("lives_with", "pet"), ("lives_with", "wild")),
    ],
)
def test_opposites_exclude_each_other(one: tuple[str, str], other: tuple[str, str]) -> None:
    assert not claim(*one).true & claim(*other).true


def plain(text: str) -> str:
    words = text.casefold().replace("{", "").replace("}", "").split()
    while words and words[0] in ("a", "an", "the", "something", "one", "that", "what", "animal", "thing", "some"):
        words = words[1:]
    return " ".join(words)


def own_texts() -> dict[str, str]:
    return {plain(phrase.text): phrase.text for each in CLAIMS for phrase in each.phrases}


def test_nothing_held_out_for_unseen_is_among_the_phrases_or_frames() -> None:
    lists = [fact.phrases for fact in facts.FACTS]
    lists += [
        value for name, value in vars(wording).items() if name.isupper() and name not in ("FRAMES", "NUMBER_WORDS")
    ]
    held_out = {plain(group[-1]) for group in lists} | {plain(frame) for frame in wording.HELD_OUT_FRAMES}
    said = own_texts()
    assert not {said[text] for text in held_out & said.keys()}
    frames = [*fact_phrasing.FREE.values(), *fact_phrasing.AS_NOUN.values()]
    assert not held_out & {plain(frame) for group in frames for frame in group}
    seen = {plain(phrase) for group in lists for phrase in group[:-1]}
    longer = {text for text in held_out - seen if len(text.split()) >= 3}
    found = {said[text] for text in said if any(f" {held} " in f" {text} " for held in longer)}
    assert not found


def test_no_sentence_of_a_frozen_suite_is_a_phrase() -> None:
    texts = own_texts()
    for name in ("open-v1:unseen", "open-v2:words"):
        tracks = suites.load_suite(name).tracks
        sentences = {plain(task.instruction.rstrip(".!?")) for track in tracks for task in track}
        found = {texts[text] for text in texts.keys() & sentences}
        assert not found


def test_the_table_needs_no_heavy_import() -> None:
    code = "import sys; from cognitivedrone.tasks import knowledge; knowledge.claims(); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"torch", "mujoco", "onnxruntime", "PIL", "scipy"}.intersection(loaded)


# ---- files of other people


def copy(tmp_path: Path, **changes: str) -> Path:
    """A copy of the shipped files, with other content for some."""
    for file in tables.FOLDER.glob("*.csv"):
        text = file.read_text(encoding="utf-8")
        (tmp_path / file.name).write_text(changes.get(file.stem, text), encoding="utf-8")
    return tmp_path


ANIMALS = (tables.FOLDER / "animals.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (ANIMALS.replace("\nzebra,", "\nzebre,"), "animals.csv, line .*unknown concept 'zebre'; did you mean 'zebra'"),
        (ANIMALS.replace("concept,", "concept,clas,", 1), "unknown column 'clas'; did you mean 'class'"),
        (ANIMALS.replace("\nzebra,", "\ncow,"), "'cow' has a row already|has no row for"),
        ("\n".join(ANIMALS.splitlines()[:-1]), "animals.csv has no row for worm"),
        (ANIMALS + "cow,a,b\n", "has 3 cells but the header has"),
        ("", "is empty"),
        ("concept,kind,kind\n", "two columns 'kind'"),
        ("kind,class\n", "has no column 'concept'"),
        (ANIMALS + '"cow', "is not CSV"),
        (ANIMALS.replace("mammal", "mammal;mammal", 1), "'mammal' twice"),
        (ANIMALS.replace("mammal", "mam\u200bmal", 1), "invisible character"),
    ],
)
def test_malformed_tables_are_rejected_in_one_sentence(tmp_path: Path, change: str, said: str) -> None:
    with pytest.raises(TaskError, match=said) as error:
        knowledge.load_table(copy(tmp_path, animals=change))
    assert "\n" not in str(error.value)


def test_a_misspelt_value_is_rejected(tmp_path: Path) -> None:
    folder = copy(tmp_path, animals=ANIMALS.replace("mammal", "mamal", 1))
    with pytest.raises(TaskError, match=r"value 'mamal' of class has no phrases; did you mean 'mammal'"):
        knowledge.make_claims(knowledge.load_table(folder), knowledge.load_phrases(folder / "phrases.csv"))


# ---- a user's own facts

MINE = ("people/anna", "people/ben", "people/cleo", "food/muesli", "things/ben_2")


def own(tmp_path: Path, text: str, things: tuple[str, ...] = MINE) -> dict[tuple[str, str], knowledge.Claim]:
    file = tmp_path / "facts.csv"
    file.write_text(text, encoding="utf-8")
    return {(each.property, each.value): each for each in knowledge.own_claims(file, things)}


def test_columns_of_their_own_are_closed_over_the_rows(tmp_path: Path) -> None:
    found = own(tmp_path, "concept,department,who\nAnna,sales;?board,my mother\nben,IT,\nfood/muesli,,\n")
    sales = found["department", "sales"]
    assert (sales.true, sales.false) == ({"people/anna"}, {"people/ben", "food/muesli"})
    assert ("department", "board") not in found
    texts = {phrase.text for phrase in sales.phrases}
    assert {"the sales one", "department sales", "sales"} <= texts
    assert found["who", "my mother"].false == {"people/ben", "food/muesli"}


def test_a_table_of_excels_means_the_same(tmp_path: Path) -> None:
    plain = own(tmp_path, "concept,healthy,crunchy\nCafe\u0301,healthy,yes\nmuesli,,no\n", ("food/café", *MINE))
    file = tmp_path / "facts.csv"
    file.write_bytes("Concept;Healthy;crunchy;\r\nCAFÉ;healthy;yes;\r\nMuesli ;;no;\r\n".encode("cp1252"))
    found = knowledge.own_claims(file, ("food/café", *MINE))
    assert {(each.property, each.value): each for each in found} == plain


def test_yes_and_no_have_phrases_of_their_own(tmp_path: Path) -> None:
    found = own(tmp_path, "concept,crunchy\nanna,no\nmuesli,yes\n")
    assert "the crunchy one" in {phrase.text for phrase in found["crunchy", "yes"].phrases}
    assert "the one that is not crunchy" in {phrase.text for phrase in found["crunchy", "no"].phrases}


def test_columns_of_the_table_extend_it(tmp_path: Path) -> None:
    found = own(tmp_path, "concept,healthy,colour\nmuesli,healthy,brown\nanna,,teal\n")
    healthy = found["healthy", "healthy"]
    assert {"food/muesli", "food/apple"} <= healthy.true
    assert {"people/anna", "food/burger"} <= healthy.false
    assert not {"people/ben"} & (healthy.true | healthy.false)
    teal = found["colour", "teal"]
    assert (teal.true, teal.false) == ({"people/anna"}, {"food/muesli"})
    assert len(found) >= len(CLAIMS)


def test_a_row_for_a_shipped_thing_replaces_its_cells(tmp_path: Path) -> None:
    found = own(tmp_path, "concept,healthy\npizza,healthy\n", ("food/pizza",))
    assert "food/pizza" in found["healthy", "healthy"].true
    assert "food/pizza" in found["healthy", "unhealthy"].false
    assert "food/pizza" not in claim("healthy", "healthy").true


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("concept,who\nanne,x\n", "there is no picture of 'anne'; did you mean 'anna'"),
        ("concept,who\nanna,x\nanna,y\n", "line 3: 'anna' has a row already"),
        ("concept,class\nanna,mamal\n", "class 'mamal' is not in the table; did you mean 'mammal'.*column of your own"),
        ("concept\nanna\n", "only the column concept"),
        ("concept,who\n", "no rows"),
        ("who\nanna\n", "no column 'concept'"),
        ("concept,value\nanna,1\n", "cannot be called 'value'"),
        ("concept,\nanna,1\n", "column 2 has no name"),
        ("concept,who\nanna,a;a\n", "'a' twice"),
        ("concept,who\nanna,a,b\n", "has 3 cells"),
        (f"concept,who\nanna,{'x' * 200}\n", "1 to 120 characters"),
        ("concept,who\nfox,x\n", "'fox' can be people/fox or pets/fox; write the one you mean in full"),
    ],
)
def test_malformed_facts_of_their_own_are_rejected(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TaskError, match=said) as error:
        own(tmp_path, text, (*MINE, "people/fox", "pets/fox"))
    assert "\n" not in str(error.value)


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


def things(names: tuple[str, ...]) -> set[str]:
    return {f"{facts.KIND_OF[name]}/{name}" for name in names}


@pytest.mark.parametrize("fact", facts.FACTS, ids=lambda fact: fact.phrases[0])
def test_no_fact_of_the_suites_is_contradicted(fact: facts.Fact) -> None:
    if fact.phrases[0] not in SAME:
        pytest.skip("the table has no single value that means this")
    meant = claim(*SAME[fact.phrases[0]])
    assert not things(fact.true) & meant.false
    assert not things(fact.false) & meant.true


def test_most_facts_of_the_suites_are_compared() -> None:
    assert {fact.phrases[0] for fact in facts.FACTS} >= SAME.keys()
    assert len(SAME) >= 0.85 * len(facts.FACTS)


@pytest.mark.parametrize("group", facts.GROUPS)
def test_no_group_is_contradicted(group: str) -> None:
    assert not things(tuple(facts.GROUPS[group])) & claim(*CLASSES[group]).false


def test_healthy_and_unhealthy_food_agree() -> None:
    for names, value in ((facts.HEALTHY, "healthy"), (facts.UNHEALTHY, "unhealthy")):
        assert not things(names) & claim("healthy", value).false
    assert not things(facts.HEALTHY) & claim("healthy", "unhealthy").true
    assert not things(facts.UNHEALTHY) & claim("healthy", "healthy").true
