"""What sentences are taken for: the table of concepts, and what it says of panels."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.errors import ModelError, TrainingError
from cognitivedrone.models.mind import LANGUAGE_FILE, Mind
from cognitivedrone.models.words.concepts import CONCEPTS_FILE, Concepts, ConceptsModel, evidence
from cognitivedrone.models.words.text_encoder import TextEncoderModel

PACKAGED = Path(str(resources.files("cognitivedrone.models"))) / "weights" / CONCEPTS_FILE
THINGS = ("concept/thing:koala", "concept/thing:hammer", "concept/thing:fire_engine", "concept/thing:grey_crane")


@pytest.fixture(scope="module")
def model():
    return ConceptsModel.load(PACKAGED)


@pytest.fixture(scope="module")
def concepts(model):
    return Concepts(model, TextEncoderModel.load(), THINGS)


@pytest.mark.parametrize(
    ("sentence", "thing"),
    [
        ("Fly to the koala", 0),
        ("Fly to the marsupial that eats eucalyptus leaves", 0),
        ("Fly through the gate with what drives nails into wood", 1),
        ("what comes when a house burns", 2),
        ("to the gate with the grey crane", 3),  # it stands in no table: its name alone is read
    ],
)
def test_a_sentence_fits_what_it_means_best(concepts, sentence, thing):
    things, classes = concepts.fits(sentence)
    assert (things.shape, classes.shape) == ((4,), (1000,))
    assert things.argmax() == thing


def test_a_concept_that_no_thing_stands_for_is_heard(concepts):
    wanted, denied = concepts.hear("Fly to the gate with the great white shark")
    assert wanted.classes.argmax() == 2
    assert not denied
    assert concepts.heard[0][0] == "great white shark"
    assert len(dict(concepts.heard)) == 3


@pytest.mark.parametrize(
    ("sentence", "wanted", "denied"),
    [
        ("skip the koala, and not the fire engine, to the hammer", "hammer", ["koala", "fire_engine"]),
        ("neither the hammer nor the koala", None, ["hammer", "koala"]),
        ("the koala that does not sleep", "koala", []),
        ("what comes when a house burns", "fire_engine", []),
        ("Fly to the hammer, no wait the koala", "koala", []),
        ("the koala. sorry, not the koala, the hammer", "hammer", ["koala"]),
        ("to the hammer, sorry for the trouble", "hammer", []),
        ("never mind the hammer, the koala", "koala", ["hammer"]),
        ("the koala i mean", "koala", []),
    ],
)
def test_what_is_denied_is_not_what_is_wanted(concepts, sentence, wanted, denied):
    names = [thing.partition(":")[2] for thing in THINGS]
    found, others = concepts.hear(sentence)
    assert (found and names[found.things.argmax()]) == wanted
    assert [names[each.things.argmax()] for each in others] == denied


def test_what_means_nothing_is_taken_for_no_thing(model):
    concepts = Concepts(model, TextEncoderModel.load(), (*model.things, "concept/thing:zorgle"))
    for sentence in ("fly to the frobnitz", "asdf qwer zxcv", "!!!", "lennä kissan luo"):
        assert concepts.meant(sentence) is None
    thing, others = concepts.meant("I would like to mail a letter")
    assert thing == "mailbox"
    assert "koala" in others
    assert "envelope" not in others


def test_evidence_is_for_the_panel_that_shows_what_fits():
    shares = np.array([[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [1 / 3, 1 / 3, 1 / 3]], np.float32)
    told = evidence(shares, np.array([0.2, 0.6, 0.1], np.float32))
    assert told.argmax() == 1
    assert told == pytest.approx(np.log([0.1, 0.8, 1 / 3]), abs=1e-3)


@pytest.mark.parametrize(
    ("sentence", "says"),
    [("Fly to the camera", True), ("Fly to any animal", False), ("any object that is not alive and no food", False)],
)
def test_concepts_say_nothing_of_any_of_a_kind(sentence, says):
    mind = Mind.of(PACKAGED.parent / "small" / LANGUAGE_FILE)
    panels = np.zeros((3, len(mind.attributes.names)), np.float32)
    for panel, thing in zip(panels, ("zebra", "camera", "guitar"), strict=True):
        panel[[mind.attributes.names.index(name) for name in ("kind/thing", f"concept/thing:{thing}")]] = 1.0
    told = mind.evidence(sentence, panels, np.full((3, 1000), 1e-3, np.float32))
    assert told.argmax() == 1 if says else not told.any()


def test_a_table_that_another_encoder_read_is_refused(model):
    other = TextEncoderModel.load()
    other.digest = "0" * 64
    with pytest.raises(ModelError, match="made with another text encoder"):
        Concepts(model, other, THINGS)


def test_the_packaged_table_is_that_of_the_file(model):
    from cognitivedrone.training.small_vla.concepts import concepts

    table = concepts()
    assert [f"concept/thing:{each.name}" for each in table if each.kind == "thing"] == list(model.things)
    assert [each.name for each in table if each.kind == "class"] == list(model.classes)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("thing,cat,281,an animal\nthing,cat,,a pet", "'cat' twice"),
        ("thing,cat,281,", "line 2: needs the kind"),
        ("thing,cat,1000,an animal", "'1000' are no classes"),
        ("thing,cat,x-y,an animal", "'x-y' are no classes"),
        ("beast,cat,,an animal", "line 2: needs the kind"),
        ("thing,cat,,an animal", "one line of kind class for every class"),
    ],
)
def test_a_broken_table_is_refused_in_a_sentence(line, says):
    from cognitivedrone.training.small_vla.concepts import concepts

    with pytest.raises(TrainingError, match=says):
        concepts(f"kind,name,classes,definition\n{line}\n")
