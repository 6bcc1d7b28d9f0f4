"""Every panel, board and gate of the training suite has its attributes, and they match what is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from cognitivedrone.errors import LabelError
from cognitivedrone.tasks import facts, load_suite, people, train_task, vocabulary
from cognitivedrone.training.common.attributes import (
    BOARD_GROUPS,
    FACETS,
    GATE_GROUPS,
    GROUPS,
    PANEL_GROUPS,
    board_attributes,
    gate_attributes,
    panel_attributes,
)
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate


def names(indices: np.ndarray) -> list[str | None]:
    return [None if index < 0 else FACETS[index] for index in indices]


def test_groups_cut_the_list_without_gaps_or_overlaps() -> None:
    assert len(set(FACETS)) == len(FACETS)
    covered = [i for span in GROUPS.values() for i in range(span.start, span.stop)]
    assert covered == list(range(len(FACETS)))
    assert set(GROUPS) == {*PANEL_GROUPS, *BOARD_GROUPS, *GATE_GROUPS}
    for group, span in GROUPS.items():
        assert span.start < span.stop
        assert all(attribute.split("/")[0] == group for attribute in FACETS[span])
    assert "skin" not in GROUPS


@pytest.mark.parametrize(
    ("label", "concept"),
    [
        ("animal/polar_bear@noto", "concept/thing:polar_bear"),
        ("food/apple@fluent", "concept/thing:apple"),
        ("logo/apple@color", "concept/logo:apple"),
        ("letter/A@lora", "concept/letter:A"),
        ("number/17@inter", "concept/number:17"),
        ("number/21@inter", None),
        ("object/apple@noto", None),
        ("several/animal/cat=3+food/apple=1@noto", None),
        ("dragon/green@noto", None),
        ("sum/7*9@inter", None),
    ],
)
def test_a_thing_has_a_concept_and_no_attributes(label: str, concept: str | None) -> None:
    assert names(panel_attributes(label)) == [concept] + [None] * (len(PANEL_GROUPS) - 1)


def test_a_person_has_the_attributes_that_one_sees() -> None:
    shown = dict(zip(PANEL_GROUPS, names(panel_attributes("person/skin=tan,hair=long,glasses=round@sky")), strict=True))
    assert shown["concept"] == "concept/person"
    assert shown["hair"] == "hair/long"
    assert shown["hair_color"] == "hair_color/brown"
    assert shown["hat"] == "hat/none"
    assert shown["hat_color"] is None
    assert shown["glasses"] == "glasses/round"
    covered = dict(zip(PANEL_GROUPS, names(panel_attributes("person/skin=tan,hat=hijab@sky")), strict=True))
    assert covered["hat"] == "hat/hijab"
    assert covered["hat_color"] == "hat_color/red"
    assert covered["hair"] is covered["hair_color"] is covered["clothes"] is None


def test_a_person_of_unknown_description_is_still_a_person() -> None:
    for label in ("person/anna@sky", "person/skin=green@sky", "person/wings=two@sky"):
        assert names(panel_attributes(label)) == ["concept/person"] + [None] * (len(PANEL_GROUPS) - 1)


def test_a_board_shows_two_numbers_and_a_sign() -> None:
    assert names(board_attributes("sum/20-12@inter")) == ["first/20", "sign/-", "second/12"]
    assert names(board_attributes("sum/7*99@inter")) == ["first/7", "sign/*", None]
    for label in ("sum/(1+2)*3@inter", "number/7@inter", "sum/7@inter"):
        assert names(board_attributes(label)) == [None, None, None]


def test_a_gate_shows_colour_shape_and_size() -> None:
    assert names(gate_attributes(Gate("big", "round", "red"))) == ["color/red", "shape/round", "size/big"]
    looks = {tuple(gate_attributes(Gate(s, f, c))) for s in SIZES for f in SHAPES for c in COLORS}
    assert len(looks) == len(SIZES) * len(SHAPES) * len(COLORS)


def test_a_label_without_a_kind_is_refused() -> None:
    with pytest.raises(LabelError, match="kind/concept@style"):
        panel_attributes("cat")


def test_arrays_are_shared_and_cannot_be_changed() -> None:
    for indices in (
        panel_attributes("letter/A@lora"),
        board_attributes("sum/1+1@lora"),
        gate_attributes(Gate("big", "round", "red")),
    ):
        assert indices.dtype == np.int64
        with pytest.raises(ValueError, match="read-only"):
            indices[0] = 0


@pytest.mark.parametrize("suite", ["open-v1:test", "open-v1:unseen"])
def test_whatever_the_suites_show_has_a_facet(suite: str) -> None:
    for track in load_suite(suite).tracks:
        for task in track:
            assert all(panel_attributes(label)[0] >= 0 for label in task.labels)
            assert task.board is None or (board_attributes(task.board) >= 0).all()


def test_different_things_have_different_attributes() -> None:
    tasks = [train_task(i, seed=2) for i in range(600)]
    things = [task for task in tasks if not task.labels[0].startswith("person/")]
    assert len(things) == 480
    for task in things:
        assert len({tuple(panel_attributes(label)) for label in task.labels}) == 3, task


def test_attributes_of_a_person_are_all_that_a_viewer_sees() -> None:
    for i in range(0, 1000, 10):  # every tenth task describes people
        for label in train_task(i, seed=3).labels:
            person = people.parse_person(label[len("person/") :].rpartition("@")[0])
            look = {name.split("/")[0]: name.split("/")[1] for name in names(panel_attributes(label))[1:] if name}
            assert {**look, "skin": person["skin"]} == {k: v for k, v in people.seen(person).items() if v != "hidden"}


def test_every_drawn_name_is_a_concept() -> None:
    concepts = {attribute.removeprefix("concept/") for attribute in FACETS[GROUPS["concept"]]}
    assert concepts == {
        *(f"thing:{name}" for name in facts.KIND_OF),
        *(f"logo:{name}" for name in vocabulary.LOGOS),
        *(f"letter:{name}" for name in vocabulary.LETTERS),
        *(f"number:{n}" for n in range(21)),
        "person",
    }
