"""LeRobot's checkpoints as policies. What loads one needs the package lerobot, in an environment of its own."""

import importlib.util
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cognitivedrone.data.formats.lerobot_files import DOWN_KEY, IMAGE_KEY, feature_spec
from cognitivedrone.errors import MissingExtra, ModelError, PolicyError
from cognitivedrone.policies import lerobot, make_policy, policy_files
from cognitivedrone.policies.lerobot import FILES, SHAPES, WEIGHTS, check_features
from cognitivedrone.types import EpisodeContext, Observation

CONFIG: dict[str, Any] = {
    "type": "act",
    "input_features": {
        "observation.images.front": {"type": "VISUAL", "shape": [3, 256, 256]},
        "observation.state": {"type": "STATE", "shape": [5]},
    },
    "output_features": {"action": {"type": "ACTION", "shape": [4]}},
}


def folder_of(path, config):
    path.mkdir(exist_ok=True)
    for name in FILES:
        (path / name).write_text(json.dumps(config) if name == "config.json" else "{}")
    (path / WEIGHTS).write_bytes((2).to_bytes(8, "little") + b"{}")  # safetensors of no tensor
    return path


def test_its_features_are_those_of_our_export():
    exported = feature_spec(video=False, words=True)
    assert (lerobot.IMAGE_KEY, lerobot.DOWN_KEY) == (IMAGE_KEY, DOWN_KEY)
    assert {key: list(shape) for key, shape in SHAPES.items()} == {key: exported[key]["shape"] for key in SHAPES}


def test_its_weights_are_part_of_a_runs_identity(tmp_path):
    assert policy_files(f"lerobot:{folder_of(tmp_path, CONFIG)}") == (tmp_path / WEIGHTS,)


def test_weights_are_looked_at_before_a_run_hashes_them(tmp_path):
    with (folder_of(tmp_path, CONFIG) / WEIGHTS).open("wb") as file:
        file.truncate(2**40)  # sparse
    with pytest.raises(ModelError, match="is not a safetensors file"):
        policy_files(f"lerobot:{tmp_path}")


def test_a_folder_that_is_no_checkpoint_is_refused(tmp_path):
    with pytest.raises(ModelError, match="no LeRobot checkpoint: it has no config"):
        policy_files(f"lerobot:{tmp_path}")
    (tmp_path / "last" / "pretrained_model").mkdir(parents=True)
    with pytest.raises(ModelError, match=r"give .*last/pretrained_model$"):
        make_policy(f"lerobot:{tmp_path / 'last'}")


def test_pickled_weights_are_no_checkpoint(tmp_path):
    (folder_of(tmp_path, CONFIG) / WEIGHTS).rename(tmp_path / "pytorch_model.bin")
    with pytest.raises(ModelError, match="it has no model"):
        make_policy(f"lerobot:{tmp_path}")


@pytest.mark.parametrize(
    ("kind", "key", "feature"),
    [
        ("input_features", "observation.images.wrist", {"type": "VISUAL", "shape": [3, 256, 256]}),
        ("input_features", "observation.state", {"type": "STATE", "shape": [14]}),
        ("output_features", "action", {"type": "ACTION", "shape": [7]}),
    ],
)
def test_a_policy_for_another_robot_is_refused(tmp_path, kind, key, feature):
    config = {**CONFIG, kind: {**CONFIG[kind], key: feature}}
    with pytest.raises(ModelError, match=f"a policy with {key} .*train it on a LeRobot export"):
        make_policy(f"lerobot:{folder_of(tmp_path, config)}")


@pytest.mark.parametrize("missing", ["input_features", "output_features"])
def test_a_policy_without_image_or_action_is_refused(tmp_path, missing):
    with pytest.raises(ModelError, match="train on our LeRobot export"):
        check_features(tmp_path, {**CONFIG, missing: None})


@pytest.mark.parametrize("text", ["[1]", "{", "\x00", "[" * 200_000, '{"x": ' + "9" * 10_000 + "}", " " * (2 << 20)])
def test_a_config_that_cannot_be_read_is_refused(tmp_path, text):
    (folder_of(tmp_path, CONFIG) / "config.json").write_text(text)
    with pytest.raises(ModelError, match="copy it again"):
        make_policy(f"lerobot:{tmp_path}")


@pytest.mark.skipif(importlib.util.find_spec("lerobot") is not None, reason="lerobot is installed")
def test_without_lerobot_the_command_that_installs_it_is_reported(tmp_path):
    with pytest.raises(MissingExtra, match=r"is not installed; it comes with cognitivedrone\[lerobot\]"):
        make_policy(f"lerobot:{folder_of(tmp_path, CONFIG)},device=cpu")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """A small ACT policy with random weights, saved by LeRobot itself."""
    import torch

    pytest.importorskip("lerobot", reason="lerobot is not installed (docs/gymnasium.md)")
    from lerobot_checkpoints import save_act

    torch.manual_seed(0)
    return save_act(tmp_path_factory.mktemp("act"))


def seen(pixels=0, time=0.0, velocity=0.0):
    image = np.full((256, 256, 3), pixels, np.uint8)
    return Observation(image, "Fly through the red gate", np.full(3, velocity, np.float32), 0.8, 0.1, time)


def answers(policy, observations, stage=0):
    policy.reset(EpisodeContext("Fly through the red gate", stage=stage))
    return [policy.act(observation)[0] for observation in observations]


def test_a_checkpoint_flies(checkpoint):
    policy = make_policy(f"lerobot:{checkpoint},device=cpu")
    policy.check()
    policy.reset(EpisodeContext("Fly through the red gate"))
    action = policy.act(seen())
    assert (action.shape, action.dtype) == ((1, 4), np.float32)
    assert np.isfinite(action).all()
    with pytest.raises(PolicyError, match="uint8 images of shape"):
        policy.act(Observation(np.zeros((64, 64, 3), np.uint8), "x", np.zeros(3, np.float32), 0.8, 0.0, 0.0))


def test_it_plays_its_chunk_and_a_new_stage_drops_the_rest(checkpoint):
    policy = make_policy(f"lerobot:{checkpoint},device=cpu")
    first, other = seen(10), seen(200, velocity=1.0)
    played = answers(policy, [first, other, other, other])
    assert not np.array_equal(played[0], played[1]), "the second command of the chunk"
    again = answers(policy, [first, first, first, first], stage=1)
    assert np.array_equal(played, again), "within a chunk it does not look"
    assert not np.array_equal(answers(policy, [other])[0], played[0]), "but a reset makes it look again"


def test_it_answers_what_lerobots_own_pipeline_answers(checkpoint):
    import torch
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.envs.utils import preprocess_observation
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    config = PreTrainedConfig.from_pretrained(str(checkpoint))
    theirs = get_policy_class(config.type).from_pretrained(str(checkpoint))
    before, after = make_pre_post_processors(config, pretrained_path=str(checkpoint))
    image = np.random.default_rng(0).integers(0, 256, (256, 256, 3)).astype(np.uint8)
    observation = Observation(image, "Fly", np.array([1, 0.1, -0.2], np.float32), 0.8, 0.1, 0.0)
    batch = preprocess_observation(
        {"pixels": {"front": image[None]}, "agent_pos": np.array([[1, 0.1, -0.2, 0.8, 0.1]], np.float32)}
    )
    with torch.inference_mode():
        expected = after(theirs.select_action(before({**batch, "task": ["Fly"]}))).numpy()
    ours = make_policy(f"lerobot:{checkpoint},device=cpu")
    ours.reset(EpisodeContext("Fly"))
    assert np.array_equal(ours.act(observation), expected)


def test_a_checkpoint_that_looks_down_sees_both_cameras(checkpoint, tmp_path):
    from lerobot_checkpoints import save_act

    assert not make_policy(f"lerobot:{checkpoint},device=cpu").needs_down_camera
    policy = make_policy(f"lerobot:{save_act(tmp_path, down=True)},device=cpu")
    assert policy.needs_down_camera
    light, dark = (np.full((256, 256, 3), pixels, np.uint8) for pixels in (255, 0))
    below = [answers(policy, [replace(seen(), down=image)])[0] for image in (light, dark, light)]
    assert np.array_equal(below[0], below[2])
    assert not np.array_equal(below[0], below[1])
    with pytest.raises(PolicyError, match="needs the camera that looks down"):
        policy.act(seen())


def test_a_damaged_checkpoint_is_reported_with_lerobots_version(checkpoint, tmp_path):
    for file in checkpoint.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / WEIGHTS).write_bytes(b"\x00" * 64)
    with pytest.raises(ModelError, match=r"cannot be loaded by lerobot \d+\.\d+"):
        make_policy(f"lerobot:{tmp_path},device=cpu")


@pytest.mark.parametrize(
    "feature", [7, None, "nonsense", {"shape": 7}, {"shape": True}, {"shape": ["x"]}, {"shape": 1e300}]
)
def test_a_feature_of_another_form_is_told_in_one_sentence(tmp_path, feature):
    with pytest.raises(ModelError, match=r"config\.json: .*must be"):
        check_features(
            tmp_path, {**CONFIG, "input_features": {**CONFIG["input_features"], "observation.state": feature}}
        )
