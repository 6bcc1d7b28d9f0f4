"""Policies trained with LeRobot, from their checkpoints: ACT, diffusion, SmolVLA and every other that LeRobot knows.

A checkpoint is the folder `pretrained_model` that `lerobot-train` writes: config.json, model.safetensors, and the
normalisation as policy_preprocessor.json and policy_postprocessor.json with their .safetensors. Only these are read;
nothing is unpickled or downloaded. The policy must take the features of our LeRobot export (docs/data.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cognitivedrone.errors import MissingExtra, ModelError, PolicyError, import_extra
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.files.schema import check_form
from cognitivedrone.interfaces import Policy
from cognitivedrone.models.compiling import in_memory, why_none
from cognitivedrone.models.openvla.checkpoint import read_header
from cognitivedrone.models.words.text_encoder import VECTOR_SIZE, hash_instruction
from cognitivedrone.policies.small import state_of
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.text.printable import visible
from cognitivedrone.types import IMAGE_SIZE, ActionChunk, EpisodeContext, Observation

EXTRA = "lerobot"
IMAGE_KEY, STATE_KEY, ACTION_KEY = "observation.images.front", "observation.state", "action"
DOWN_KEY, WORDS_KEY = "observation.images.down", "observation.environment_state"
SHAPES = {STATE_KEY: (5,), ACTION_KEY: (4,), WORDS_KEY: (VECTOR_SIZE,)}
_IMAGE = (IMAGE_SIZE, IMAGE_SIZE, 3)
WEIGHTS = "model.safetensors"
MAX_CONFIG_BYTES = 1 << 20
"""Maximum size of config.json, bytes."""
FILES = ("config.json", WEIGHTS, "policy_preprocessor.json", "policy_postprocessor.json")


class LeRobot(Policy):
    """Flies the LeRobot checkpoint in `folder`, on a GPU if there is one, or on `device`.

    As in `lerobot-eval`, it is asked at every control step and plays its own chunk of actions. Here a new stage also
    resets it, because the rest of the chunk belongs to the old instruction. One that was trained with the camera that
    looks down flies where there is one, one of an export with words gets the instruction as a vector, too.
    Raises `ModelError` for a folder that is no checkpoint, or one for other cameras, states or actions;
    `MissingExtra` if LeRobot is not installed.
    """

    on_card = True

    def __init__(self, folder: Path, *, device: Literal["cuda", "cpu"] | None = None) -> None:
        self.folder = Path(folder)
        config = read_config(self.folder)
        check_features(self.folder, config)
        self.needs_down_camera = DOWN_KEY in _features(config, "input_features")
        self._reads_words = WORDS_KEY in _features(config, "input_features")
        torch = import_extra("torch", EXTRA)
        self._torch = torch
        name = device or ("cuda" if torch.cuda.is_available() else "cpu")
        if name == "cuda" and not torch.cuda.is_available():
            fault = why_none(torch)
            raise ModelError(f"device=cuda, but this machine has no GPU that PyTorch can use; leave it out{fault}")
        with in_memory(ModelError, "policy lerobot", ", or give device=cpu"):
            self._policy, self._before, self._after = _loaded(self.folder, name)

    @classmethod
    def file_of(cls, folder: Path, *, device: str | None = None) -> Path:  # noqa: ARG003
        """The checkpoint's weights; raises `ModelError` if they are missing or cut short."""
        read_config(Path(folder))
        read_header(Path(folder) / WEIGHTS)  # a run hashes it before it is loaded, however large it is
        return Path(folder) / WEIGHTS

    def reset(self, context: EpisodeContext) -> None:
        """Forget the rest of the chunk."""
        self._policy.reset()

    def act(self, observation: Observation) -> ActionChunk:
        """The next command, (1, 4); raises `PolicyError` for an image that is not uint8 (256, 256, 3)."""
        torch = self._torch
        cameras = {IMAGE_KEY: observation.image}
        if self.needs_down_camera:
            if observation.down is None:
                raise PolicyError("the policy needs the camera that looks down, and there is none")
            cameras[DOWN_KEY] = observation.down
        for image in cameras.values():
            if image.dtype != np.uint8 or image.shape != _IMAGE:
                raise PolicyError(f"the policy needs uint8 images of shape {_IMAGE}, got {image.dtype} {image.shape}")
        with torch.inference_mode():
            pictures = {
                key: torch.from_numpy(image)[None].permute(0, 3, 1, 2).contiguous().float() / 255
                for key, image in cameras.items()
            }
            state = torch.from_numpy(state_of(observation))[None]
            words = torch.from_numpy(hash_instruction(observation.instruction))[None]
            numbers = {STATE_KEY: state} | ({WORDS_KEY: words} if self._reads_words else {})
            seen = self._before({**pictures, **numbers, "task": [observation.instruction]})
            action: ActionChunk = self._after(self._policy.select_action(seen)).cpu().float().numpy()
        return action


def read_config(folder: Path) -> dict[str, Any]:
    """config.json of a checkpoint; raises `ModelError` if the folder is no checkpoint."""
    if (folder / "pretrained_model").is_dir():
        raise ModelError(f"{folder} is a folder of a training run; give {folder / 'pretrained_model'}")
    if missing := [name for name in FILES if not (folder / name).is_file()]:
        raise ModelError(
            f"{folder} is no LeRobot checkpoint: it has no {missing[0]}; give the folder pretrained_model that"
            " lerobot-train wrote, or a local copy of one"
        )
    try:
        config = parse_json(read_regular(folder / FILES[0], MAX_CONFIG_BYTES), non_finite=True)
    except (OSError, ValueError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else visible(str(error))
        raise ModelError(f"{folder / FILES[0]} cannot be read ({reason}); copy it again") from None
    if not isinstance(config, dict):
        raise ModelError(f"{folder / FILES[0]} is not an object; copy it again")
    return config


@dataclass(frozen=True, slots=True)
class _Feature:
    """What config.json says of an input or an output."""

    shape: tuple[int, ...] = ()


def check_features(folder: Path, config: dict[str, Any]) -> None:
    """Raises `ModelError` unless the policy takes what our drone sees and answers what it flies."""
    features = {**_features(config, "input_features"), **_features(config, "output_features")}
    check_form(dict[str, _Feature], features, f"{folder / FILES[0]}: ", ModelError)
    for key, feature in features.items():
        shape = tuple(feature.get("shape", ()))
        if key not in (IMAGE_KEY, DOWN_KEY) and shape != SHAPES.get(key):
            raise ModelError(
                f"{folder} is a policy with {visible(key[:80])} {shape}; ours has {IMAGE_KEY}, {STATE_KEY} (5,) and"
                f" {ACTION_KEY} (4,): train it on a LeRobot export of this package (docs/data.md)"
            )
    if ACTION_KEY not in features or IMAGE_KEY not in features:
        raise ModelError(f"{folder / FILES[0]} names no {IMAGE_KEY} or no {ACTION_KEY}; train on our LeRobot export")


def _features(config: dict[str, Any], key: str) -> dict[str, Any]:
    features = config.get(key)
    return features if isinstance(features, dict) else {}


def _loaded(folder: Path, device: str) -> tuple[Any, Any, Any]:
    """The policy, its preprocessor and its postprocessor."""
    import_extra("lerobot", EXTRA)
    try:
        configs = import_extra("lerobot.configs.policies", EXTRA)
        factory = import_extra("lerobot.policies.factory", EXTRA)
        import_extra("lerobot.utils.import_utils", EXTRA).register_third_party_plugins()
        config = configs.PreTrainedConfig.from_pretrained(str(folder))
        config.device = device
        if hasattr(config, "pretrained_backbone_weights"):
            config.pretrained_backbone_weights = None  # else it downloads weights that the checkpoint replaces
        policy = factory.get_policy_class(config.type).from_pretrained(str(folder), config=config)
        before, after = factory.make_pre_post_processors(
            config, pretrained_path=str(folder), preprocessor_overrides={"device_processor": {"device": device}}
        )
    except MissingExtra:
        raise
    except Exception as error:  # of many kinds: a checkpoint of another version, packages that do not fit together
        raise ModelError(
            f"{folder} cannot be loaded by lerobot {version('lerobot')}: {type(error).__name__}: {str(error)[:200]};"
            " serve it from an environment with the version that trained it (docs/gymnasium.md)"
        ) from error
    policy.eval()
    return policy, before, after
