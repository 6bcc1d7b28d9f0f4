"""What a panel reader tells: probabilities of attribute values, the same in PyTorch and NumPy."""

import numpy as np
import pytest
import torch

from cognitivedrone.models.attributes import UNKNOWN, AttributeSchema
from cognitivedrone.models.eyes.finder import LOOK_GROUPS
from cognitivedrone.models.eyes.panel_reader import Probabilities, Reader, ReaderConfig
from cognitivedrone.models.small_vla import Eyes, SmallVLA, SmallVLAConfig
from cognitivedrone.training.perception.attributes import ATTRIBUTES

SCHEMA = AttributeSchema(ATTRIBUTES)
CONFIG = ReaderConfig(crop_size=32, panel_encoder=(8, 8, 8, 8), embedding=16)

pytestmark = pytest.mark.usefixtures("one_thread")


def logits(count: int = 5, scale: float = 4.0) -> np.ndarray:
    return (scale * np.random.default_rng(0).standard_normal((count, len(ATTRIBUTES)))).astype(np.float32)


def test_attribute_values_apply_to_the_kinds_of_picture_that_have_them() -> None:
    kinds = [name.partition("/")[2] for name in SCHEMA.names[SCHEMA.groups["kind"]]]
    applies = {
        kind: {SCHEMA.names[i] for i in np.flatnonzero(row)} for kind, row in zip(kinds, SCHEMA.applies, strict=True)
    }
    groups = {kind: {name.partition("/")[0] for name in names} - {"kind"} for kind, names in applies.items()}
    assert groups["thing"] == groups["logo"] == groups["letter"] == groups["number"] == {"concept"}
    assert groups["sum"] == {"first", "sign", "second"}
    assert groups["several"] == {"thing_a", "count_a", "thing_b", "count_b"}
    assert {"hair", "hat"} < groups["person"]
    assert groups["unknown"] == set()


def test_probabilities_are_the_same_in_pytorch() -> None:
    for scale in (0.1, 4.0, 60.0):
        told = logits(scale=scale)
        expected = Probabilities(SCHEMA)(torch.from_numpy(told)).numpy()
        np.testing.assert_allclose(SCHEMA.probabilities(told), expected, atol=1e-6)
        together = Probabilities(SCHEMA)(torch.from_numpy(told)[None]).numpy()
        np.testing.assert_allclose(together[0], expected, atol=1e-6)


def test_the_kind_decides_what_can_be_shown_at_all() -> None:
    told = np.zeros((2, len(ATTRIBUTES)), np.float32)
    told[0, ATTRIBUTES.index("kind/letter")] = 20
    told[1, ATTRIBUTES.index(UNKNOWN)] = 20
    letter, unknown = SCHEMA.probabilities(told)
    assert letter[SCHEMA.groups["kind"]].sum() == pytest.approx(1, abs=1e-5)
    assert letter[SCHEMA.groups["concept"]].sum() == pytest.approx(1, abs=1e-5)
    assert letter[SCHEMA.groups["hat"]].sum() < 1e-5
    assert unknown[ATTRIBUTES.index(UNKNOWN)] == pytest.approx(1, abs=1e-5)
    assert unknown.sum() == pytest.approx(1, abs=1e-4)


def test_embeddings_have_a_fixed_length_and_temperature_divides_logits() -> None:
    torch.manual_seed(0)
    reader = Reader(CONFIG, 7).eval()
    crops = torch.rand(4, 3, 32, 32)
    with torch.no_grad():
        torch.testing.assert_close(reader.embed(crops).norm(dim=-1), torch.full((4,), 4.0))
        before = reader(crops)
        reader.temperature[:] = 2.0
        torch.testing.assert_close(reader(crops), before / 2)


def test_a_frame_is_read_panel_by_panel() -> None:
    torch.manual_seed(0)
    schema = AttributeSchema(ATTRIBUTES)
    made = Eyes(SmallVLA(SmallVLAConfig(backbone=(8, 8, 16), blocks=1, reader=CONFIG), schema)).eval()
    frames = torch.randint(0, 256, (2, 256, 256, 3), dtype=torch.uint8)
    with torch.no_grad():
        gates, slots, whole, read, boxes = made(frames)
        alone = made(frames[1:])
    looks = slots[..., -8:]
    assert (gates.shape, slots.shape, whole.shape) == ((2, 3, 4), (2, 3, 16 + 16), (2, 16))
    assert (read.shape, boxes.shape) == ((2, 4, len(ATTRIBUTES)), (2, 4, 4))
    for span in LOOK_GROUPS:
        torch.testing.assert_close(looks[..., span].sum(-1), torch.ones(2, 3))
    assert ((boxes[..., 3] >= 0) & (boxes[..., 3] <= 1)).all()
    for one, many in zip(alone, (gates, slots, whole, read, boxes), strict=True):
        torch.testing.assert_close(one[0], many[1], rtol=1e-4, atol=1e-4)


def reading(**shares: float) -> np.ndarray:
    """Probabilities (F,) of attribute values, by their names with "_" for "/" and ":"."""
    row = np.zeros(len(ATTRIBUTES), np.float32)
    for name, share in shares.items():
        row[next(i for i, known in enumerate(ATTRIBUTES) if known.replace("/", "_").replace(":", "_") == name)] = share
    return row


def one_dog(several: float = 0.6) -> np.ndarray:
    """A reading in doubt between a dog, and one dog that is counted."""
    return reading(
        kind_thing=1 - several, concept_thing_dog=0.9 * (1 - several), concept_thing_wolf=0.1 * (1 - several),
        kind_several=several, thing_a_dog=several, count_a_1=several, thing_b_none=several,
    )  # fmt: skip


def value(row: np.ndarray, name: str) -> float:
    return float(row[ATTRIBUTES.index(name)])


def test_one_thing_is_read_as_that_thing_where_nothing_is_counted() -> None:
    letter = reading(kind_letter=1.0, concept_letter_A=1.0)
    dog, other = SCHEMA.single_things(np.stack([one_dog(), letter]))
    assert value(dog, "kind/thing") == pytest.approx(1.0, abs=1e-5)
    assert value(dog, "concept/thing:dog") == pytest.approx(0.9, abs=1e-5)
    assert value(dog, "concept/thing:wolf") == pytest.approx(0.1, abs=1e-5)
    for name in ("kind/several", "thing_a/dog", "count_a/1", "thing_b/none"):
        assert value(dog, name) == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_array_equal(other, letter)


def test_one_thing_beside_several_is_counted() -> None:
    three = reading(kind_several=1.0, thing_a_dog=1.0, count_a_3=1.0, thing_b_none=1.0)
    panels = np.stack([one_dog(), three])
    np.testing.assert_array_equal(SCHEMA.single_things(panels), panels)


def test_readings_without_doubt_stay_as_they_are_to_the_bit() -> None:
    panels = np.stack([reading(kind_thing=1.0, concept_thing_dog=0.75), reading(kind_person=1.0, hat_beanie=0.7)])
    np.testing.assert_array_equal(SCHEMA.single_things(panels), panels)
    few = AttributeSchema(("kind/thing", "concept/thing:dog"))
    np.testing.assert_array_equal(few.single_things(panels[:, :2]), panels[:, :2])
