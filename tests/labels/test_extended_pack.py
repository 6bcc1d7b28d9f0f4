"""The pack open-v2: all of open-v1 unchanged, further sets of drawings and further artists of people."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import cognitivedrone.labels
from cognitivedrone.errors import LabelError
from cognitivedrone.labels import EXTENDED_PACKS, load_pack

PACKS = Path(cognitivedrone.labels.__file__).parent / "packs"


@pytest.fixture(scope="module")
def pack():
    return load_pack("open-v2")


def test_open_v1_is_as_it_was(pack):
    old = load_pack("open-v1")
    assert old.digest == "c31d1d699ec45ba0951d8ade7ff6a6c32dc8caf9847ccd499f1e9a9e65599371"
    for label in ("animal/cat@noto", "logo/git@color", "food/pie@openmoji", "sum/7*9@inter", "person/hair=afro@sky"):
        np.testing.assert_array_equal(pack.image(label), old.image(label))
    assert pack.kinds() == old.kinds()
    for kind in old.kinds():
        assert pack.concepts(kind) == old.concepts(kind)
        assert pack.styles(kind)[: len(old.styles(kind))] == old.styles(kind)


def test_a_drawing_is_a_panel_on_white(pack):
    image = pack.image("animal/owl@icon-park")
    assert image.shape == (256, 256, 3)
    assert image.dtype == np.uint8
    assert not image.flags.writeable
    assert image[:4].min() > 240
    assert image.std() > 5
    assert (pack.image("animal/cat@game") != pack.image("animal/cat@lucide")).any()
    assert (pack.image("animal/cat@arcticons") != pack.image("animal/cat@arcticons~1")).any()
    assert pack.image("several/animal/cat=3@emojione").std() > 5


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("animal/llama@lucide", "no such cut-out drawing"),
        ("animal/cat@game~9", "no such cut-out drawing"),
        ("animal/cat@game~0", "no such cut-out drawing"),
        ("animal/cat@game~01", "no such cut-out drawing"),
        ("animal/cat@gam", "no style 'gam'"),
        ("animal/dragon@game", "no such cut-out drawing"),
        ("person/hair=afro@toon-head-sky", "toon-head draws no hair 'afro'"),
        ("person/hair=long@toon-head-nowhere", "no background 'nowhere'"),
        ("person/hair=log@toon-head-sky", "hair cannot be 'log'"),
    ],
)
def test_what_is_missing_is_named(pack, label, message):
    with pytest.raises(LabelError, match=message):
        pack.image(label)


def test_the_same_pack_comes_out_of_a_pickle(pack):
    assert pickle.loads(pickle.dumps(pack)) is pack  # noqa: S301


@pytest.mark.parametrize("name", EXTENDED_PACKS)
def test_the_manifest_has_a_source_for_every_set_and_artist(name):
    manifest = json.loads((PACKS / name / "manifest.json").read_text(encoding="utf-8"))
    described = {source["used_for"].removeprefix("@") for source in manifest["sources"]}
    # Pictures of unknown things are taken from the other sets.
    assert described == {*manifest["sets"], *manifest["hands"]} - {"others", "others-held-out"}
