"""Latency and memory of OpenVLA-7B on a GPU, with random weights: nothing needs to be downloaded.

Run: python benchmarks/openvla_gpu.py [--steps 200] [--lora]

For each decoder and quantisation, prints median and 99th percentile of a whole control step (preparation, network,
answer back on the host), the rate, its ratio to the 10 Hz of the paper, and the peak GPU memory in flight. With --lora,
samples a second and peak memory of LoRA steps (rank 32, all linear layers, checkpointing) at several batch sizes, which
needs peft. On a machine without a GPU it says so and runs the tiny network, which tells nothing about the large one.
"""

from __future__ import annotations

import argparse
import gc
import importlib.util
import platform
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import get_args

import numpy as np
import torch
import transformers

from cognitivedrone.errors import MissingExtra
from cognitivedrone.models.openvla.checkpoint import Quantisation
from cognitivedrone.models.openvla.config import Config, tiny_config
from cognitivedrone.models.openvla.decode import Autoregressive, Decoder, Parallel, greedy_tokens
from cognitivedrone.models.openvla.network import IGNORED, OpenVlaNetwork
from cognitivedrone.models.openvla.prepare import ImagePreparation
from cognitivedrone.models.openvla.weights import quantise, random_network
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE

CHUNK = 8
PROMPT = [1, *range(500, 527), 29_871]
"""As many tokens as "Fly through the small red round gate" makes."""
BATCHES = (1, 4, 8, 16)


class WithoutGraph:
    """The autoregressive decoder as PyTorch runs it by itself, each kernel launched by the host."""

    def __init__(self, network: OpenVlaNetwork) -> None:
        self._network = network

    def __call__(self, pixel_values: np.ndarray, input_ids: list[int]) -> np.ndarray:
        """Ids (4,) of the words."""
        weight = self._network.projector.fc1.bias
        with torch.inference_mode():
            pixels = torch.from_numpy(pixel_values)[None].to(weight.device, weight.dtype)
            ids = torch.tensor([input_ids], device=weight.device)
            count = torch.tensor([len(input_ids)], device=weight.device)
            return greedy_tokens(self._network, pixels, ids, count).cpu().numpy()


def milliseconds(decode: Decoder, steps: int) -> np.ndarray:
    """Of `steps` control steps, each to its end, after a warm-up."""
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (8, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
    prepare = ImagePreparation().pixel_values
    times = []
    for step in range(steps + 5):
        begin = time.perf_counter()
        decode(prepare(frames[step % len(frames)]), PROMPT)
        times.append((time.perf_counter() - begin) * 1e3)
    return np.array(times[5:])


def report(name: str, times: np.ndarray, peak: int | None, actions: int) -> None:
    median, slow = np.percentile(times, [50, 99])
    memory = "" if peak is None else f"{peak / 1e9:8.1f} GB"
    rate = 1e3 / median
    print(f"{name:26} {median:8.1f} {slow:8.1f} ms {rate:8.1f} Hz {rate / CONTROL_HZ:6.1f} x {actions:3}{memory}")


def network_of(quantisation: Quantisation) -> OpenVlaNetwork:
    network = random_network(Config(chunk=CHUNK), "cuda", torch.bfloat16)
    quantise(network, quantisation, "cuda")
    return network


def flying(steps: int) -> None:
    for quantisation in get_args(Quantisation):
        try:
            network = network_of(quantisation)
        except MissingExtra as error:
            print(f"{quantisation}: not measured, {error}")
            continue
        for name, make, actions in decoders(compiled=quantisation != "none"):
            if name == "ar, without its graph" and quantisation != "none":
                continue
            gc.collect()
            torch.cuda.empty_cache()
            torch.cuda.reset_peak_memory_stats()
            times = milliseconds(make(network), steps)
            report(f"{quantisation} {name}", times, torch.cuda.max_memory_allocated(), actions)
        del network


def decoders(*, compiled: bool) -> Iterator[tuple[str, Callable[[OpenVlaNetwork], Decoder], int]]:
    """Name, maker, and the actions that a step gives."""
    yield "ar, without its graph", WithoutGraph, 1
    yield "ar", lambda network: Autoregressive(network, compiled=compiled), 1
    yield "parallel", lambda network: Parallel(network, compiled=compiled), CHUNK


def training() -> None:
    if importlib.util.find_spec("peft") is None:
        print("LoRA: not measured, peft is not installed")
        return
    from cognitivedrone.training.openvla_adapters import add_adapters
    from cognitivedrone.training.openvla_recipes import PAPER

    gc.collect()
    network = random_network(Config(), "cuda", torch.bfloat16)
    network.enable_checkpointing()
    trained = add_adapters(network, PAPER)
    network.train()
    optimizer = torch.optim.AdamW(trained.values(), PAPER.learning_rate, weight_decay=PAPER.weight_decay, fused=True)
    for batch in BATCHES:
        ids = torch.tensor([[*PROMPT, 31_800, 31_850, 31_900, 31_750, 2]], device="cuda").repeat(batch, 1)
        labels = ids.clone()
        labels[:, : len(PROMPT)] = IGNORED
        pixels = torch.randn(batch, 6, 224, 224, device="cuda", dtype=torch.bfloat16)
        times = []
        torch.cuda.reset_peak_memory_stats()
        for _ in range(6):
            torch.cuda.synchronize()
            begin = time.perf_counter()
            with torch.autocast("cuda", torch.bfloat16):
                loss = network(ids, pixels, labels=labels).loss
            loss.backward()
            optimizer.step()
            optimizer.zero_grad()
            torch.cuda.synchronize()
            times.append(time.perf_counter() - begin)
        rate, peak = batch / float(np.median(times[2:])), torch.cuda.max_memory_allocated()
        print(f"LoRA, batch {batch:3}            {rate:8.2f} samples/s {peak / 1e9:27.1f} GB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--lora", action="store_true")
    options = parser.parse_args()
    versions = f"torch {torch.__version__}, transformers {transformers.__version__}, {datetime.now(UTC):%Y-%m-%d}"
    print(f"{'':26} {'median':>8} {'p99':>8}    {'rate':>8}    {'to 10 Hz':>8} actions, peak memory")
    if not torch.cuda.is_available():
        print(f"no GPU here ({platform.machine()}, {versions}): the tiny network, which tells nothing about the 7B")
        network = random_network(tiny_config(CHUNK))
        for name, make, actions in decoders(compiled=False):
            report(f"tiny {name}", milliseconds(make(network), options.steps), None, actions)
        return
    print(f"{torch.cuda.get_device_name()}, {versions}")
    flying(options.steps)
    if options.lora:
        training()


if __name__ == "__main__":
    main()
