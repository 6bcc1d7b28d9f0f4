"""Damage to a model file is found when it is loaded; the full table is printed by benchmarks/faults_input.py."""

import json
import shutil
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest
from tiny import DESCRIPTION, graph, tiny_eyes, tiny_model

from cognitivedrone.errors import PolicyError
from cognitivedrone.models.eyes.obstacle_eye import ObstacleEye
from cognitivedrone.models.eyes.picture_classifier import PictureClassifier
from cognitivedrone.models.eyes.sight import EyesModel
from cognitivedrone.models.mind import Mind
from cognitivedrone.models.onnx_file import BLANK, KEY, MARK, check, seal
from cognitivedrone.models.small_file import KIND, SmallModel, describe, read_description
from cognitivedrone.models.words.concepts import ConceptsModel
from cognitivedrone.models.words.selector_file import GateSelectorModel
from cognitivedrone.models.words.text_encoder import TextEncoderModel
from cognitivedrone.models.words.word_pieces import WordPieces

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import faults_input

WEIGHTS = faults_input.WEIGHTS


def old_model(path: Path) -> Path:
    """A file as it was written before there were checksums."""
    model = graph()
    onnx.helper.set_model_props(model, {KEY: json.dumps({"format": 1, "kind": KIND, **DESCRIPTION.table()})})
    onnx.save(model, str(path))
    tiny_eyes(path.parent)
    return path


def test_a_sample_of_damaged_files_is_found(tmp_path: Path) -> None:
    found = faults_input.weight_files(120, seed=1, folder=tmp_path)
    assert len(found) == len(faults_input.DAMAGES)
    assert faults_input.bad(found, {"found"}) == 0


@pytest.mark.parametrize(
    ("name", "load"),
    [
        ("small/model.onnx", read_description),
        ("race/model.onnx", read_description),
        ("small/eyes.onnx", EyesModel.load),
        ("picture_classifier.onnx", PictureClassifier.load),
        ("concepts.onnx", ConceptsModel.load),
        ("obstacles.onnx", ObstacleEye.load),
        ("small/gate_selector.onnx", GateSelectorModel.load),
        ("small/language.onnx", Mind.load),
        ("text_encoder.onnx", TextEncoderModel.load),
        ("word_pieces.onnx", WordPieces.load),
    ],
)
def test_a_shipped_file_is_known_wherever_it_is_and_whole(
    tmp_path: Path, name: str, load: Callable[[Path], object]
) -> None:
    assert check((WEIGHTS / name).read_bytes()) == "sound"
    copy = tmp_path / "anything.onnx"
    shutil.copyfile(WEIGHTS / name, copy)
    load(copy)
    content = bytearray(copy.read_bytes())
    content[len(content) // 2] ^= 1  # in the middle of the weights
    copy.write_bytes(content)
    with pytest.raises(PolicyError, match=r"anything\.onnx does not match its checksum, so it is damaged"):
        load(copy)


def test_every_byte_of_a_new_file_is_covered(tmp_path: Path) -> None:
    path = tiny_model(tmp_path / "model.onnx")
    whole = path.read_bytes()
    assert check(whole) == "sound"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for at in range(0, len(whole), 7):
            damaged = bytearray(whole)
            damaged[at] ^= 1 << at % 8
            path.write_bytes(damaged)
            with pytest.raises(PolicyError) as told:
                SmallModel.load(path)
            assert "\n" not in str(told.value)


def test_a_file_of_an_older_version_is_flown_with_one_warning(tmp_path: Path) -> None:
    path = old_model(tmp_path / "old.onnx")
    with pytest.warns(UserWarning, match="checksums") as told:
        model = SmallModel.load(path)
    assert [str(warning.message) for warning in told] == [
        f"{path} was written before model files had checksums: damage to it would not be noticed"
    ]
    assert model.description == DESCRIPTION
    with pytest.warns(UserWarning, match="before model files had checksums"):
        assert read_description(path) == DESCRIPTION


def test_describing_an_older_file_gives_it_a_checksum(tmp_path: Path) -> None:
    path = old_model(tmp_path / "old.onnx")
    describe(path, DESCRIPTION)
    assert check(path.read_bytes()) == "sound"
    assert SmallModel.load(path).description == DESCRIPTION


def test_sealing_needs_one_empty_place(tmp_path: Path) -> None:
    path = tmp_path / "file"
    for content in (b"nothing", BLANK.encode() * 2):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="exactly once"):
            seal(path)
    path.write_bytes(b"before" + BLANK.encode() + b"after")
    seal(path)
    assert path.read_bytes().startswith(b"before" + MARK.encode())
    assert check(path.read_bytes()) == "sound"
    assert check(path.read_bytes() + b" ") == "damaged"
