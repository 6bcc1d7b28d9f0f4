"""Every panel, board and gate of the training suite has its attributes, and they match what is drawn."""

import copy

import numpy as np
import pytest

from cognitivedrone.errors import LabelError
from cognitivedrone.tasks import load_suite, people, train_task
from cognitivedrone.training.perception.attributes import (
    ABSENT,
    ATTRIBUTES,
    KINDS,
    PERSON_GROUPS,
    AttributeIndex,
    concept_name,
    gate_looks,
    label_names,
)
from cognitivedrone.training.perception.panel_crops import draw_any_label
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

INDEX = AttributeIndex()


def names(label: str, index: AttributeIndex = INDEX) -> dict[str, str]:
    """Attribute values of a label by group."""
    row = index.of(label)
    assert row.shape == (len(index.groups),)
    known = {group: index.schema.names[i] for group, i in zip(index.groups, row, strict=True) if i != ABSENT}
    assert all(name.startswith(f"{group}/") for group, name in known.items())
    return {group: name.partition("/")[2] for group, name in known.items()}


@pytest.mark.parametrize(
    ("label", "kind", "concept"),
    [
        ("animal/polar_bear@noto", "thing", "thing:polar_bear"),
        ("food/apple@fluent", "thing", "thing:apple"),
        ("logo/apple@color", "logo", "logo:apple"),
        ("letter/A@lora", "letter", "letter:A"),
        ("number/17@inter", "number", "number:17"),
        ("number/21@inter", "unknown", None),
        ("object/apple@noto", "thing", "thing:apple"),
        ("dragon/green@noto", "unknown", None),
        ("unknown/picture", "unknown", None),
        ("person/anna@sky", "unknown", None),
        ("person/skin=green@sky", "unknown", None),
        ("person/wings=two@sky", "unknown", None),
    ],
)
def test_a_picture_has_a_kind_and_one_of_a_thing_its_concept(label: str, kind: str, concept: str | None) -> None:
    assert names(label) == {"kind": kind} | ({"concept": concept} if concept else {})
    assert INDEX.known(label) == (kind != "unknown")


def test_a_person_has_the_attributes_that_one_sees() -> None:
    shown = names("person/skin=tan,hair=long,glasses=round@sky")
    assert shown["kind"] == shown["concept"] == "person"
    assert shown["hair"] == "long"
    assert shown["hair_color"] == "brown"
    assert shown["hat"] == "none"
    assert "hat_color" not in shown
    assert shown["glasses"] == "round"
    covered = names("person/skin=tan,hat=hijab@sky")
    assert covered["hat"] == "hijab"
    assert covered["hat_color"] == "red"
    assert not {"hair", "hair_color", "clothes"} & covered.keys()


def test_a_sum_shows_two_numbers_and_a_sign() -> None:
    assert names("sum/20-12@inter") == {"kind": "sum", "first": "20", "sign": "-", "second": "12"}
    assert names("sum/7*99@inter") == {"kind": "sum", "first": "7", "sign": "*"}
    for label in ("sum/(1+2)*3@inter", "sum/7@inter"):
        assert label_names(label) == ("kind/sum",)
        assert names(label) == {"kind": "unknown"}  # a sum that cannot be read


def test_counts_are_those_of_the_label() -> None:
    assert names("several/food/lemon=4+animal/cat=2@noto") == {
        "kind": "several", "thing_a": "cat", "count_a": "2", "thing_b": "lemon", "count_b": "4"
    }  # fmt: skip
    assert names("several/food/lemon=4@noto") == {
        "kind": "several", "thing_a": "lemon", "count_a": "4", "thing_b": "none"
    }  # fmt: skip


def test_a_gate_shows_colour_shape_and_size() -> None:
    values = (*COLORS, *SHAPES, *SIZES)
    assert [values[i] for i in gate_looks(Gate("big", "round", "red"))] == ["red", "round", "big"]
    looks = {tuple(gate_looks(Gate(s, f, c))) for s in SIZES for f in SHAPES for c in COLORS}
    assert len(looks) == len(SIZES) * len(SHAPES) * len(COLORS)


def test_a_label_without_a_kind_is_refused() -> None:
    with pytest.raises(LabelError, match="kind/concept@style"):
        INDEX.of("cat")


def test_arrays_are_shared_and_cannot_be_changed() -> None:
    for indices in (INDEX.of("letter/A@lora"), gate_looks(Gate("big", "round", "red"))):
        assert indices.dtype == np.int64
        with pytest.raises(ValueError, match="read-only"):
            indices[0] = 0
    assert INDEX.of("letter/A@lora") is INDEX.of("letter/A@lora")


def test_taught_names_are_known_and_others_of_kind_unknown() -> None:
    spans = INDEX.groups
    more = ["concept/thing:dragon", "concept/thing:our_robot"]
    taught = AttributeIndex([*ATTRIBUTES[: spans["concept"].stop], *more, *ATTRIBUTES[spans["concept"].stop :]])
    for label in ("mine/dragon", "animal/dragon@noto", "mine/our_robot@3"):
        assert names(label) == {"kind": "unknown"}
        assert names(label, taught) == {
            "kind": "thing",
            "concept": f"thing:{label.partition('/')[2].partition('@')[0]}",
        }
        assert taught.known(label)
    assert names("person/skin=tan,hat=hijab@sky", taught) == names("person/skin=tan,hat=hijab@sky")
    assert not taught.known("mine/griffin")
    assert concept_name("mine", "dragon") == "concept/thing:dragon"
    assert concept_name("logo", "apple") == "concept/logo:apple"


def test_a_taught_name_shows_the_concept_that_it_names() -> None:
    for name, kind in (("concept/thing:cat", "thing"), ("concept/letter:A", "letter"), ("concept/number:7", "number")):
        row = INDEX.named(name)
        assert {ATTRIBUTES[i] for i in row if i >= 0} == {f"kind/{kind}", name}
    assert not INDEX.known("taught/concept/thing:griffin")


def test_another_process_gets_the_same_index() -> None:
    other = copy.deepcopy(AttributeIndex(ATTRIBUTES[:-1]))  # as pickle does it
    assert other.schema.names == ATTRIBUTES[:-1]
    assert other.column("concept") == INDEX.column("concept") == 1


def test_whatever_any_family_shows_is_known() -> None:
    rng = np.random.default_rng(0)
    kinds = set()
    for _ in range(800):
        label = draw_any_label(rng)
        shown = names(label)
        kinds.add(shown["kind"])
        if shown["kind"] == "sum":
            expression = label.partition("/")[2].rpartition("@")[0]
            assert expression == shown["first"] + shown["sign"] + shown["second"]
        if shown["kind"] == "several":
            assert {"thing_a", "count_a", "thing_b"} <= shown.keys()
    assert kinds == set(KINDS)


def test_whatever_the_test_suite_shows_is_known() -> None:
    for track in load_suite("open-v1:test").tracks:
        for task in track:
            assert all(INDEX.known(label) for label in task.labels)
            assert task.board is None or names(task.board).keys() == {"kind", "first", "sign", "second"}


def test_different_things_have_different_attributes() -> None:
    tasks = [train_task(i, seed=2) for i in range(600)]
    things = [task for task in tasks if not task.labels[0].startswith("person/")]
    assert len(things) == 480
    for task in things:
        assert len({tuple(INDEX.of(label)) for label in task.labels}) == 3, task


def test_attributes_of_a_person_are_all_that_a_viewer_sees() -> None:
    for i in range(0, 1000, 10):  # every tenth task describes people
        for label in train_task(i, seed=3).labels:
            person = people.parse_person(label[len("person/") :].rpartition("@")[0])
            look = {group: value for group, value in names(label).items() if group in PERSON_GROUPS}
            assert {**look, "skin": person["skin"]} == {k: v for k, v in people.seen(person).items() if v != "hidden"}
