"""The manifest beside the shipped weights is of these files."""

import json
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))

import weights_manifest
from weights_manifest import MANIFEST, WEIGHTS, main


def test_the_manifest_is_of_the_shipped_files():
    assert main(["--check"]) == 0
    files = json.loads((WEIGHTS / MANIFEST).read_text(encoding="utf-8"))
    small = {f"small/{name}.onnx" for name in ("eyes", "gate_selector", "language", "model")}
    assert set(files) == {
        "concepts.onnx",
        "obstacles.onnx",
        "picture_classifier.onnx",
        "race/eyes.onnx",
        "race/model.onnx",
        "text_encoder.onnx",
        "word_pieces.onnx",
        *small,
    }
    for facts in files.values():
        assert len(facts["commit"]) == 40, "trained from a commit, with nothing changed"
        assert facts["steps"] > 0 or facts["recipe"] in ("classifier", "concepts"), "or taken as it was pretrained"


def test_other_weights_are_noticed(tmp_path, monkeypatch, capsys):
    weights = tmp_path / "weights"
    shutil.copytree(WEIGHTS, weights)
    monkeypatch.setattr(weights_manifest, "WEIGHTS", weights)
    shutil.copyfile(weights / "small" / "model.onnx", weights / "race" / "model.onnx")
    assert main(["--check"]) == 1
    assert "python scripts/weights_manifest.py" in capsys.readouterr().err
    main([])
    assert main(["--check"]) == 0
