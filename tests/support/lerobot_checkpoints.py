"""Checkpoints that LeRobot itself writes, small enough for tests."""

from pathlib import Path

import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

INPUTS = {
    "observation.images.front": PolicyFeature(type=FeatureType.VISUAL, shape=(3, 256, 256)),
    "observation.state": PolicyFeature(type=FeatureType.STATE, shape=(5,)),
}
DOWN = "observation.images.down"
OUTPUTS = {"action": PolicyFeature(type=FeatureType.ACTION, shape=(4,))}


def save_act(folder: Path, *, down: bool = False) -> Path:
    """An ACT policy with random weights that plays chunks of four, and may see downwards, too; returns its folder."""
    inputs = INPUTS | ({DOWN: INPUTS["observation.images.front"]} if down else {})
    config = ACTConfig(
        input_features=inputs, output_features=OUTPUTS, device="cpu", chunk_size=4, n_action_steps=4,
        dim_model=32, n_heads=2, dim_feedforward=32, n_encoder_layers=1, n_vae_encoder_layers=1, latent_dim=4,
        pretrained_backbone_weights=None,
    )  # fmt: skip
    policy = ACTPolicy(config)
    sizes = {"observation.state": (5,), "action": (4,)}
    stats = {
        key: {"mean": torch.zeros(size), "std": torch.ones(size)}
        for key, size in {**dict.fromkeys(inputs, (3, 1, 1)), **sizes}.items()
    }
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    policy.save_pretrained(folder)
    before.save_pretrained(folder)
    after.save_pretrained(folder)
    return folder
