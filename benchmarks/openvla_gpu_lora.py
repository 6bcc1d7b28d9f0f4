"""Steps of fine-tuning, ours and those of the published recipe's loop, on random weights: for `openvla_gpu.py`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
import torch
from openvla_gpu_report import Machine, Report
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.openvla.config import ACTION_SIZE, IMAGE, PADDING, PATCHES, WORDS
from cognitivedrone.models.openvla.network import IGNORED, OpenVlaNetwork
from cognitivedrone.models.openvla.prepare import BEGIN, END, SPACE
from cognitivedrone.training.openvla.adapters import add_adapters, cast_inputs
from cognitivedrone.training.openvla.recipes import PAPER

BATCHES = (1, 2, 4, 8, 16, 32)
"""Tried on a GPU, each way up to the first that does not fit."""
STEPS = 5
"""Of which the first two are not counted."""
LENGTHS = (24, 36)
"""Of prompts, in tokens."""

Batch = tuple[Tensor, Tensor, Tensor, Tensor]
"""`input_ids`, `pixel_values`, `attention_mask`, `labels`."""


def some_batch(network: OpenVlaNetwork, size: int, seed: int = 0) -> Batch:
    """Samples as in training: prompts of several lengths, each with four words of action and the end."""
    rng = np.random.default_rng(seed)
    longest = LENGTHS[1] + ACTION_SIZE + 1
    ids, labels = np.full((size, longest), PADDING), np.full((size, longest), IGNORED)
    for row in range(size):
        words = rng.integers(100, 29_000, rng.integers(*LENGTHS) - 2)
        answer = [*rng.integers(WORDS - 256, WORDS, ACTION_SIZE), END]
        text = [BEGIN, *words, SPACE, *answer]
        ids[row, : len(text)] = text
        labels[row, len(text) - len(answer) : len(text)] = answer
    pixels = torch.from_numpy(rng.standard_normal((size, 6, IMAGE, IMAGE), np.float32))
    where = network.projector.fc1.bias.device
    return (
        torch.from_numpy(ids).to(where),
        pixels.to(where),
        torch.from_numpy(ids != PADDING).long().to(where),
        torch.from_numpy(labels).to(where),
    )


def our_loss(network: OpenVlaNetwork, batch: Batch) -> Tensor:
    """As `train-openvla` computes it: fused attention, and only the words that matter are scored."""
    loss: Tensor = network(*batch).loss
    assert loss is not None  # noqa: S101 - labels were given
    return loss


def published_loss(network: OpenVlaNetwork, batch: Batch) -> Tensor:
    """As OpenVLA's published fine-tuning does: eager attention, all logits in float32, and the accuracy at every step.

    The network's attention is to be "eager", which takes a mask to be added. The towers were fused there, too.
    """
    ids, pixels, known, labels = batch
    embedded = network.embed(ids, pixels)
    length = embedded.shape[1]
    seen = torch.cat([known[:, :1], known.new_ones(len(known), PATCHES), known[:, 1:]], dim=1).bool()
    causal = torch.ones(length, length, dtype=torch.bool, device=seen.device).tril()
    allowed = causal & seen[:, None, None]
    mask = torch.zeros_like(allowed, dtype=embedded.dtype).masked_fill(~allowed, torch.finfo(embedded.dtype).min)
    logits = network.language_model.lm_head(network.states(embedded, mask)).float()
    after = torch.cat([labels[:, :1], labels.new_full((len(labels), PATCHES), IGNORED), labels[:, 1:]], dim=1)[:, 1:]
    loss = F.cross_entropy(logits[:, :-1].flatten(0, 1), after.flatten(), ignore_index=IGNORED)
    guess, action = logits[:, :-1].argmax(-1), after > WORDS - 257
    ((guess == after) & action).sum().item()
    return loss


@dataclass(frozen=True)
class Way:
    """A way to train."""

    name: str
    loss: Callable[[OpenVlaNetwork, Batch], Tensor]
    attention: str = "sdpa"
    checkpointing: bool = False
    fused: bool = True
    """Whether AdamW updates all weights in one kernel."""
    casting: bool = False
    """Whether adapters copy their inputs to float32."""


PUBLISHED = Way("published loop", published_loss, attention="eager", fused=False, casting=True)
WAYS = (PUBLISHED, Way("ours", our_loss), Way("ours, recomputing layers", our_loss, checkpointing=True))


def samples_per_s(
    network: OpenVlaNetwork, trained: list[torch.nn.Parameter], way: Way, micro: int, parts: int
) -> float:
    """Median rate of whole steps of the optimiser, each of `parts` micro-batches of `micro` samples."""
    network.language_model.set_attn_implementation(way.attention)
    network.enable_checkpointing(way.checkpointing)
    cast_inputs(network, enabled=way.casting)
    network.train()
    optimizer = torch.optim.AdamW(
        trained, PAPER.learning_rate, weight_decay=PAPER.weight_decay, fused=way.fused or None
    )
    batch = some_batch(network, micro)
    device = batch[0].device.type
    times = []
    for _ in range(STEPS):
        begin = time.perf_counter()
        for _ in range(parts):
            with torch.autocast(device, torch.bfloat16):
                loss = way.loss(network, batch)
            (loss / parts).backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        optimizer.zero_grad()
        loss.item()  # waits for the step's end
        times.append(time.perf_counter() - begin)
    return micro * parts / float(np.median(times[2:]))


def training(report: Report, batches: Sequence[int], whole: int) -> None:
    """Measure each way at each batch that fits, and steps of `whole` samples by accumulation.

    Those are in micro-batches of the largest size that fits and divides them.
    """
    report.table("LoRA of rank 32 on all linear layers, bfloat16, AdamW", "samples/s", "to published", "peak memory")
    network, trained = adapted(report.machine)
    published: dict[int, float] = {}

    def measure(way: Way, name: str, micro: int, parts: int) -> bool:
        measured = False
        with report.measuring(f"{name}, {way.name}"):
            rate = samples_per_s(network, trained, way, micro, parts)
            if way is PUBLISHED:
                published[micro * parts] = rate
            ratio = rate / published[micro * parts] if micro * parts in published else None
            told = "-" if ratio is None else f"{ratio:.2f} x"
            report.row(f"{name}, {way.name}", f"{rate:.2f}", told, report.machine.peak())
            measured = True
        for value in trained:
            value.grad = None  # of a step that has failed
        return measured

    for way in WAYS:
        fitting = list(takewhile(lambda size, way=way: measure(way, f"batch {size}", size, 1), batches))  # type: ignore[misc]
        if fitting:
            micro = fitting[-1]
            measure(way, f"batch {whole} by {micro}", micro, whole // micro)


def adapted(machine: Machine) -> tuple[OpenVlaNetwork, list[torch.nn.Parameter]]:
    """A network with the paper's adapters, and their weights."""
    network = machine.network()
    return network, list(add_adapters(network, PAPER).values())
