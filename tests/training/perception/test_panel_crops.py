"""Panel crops show their labels as a camera would, and every readable content appears."""

from collections import Counter

import numpy as np
import pytest
from PIL import Image as PillowImage

from cognitivedrone.labels import load_pack
from cognitivedrone.references import parse_reference
from cognitivedrone.training.perception import panel_crops as module
from cognitivedrone.training.perception.attributes import ATTRIBUTES, KINDS, AttributeIndex
from cognitivedrone.training.perception.panel_crops import (
    SHARES,
    PanelCrops,
    WiderWorld,
    draw_known_label,
    panel_image_of,
)

INDEX = AttributeIndex()
CONCEPT = INDEX.column("concept")
KIND = INDEX.column("kind")

SIZE = 48


@pytest.fixture
def panel_crops(monkeypatch: pytest.MonkeyPatch) -> PanelCrops:
    """Of the shipped drawings alone."""
    monkeypatch.setattr(module, "_UNKNOWN", 0.0)
    return PanelCrops(SIZE, INDEX.of)


def picture(label: str) -> PillowImage.Image:
    return PillowImage.fromarray(load_pack("open-v1").image(label)).resize((64, 64))


def test_all_kinds_are_shown() -> None:
    rng = np.random.default_rng(0)
    kinds = Counter(parse_reference(draw_known_label(rng)).kind for _ in range(2000))
    assert kinds.keys() == {*(kind for kind in KINDS if kind not in ("thing", "unknown")), "animal", "food", "object"}
    single = sum(kinds[kind] for kind in ("animal", "food", "object", "logo")) / 2000
    assert single == pytest.approx(1 - sum(SHARES.values()), abs=0.05)


def test_a_glimpse_shows_its_picture_and_none_is_like_another() -> None:
    rng = np.random.default_rng(0)
    dark = np.zeros((64, 64, 3), np.uint8)
    dark[:, 32:] = (255, 0, 0)
    halves = PillowImage.fromarray(dark)
    seen = np.stack([panel_image_of(halves, SIZE, rng) for _ in range(100)]).astype(float)
    left, right = (seen[:, 22:26, column : column + 4].mean(axis=(1, 2)) for column in (12, 32))
    assert (right[:, 0] > left[:, 0] + 60).mean() > 0.9
    assert (right[:, 0] > right[:, 1] + 60).mean() > 0.9
    assert (left.max(axis=1) < 60).mean() > 0.9
    cat = picture("animal/cat@noto")
    panel_images = {panel_image_of(cat, SIZE, rng).tobytes() for _ in range(20)}
    assert len(panel_images) == 20


def test_a_crop_looks_like_the_label_that_its_attributes_name() -> None:
    """The nearest of a few pictures is the one that is named, for most crops."""
    labels = [f"letter/{name}@inter" for name in "OILXW"]
    ink = {label[7]: 255 - np.asarray(picture(label).convert("L").resize((32, 32)), float) for label in labels}
    panel_crops = PanelCrops(SIZE, INDEX.of, lambda rng: labels[rng.integers(5)])
    right = []
    for image, row in zip(*panel_crops.draw(np.random.default_rng(1), 40), strict=True):
        seen = np.asarray(PillowImage.fromarray(image).convert("L").crop((5, 5, 43, 43)).resize((32, 32)), float)
        near = {name: np.corrcoef(255 - seen.ravel(), other.ravel())[0, 1] for name, other in ink.items()}
        right.append(max(near, key=lambda name: near[name]) == ATTRIBUTES[row[CONCEPT]].rpartition(":")[2])
    assert np.mean(right) > 0.6


def test_everything_there_is_to_read_comes_up(panel_crops: PanelCrops) -> None:
    rng = np.random.default_rng(2)
    counts: Counter[str] = Counter()
    for _ in range(8):
        images, attributes = panel_crops.draw(rng, 50)
        assert (images.shape, images.dtype) == ((50, SIZE, SIZE, 3), np.uint8)
        counts.update(ATTRIBUTES[row[KIND]].partition("/")[2] for row in attributes)
    assert counts.keys() == {"sum", "several", "person", "thing", "letter", "number", "logo"}
    assert min(counts.values()) > 8


def test_many_hands_show_everything_and_what_is_not_to_be_named() -> None:
    rng = np.random.default_rng(2)
    made = PanelCrops(SIZE, INDEX.of, wider=WiderWorld())
    drawn = [made.draw(rng, 50) for _ in range(4)]
    kinds = Counter(ATTRIBUTES[row[KIND]].partition("/")[2] for _, attributes in drawn for row in attributes)
    assert kinds.keys() == {"sum", "several", "person", "thing", "letter", "number", "logo", "unknown"}
    for images, _ in drawn:
        assert (images.std(axis=(1, 2, 3)) > 1).mean() > 0.9


def test_what_is_unknown_has_that_kind_and_nothing_else() -> None:
    made = PanelCrops(SIZE, INDEX.of, lambda _: "unknown/picture", WiderWorld())
    images, attributes = made.draw(np.random.default_rng(0), 20)
    assert {tuple(row) for row in attributes} == {tuple(INDEX.of("unknown/picture"))}
    assert (attributes >= 0).sum() == 20
    assert len({image.tobytes() for image in images}) == 20


def test_the_same_seed_draws_the_same_crops_of_each_world(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_UNKNOWN", 0.0)

    def drawn(seed: int, wider: WiderWorld | None) -> list[bytes]:
        rng, made = np.random.default_rng(seed), PanelCrops(SIZE, INDEX.of, wider=wider)
        return [part.tobytes() for _ in range(2) for part in made.draw(rng, 16)]

    for wider in (None, WiderWorld()):
        assert drawn(3, wider) == drawn(3, wider) != drawn(4, wider)
    assert drawn(3, None) != drawn(3, WiderWorld())
