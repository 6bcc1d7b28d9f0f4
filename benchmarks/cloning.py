"""What a plain network of other people's learns from our data: behaviour cloning with Stable-Baselines3's own policy.

Run: python benchmarks/cloning.py STORE --out cloned.safetensors [--steps 4000]     (pip install stable-baselines3)

STORE is a folder of `cognitivedrone collect`. The network is `MultiInputActorCriticPolicy` as it is: NatureCNN for the
picture, (128, 128), beside the instruction's hashed words and the drone's motion, then two layers of 256. It learns
the expert's actions by their likelihood, as `imitation.algorithms.bc` does. Then it flies like any policy of one's own:

    PYTHONPATH=benchmarks cognitivedrone bench --policy cloning:Cloned:cloned.safetensors --suite open-v1:test
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from gymnasium import spaces
from PIL import Image as PillowImage
from safetensors.torch import load_model, save_model
from stable_baselines3.common.policies import MultiInputActorCriticPolicy

from cognitivedrone.data.store import Store
from cognitivedrone.envs.options import action_space
from cognitivedrone.interfaces import Policy
from cognitivedrone.models.words.text_encoder import VECTOR_SIZE, hash_instruction
from cognitivedrone.policies.small import state_of
from cognitivedrone.types import ActionChunk, EpisodeContext, FloatArray, Image, Observation

FACTOR = 2
"""By which pictures are shrunk."""
SPACE = spaces.Dict(
    {
        "image": spaces.Box(0, 255, (3, 256 // FACTOR, 256 // FACTOR), np.uint8),
        "words": spaces.Box(-1, 1, (VECTOR_SIZE,), np.float32),
        "motion": spaces.Box(-np.inf, np.inf, (5,), np.float32),
    }
)


@dataclass(frozen=True)
class Config:
    """What is learnt from, and for how long."""

    store: tyro.conf.Positional[Path]
    out: Path
    """File for the weights."""
    steps: int = 4000
    batch: int = 64
    seed: int = 0


def network() -> MultiInputActorCriticPolicy:
    """Untrained; Stable-Baselines3 shrinks it by itself to what it is given."""
    return MultiInputActorCriticPolicy(SPACE, action_space(), lambda _: 3e-4, net_arch={"pi": [256, 256], "vf": [1]})


def seen(images: list[Image], instructions: list[str], motion: FloatArray) -> dict[str, torch.Tensor]:
    """Observations of the network, for frames (n, 256, 256, 3) and motion (n, 5)."""
    small = [np.array(PillowImage.fromarray(image).reduce(FACTOR)) for image in images]
    words = [hash_instruction(text) for text in instructions]
    found = {"image": np.stack(small).transpose(0, 3, 1, 2), "words": np.stack(words), "motion": motion}
    return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in found.items()}


class Cloned(Policy):
    """Flies the trained network."""

    reads_english_only = True

    def __init__(self, path: Path) -> None:
        torch.set_num_threads(1)
        self._network = network()
        load_model(self._network, path)
        self._network.set_training_mode(False)

    @classmethod
    def file_of(cls, path: Path) -> Path:
        """The weights, which runs name by their hash."""
        return path

    def reset(self, context: EpisodeContext) -> None:
        """Nothing is remembered."""

    def act(self, observation: Observation) -> ActionChunk:
        """The likeliest action, (1, 4)."""
        with torch.inference_mode():
            given = seen([observation.image], [observation.instruction], state_of(observation)[None])
            action: ActionChunk = self._network.get_distribution(given).mode().numpy()
        return action


def main(config: Config) -> None:
    """Train, and print the loss; a file that is there already stays."""
    if config.out.exists():
        sys.exit(f"{config.out} is there already; give another --out")
    torch.manual_seed(config.seed)
    rng, store, learner = np.random.default_rng(config.seed), Store.open(config.store), network()
    numbers = store.step_numbers("train")
    began, losses = time.monotonic(), []
    for step in range(1, config.steps + 1):
        batch: Any = store.steps(rng.choice(numbers, config.batch))
        _, likelihood, entropy = learner.evaluate_actions(
            seen(list(batch["image"]), batch["instruction"], batch["state"]), torch.from_numpy(batch["action"])
        )
        loss = -likelihood.mean() - 1e-3 * (entropy.mean() if entropy is not None else 0.0)
        learner.optimizer.zero_grad()
        loss.backward()
        learner.optimizer.step()
        losses.append(loss.item())
        if step in (1, 20) or step % 200 == 0:
            minutes = (time.monotonic() - began) / 60
            print(f"{step:6} steps, {minutes:5.1f} min: loss {np.mean(losses[-200:]):.3f}", flush=True)
    save_model(learner, str(config.out))


if __name__ == "__main__":
    main(tyro.cli(Config))
