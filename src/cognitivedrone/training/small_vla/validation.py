"""A point of the learning curves as in the literature on OpenVLA: L1 error, action accuracy and cross-entropy, per
dimension and overall, on frames that are never trained, beside what guessing the commonest token would give.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cognitivedrone.models.small_vla import Flight, SmallVLA
from cognitivedrone.training.small_vla.losses import LossModule, action_loss, action_targets, true_slots
from cognitivedrone.training.trainer.run_log import DIMENSIONS
from cognitivedrone.training.trainer.training_task import Batch, Row, to_tensors


def validate(loss_module: LossModule, batches: Sequence[Batch], autocast: Any) -> Row:
    """Losses and metrics of a loss module on validation batches; actions toward the gate flown at, if it is in view."""
    network = loss_module.network
    device = next(network.parameters()).device
    loss_module.eval()
    sums: dict[str, list[float]] = {}
    raws, targets = [], []
    with torch.no_grad(), autocast():
        for batch in batches:
            tensors = to_tensors(batch, device)
            _, measures = loss_module(tensors)
            for name, value in measures.items():
                sums.setdefault(name, []).append(float(value))
            raw, target = _flown(network, tensors)
            raws.append(raw.float())
            targets.append(target)
    loss_module.train()
    return {name: float(np.mean(values)) for name, values in sums.items()} | action_measures(
        network.flight, torch.cat(raws), torch.cat(targets)
    )


def _flown(network: SmallVLA, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Raw actions and targets (n, chunk, 4, ...) toward the gates flown at, if they are in view."""
    image = batch["image"].permute(0, 3, 1, 2).float() / 255
    slots, _ = true_slots(batch, jitter=False)
    seen = network.finder.attend(network.finder.look(image), slots)
    raw = network.flight.act(seen, batch["state"])
    target, taught = action_targets(batch)
    rows = torch.arange(len(raw), device=raw.device)
    kept = taught[rows, batch["flown"]]
    return raw[rows, batch["flown"]][kept], target[rows, batch["flown"]][kept]


def action_measures(flight: Flight, raw: Tensor, target: Tensor) -> Row:
    """L1 (m/s and rad/s), token accuracy and cross-entropy, by dimension and overall, and the baseline's.

    Actions without tokens has no cross-entropy.
    """
    config = flight.config
    error = (flight.decode(raw) - target).abs().mean(dim=(0, 1))
    row: Row = {f"l1 {name}": float(error[i]) for i, name in enumerate(DIMENSIONS)} | {"l1": float(error.mean())}
    span = flight.high - flight.low
    true = ((target - flight.low) / span * (config.bins - 1)).round().clamp(0, config.bins - 1).long()
    guess = ((flight.decode(raw) - flight.low) / span * (config.bins - 1)).round().long()
    if config.head == "tokens":
        guess = raw.argmax(-1)
        entropy = action_loss(flight, raw, target).mean(dim=(0, 1))
        row |= {f"cross-entropy {name}": float(entropy[i]) for i, name in enumerate(DIMENSIONS)}
        row["cross-entropy"] = float(entropy.mean())
    hits = (guess == true).float().mean(dim=(0, 1))
    for i, name in enumerate(DIMENSIONS):
        counts = torch.bincount(true[..., i].flatten(), minlength=config.bins).float()
        common = int(counts.argmax())
        place = float(flight.low[i] + common / (config.bins - 1) * span[i])
        row |= {
            f"accuracy {name}": float(hits[i]),
            f"baseline accuracy {name}": float(counts[common] / counts.sum()),
            f"baseline l1 {name}": float((target[..., i] - place).abs().mean()),
        }
    for measure in ("accuracy", "baseline accuracy", "baseline l1"):
        row[measure] = float(np.mean([row[f"{measure} {name}"] for name in DIMENSIONS]))
    return row
