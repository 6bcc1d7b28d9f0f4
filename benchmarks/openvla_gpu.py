"""Speed and memory of OpenVLA-7B on a GPU, with random weights: nothing needs to be downloaded.

Run: python benchmarks/openvla_gpu.py --lora --out results/openvla_gpu.json

For each decoder and quantisation: median and 99th percentile of a whole control step (preparation, network, answer back
on the host), the rate, its ratio to the 10 Hz of the paper, the peak GPU memory in flight, and the time to the first
answer, with compiling and recording.

With --lora: samples a second and peak memory of fine-tuning at several batch sizes and of the paper's batch of 64 by
accumulation, beside the loop of the published recipe on the same card. Needs peft.

Quantisations need torchao. A failed measurement is reported in its row, and the rest continues. On a machine without a
GPU it says so and runs the tiny networks on the same paths, which says nothing about the large ones.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
from openvla_gpu_report import Report, find_machine

from cognitivedrone.benchmark.measurements import OUT_HELP, command_line
from cognitivedrone.models.openvla.checkpoint import Quantisation
from cognitivedrone.models.openvla.compiled import compile_blocks
from cognitivedrone.models.openvla.decode import Autoregressive, Decoder, Parallel, Runner, greedy_tokens
from cognitivedrone.models.openvla.network import OpenVlaNetwork
from cognitivedrone.models.openvla.prepare import ImagePreparation
from cognitivedrone.models.openvla.weights import fuse
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE

CHUNK = 8
PROMPT = [1, *range(500, 527), 29_871]
"""As many tokens as "Fly through the small red round gate" makes."""


class WithoutGraph:
    """The autoregressive decoder as PyTorch runs it by itself, each kernel launched by the host."""

    def __init__(self, network: OpenVlaNetwork) -> None:
        self._network = network
        self._runner = Runner(lambda *inputs: greedy_tokens(network, *inputs), network)

    def __call__(self, pixel_values: np.ndarray, input_ids: list[int]) -> np.ndarray:
        """Ids (4,) of the words."""
        weight = self._network.projector.fc1.bias
        with torch.inference_mode():
            ids = torch.tensor([input_ids], device=weight.device)
            count = torch.tensor([len(input_ids)], device=weight.device)
            pixels = torch.from_numpy(np.array(pixel_values))[None].to(weight.device)
            return self._runner.step(pixels, ids, count)[0].cpu().numpy()


def control_step(decode: Any) -> Callable[[], object]:
    """A step from frame to answer, each time of another of eight frames."""
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (8, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
    prepare, taken = ImagePreparation().square, 0

    def step() -> object:
        nonlocal taken
        taken += 1
        return decode(prepare(frames[taken % len(frames)]), PROMPT)

    return step


def milliseconds(step: Callable[[], object], count: int) -> np.ndarray:
    """Of `count` control steps, each to its end, after a warm-up."""
    times = []
    for _ in range(count + 5):
        begin = time.perf_counter()
        step()
        times.append((time.perf_counter() - begin) * 1e3)
    return np.array(times[5:])


def decoders(
    quantisation: Quantisation,
) -> Iterator[tuple[str, Callable[[OpenVlaNetwork], Decoder | WithoutGraph], int]]:
    """Name, maker, and the actions that a step gives; from "ar" on products are fused, and from the first compiled one
    on, the network stays so.
    """
    if quantisation == "none":
        yield "ar, without its graph", WithoutGraph, 1
        yield "ar, products apart", Autoregressive, 1
        yield "ar", Autoregressive, 1
        yield "parallel", Parallel, CHUNK
    yield "ar, compiled", Autoregressive, 1
    yield "parallel, compiled", Parallel, CHUNK


def flying(report: Report, quantisations: Sequence[Quantisation], steps: int) -> None:
    """Measure each decoder with each quantisation."""
    report.table("One control step", "median", "p99", "rate", "to 10 Hz", "actions", "peak memory", "first answer")
    for quantisation in quantisations:
        with report.measuring(quantisation):
            network = report.machine.network(CHUNK, quantisation, fused=quantisation != "none")
            for name, make, actions in decoders(quantisation):
                with report.measuring(f"{quantisation}, {name}"):
                    begin = time.perf_counter()
                    if name == "ar":
                        fuse(network.language_model.model.layers)
                    if name == "ar, compiled":
                        compile_blocks(network, report.machine.compiler)
                    step = control_step(make(network))
                    step()
                    first = time.perf_counter() - begin
                    times = milliseconds(step, steps)
                    median, slow = np.percentile(times, [50, 99])
                    rate = 1e3 / median
                    cells = f"{median:.1f} ms", f"{slow:.1f} ms", f"{rate:.1f} Hz", f"{rate / CONTROL_HZ:.1f} x"
                    report.row(f"{quantisation}, {name}", *cells, str(actions), report.machine.peak(), f"{first:.1f} s")
            del network


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200, help="control steps of each decoder; 0 leaves them out")
    parser.add_argument("--quant", nargs="+", choices=get_args(Quantisation), help="all on a GPU, none without")
    parser.add_argument("--lora", action="store_true", help="measure fine-tuning as well")
    parser.add_argument(
        "--batches", type=int, nargs="+", help="sizes to try in fine-tuning; all powers of two by default"
    )
    parser.add_argument("--add", action="store_true", help="keep the other rows that are in the file of figures")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args(arguments)
    machine = find_machine()
    report = Report(machine, options.out, add=options.add)
    given = sys.argv[1:] if arguments is None else arguments
    report.begin(command_line(["benchmarks/openvla_gpu.py", *given]))
    quantisations = options.quant or (get_args(Quantisation) if machine.large else ["none"])
    if options.steps:
        flying(report, quantisations, options.steps)
    if options.lora:
        with report.measuring("LoRA"):
            from openvla_gpu_lora import BATCHES, PAPER, training

            batches, whole = (BATCHES, PAPER.batch) if machine.large else ((1,), 2)
            training(report, options.batches or batches, whole)


if __name__ == "__main__":
    main()
