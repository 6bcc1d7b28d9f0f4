"""The network under training as a batched policy, for flights during training and for trials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from cognitivedrone.envs.drone import clip_action
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.labels import load_pack
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.text import Lexicon
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite
from cognitivedrone.training.common.ground_truth import Poses
from cognitivedrone.training.common.precision import trains_in_bf16
from cognitivedrone.types import FloatArray, Image, StageResult


class NetworkPilot:
    """Batched policy of a network; its only inputs are images, motion and sentences."""

    def __init__(self, network: SmallVLA, lexicon: Lexicon) -> None:
        self.network = network
        self.lexicon = lexicon

    def act(self, images: Image, states: NDArray[np.float32], texts: Sequence[str]) -> FloatArray:
        """The first actions (n, 4), m/s and rad/s, for images (n, 256, 256, 3), states (n, 5) and n sentences."""
        network = self.network
        device = next(network.parameters()).device
        length = network.config.text_length
        tokens = np.stack([self.lexicon.encode(text, length) for text in texts])
        arrays = (np.ascontiguousarray(images), states, tokens)
        training = network.training
        network.eval()
        with torch.no_grad(), torch.autocast(device.type, torch.bfloat16, enabled=trains_in_bf16()):
            actions, *_ = network(*(torch.from_numpy(array).to(device) for array in arrays))
        network.train(training)
        first: FloatArray = actions[:, 0].float().cpu().numpy()
        return first


def fly_suite(pilot: NetworkPilot, suite: Suite, config: TrackConfig, seed: int = 0) -> list[StageResult]:
    """Fly every track of a suite in closed loop, all together; results in the order of the suite."""
    simulator = Simulator(len(suite.tracks))
    try:
        labels = load_pack("open-v1")
        track_runners = [TrackRunner(simulator.world(world), labels, config) for world in range(simulator.worlds)]
        for world, track_runner in enumerate(track_runners):
            track_runner.begin(suite.tracks[world], episode_rng(suite.digest, world, seed))
        while flying := [world for world, track_runner in enumerate(track_runners) if not track_runner.finished]:
            flight = simulator.flight
            poses = Poses(flight.position, flight.quaternion, flight.velocity, flight.body_rates[:, 2])
            frames, states = simulator.frames(worlds=flying), poses.state()[flying]
            texts = [track_runners[world].task.instruction for world in flying]
            for begin in range(0, len(flying), 32):
                part = slice(begin, begin + 32)
                actions = clip_action(pilot.act(frames[part], states[part], texts[part]))
                for world, action in zip(flying[part], actions, strict=True):
                    simulator.command(world, action)
            gate_events = simulator.advance()
            for world in flying:
                track_runners[world].update(gate_events[world])
        return [result for track_runner in track_runners for result in track_runner.results]
    finally:
        simulator.close()
