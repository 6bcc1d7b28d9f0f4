import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from cognitivedrone.data.formats import rlds

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "openvla_registration.py"


@pytest.fixture
def example():
    spec = importlib.util.spec_from_file_location("openvla_registration", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def materialize():
    """Stands in for OpenVLA's module: an own factory, looked up by name at every call."""
    module = ModuleType("materialize")
    module.make_oxe_dataset_kwargs = lambda name, *_args, **_kwargs: {"name": name, "theirs": True}
    return module


def test_our_name_is_registered_and_others_stay(example, materialize):
    example.register(materialize)
    assert materialize.make_oxe_dataset_kwargs("bridge_orig", "data") == {"name": "bridge_orig", "theirs": True}
    kwargs = materialize.make_oxe_dataset_kwargs("cognitivedrone", "data", ("primary",), False, False, True, "q99")
    assert (kwargs["name"], kwargs["data_dir"]) == (rlds.NAME, "data")
    assert kwargs["action_proprio_normalization_type"] == "q99"
    assert "state_obs_keys" not in kwargs


def test_the_keys_are_those_of_the_export(example):
    kwargs = example.dataset_kwargs("data")
    steps = rlds.feature_spec("jpeg")["featuresDict"]["features"]["steps"]["sequence"]["feature"]
    features = steps["featuresDict"]["features"]
    observation = features["observation"]["featuresDict"]["features"]
    assert set(kwargs["image_obs_keys"].values()) <= set(observation)
    assert set(kwargs["state_obs_keys"]) <= set(observation)
    assert kwargs["language_key"] in features
    (size,) = features["action"]["tensor"]["shape"]["dimensions"]
    assert len(kwargs["absolute_action_mask"]) == len(kwargs["action_normalization_mask"]) == int(size)


def test_only_our_camera_can_be_asked_for(example):
    with pytest.raises(ValueError, match="one colour camera"):
        example.dataset_kwargs("data", ("primary", "wrist"))


def test_their_script_runs_with_the_data_set_registered(example, materialize, tmp_path, monkeypatch):
    script = tmp_path / "finetune.py"
    script.write_text(
        "import json, sys\n"
        f"from {example.MATERIALIZE} import make_oxe_dataset_kwargs\n"
        "name = make_oxe_dataset_kwargs('cognitivedrone', 'out')['data_dir']\n"
        f"with open({str(tmp_path / 'seen')!r}, 'w') as file:\n"
        "    json.dump([name, sys.argv[1:], __name__], file)\n"
    )
    parts = example.MATERIALIZE.split(".")
    for depth in range(1, len(parts)):
        monkeypatch.setitem(sys.modules, ".".join(parts[:depth]), ModuleType(parts[depth - 1]))
    monkeypatch.setitem(sys.modules, example.MATERIALIZE, materialize)
    monkeypatch.setattr("sys.argv", [])
    monkeypatch.setattr("sys.path", [])
    example.main(str(script), "--lora_rank", "32")
    assert json.loads((tmp_path / "seen").read_text()) == ["out", ["--lora_rank", "32"], "__main__"]
