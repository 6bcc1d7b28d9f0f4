"""The network under training as a batched policy, for flights during training and for trials."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.labels import load_pack
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.words.text_encoder import TextEncoderModel, packed
from cognitivedrone.tasks import Suite
from cognitivedrone.training.perception.ground_truth import Poses
from cognitivedrone.training.trainer.precision import trains_in_bf16
from cognitivedrone.types import FloatArray, Image, StageResult


class NetworkPilot:
    """Batched policy of a network; its only inputs are images, motion and sentences."""

    def __init__(self, network: SmallVLA, encoder: Path | None) -> None:
        """`encoder` is the file of its text encoder, if it reads sentences."""
        self.network = network
        self._encoder = None if encoder is None else TextEncoderModel.load(encoder)

    def act(self, images: Image, states: NDArray[np.float32], texts: Sequence[str]) -> FloatArray:
        """The first actions (n, 4), m/s and rad/s, for images (n, 256, 256, 3), states (n, 5) and n sentences."""
        network = self.network
        device = next(network.parameters()).device
        arrays = [np.ascontiguousarray(images), states]
        if self._encoder is not None:
            arrays.append(packed([self._encoder.words(text) for text in texts]))
        training = network.training
        network.eval()
        with torch.no_grad(), torch.autocast(device.type, torch.bfloat16, enabled=trains_in_bf16()):
            actions, *_ = network(*(torch.from_numpy(array).to(device) for array in arrays))
        network.train(training)
        first: FloatArray = actions[:, 0].float().cpu().numpy()
        return first


def fly_suite(pilot: NetworkPilot, suite: Suite, config: TrackConfig, seed: int = 0) -> list[StageResult]:
    """Fly every track of a suite in closed loop, all together; results in the order of the suite."""
    with Worlds(len(suite.tracks), load_pack("open-v1"), config) as worlds:
        for world in range(len(suite.tracks)):
            worlds.begin(world, suite, world, seed)
        while flying := worlds.flying:
            flight = worlds.simulator.flight
            poses = Poses(flight.position, flight.quaternion, flight.velocity, flight.body_rates[:, 2])
            frames, states = worlds.simulator.frames(worlds=flying), poses.state()[flying]
            texts = [worlds.runners[world].task.instruction for world in flying]
            for begin in range(0, len(flying), 32):
                part = slice(begin, begin + 32)
                worlds.command(pilot.act(frames[part], states[part], texts[part]), flying[part])
            worlds.advance()
        return [result for runner in worlds.runners for result in runner.results]
