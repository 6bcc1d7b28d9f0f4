"""Learning curves as in the literature on OpenVLA: L1 error, action accuracy and cross-entropy, per dimension and
overall, on frames that are never used for training, beside the baseline of the most frequent token.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.training.common.sampling import Batch
from cognitivedrone.training.common.training_task import Row
from cognitivedrone.training.small_vla.losses import LossModule, action_loss, action_targets, to_tensors, true_slots

DIMENSIONS = ("vx", "vy", "vz", "yaw_rate")


def validate(lesson: LossModule, batches: Sequence[Batch], autocast: Any) -> Row:
    """Losses and metrics of a loss module on validation batches; actions toward the gate flown at, if it is in view."""
    network = lesson.network
    device = next(network.parameters()).device
    lesson.eval()
    sums: dict[str, list[float]] = {}
    raws, targets = [], []
    with torch.no_grad(), autocast():
        for batch in batches:
            tensors = to_tensors(batch, device)
            _, measures = lesson(tensors)
            for name, value in measures.items():
                sums.setdefault(name, []).append(float(value))
            raw, target = _flown(network, tensors)
            raws.append(raw.float())
            targets.append(target)
    lesson.train()
    return {name: float(np.mean(values)) for name, values in sums.items()} | action_measures(
        network, torch.cat(raws), torch.cat(targets)
    )


def _flown(network: SmallVLA, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Raw actions and targets (n, chunk, 4, ...) toward the gates flown at, if they are in view."""
    image = batch["image"].permute(0, 3, 1, 2).float() / 255
    scene = network.look(image)
    slots, _ = true_slots(batch, network.cells, jitter=False)
    raw = network.act(network.attend(scene, slots), batch["state"])
    target, taught = action_targets(batch)
    rows = torch.arange(len(raw), device=raw.device)
    kept = taught[rows, batch["flown"]]
    return raw[rows, batch["flown"]][kept], target[rows, batch["flown"]][kept]


def action_measures(network: SmallVLA, raw: Tensor, target: Tensor) -> Row:
    """L1 (m/s and rad/s), token accuracy and cross-entropy, by dimension and overall, and the baseline's.

    A network without tokens has no cross-entropy.
    """
    config = network.config
    error = (network.decode(raw) - target).abs().mean(dim=(0, 1))
    row: Row = {f"l1 {name}": float(error[i]) for i, name in enumerate(DIMENSIONS)} | {"l1": float(error.mean())}
    span = network.high - network.low
    true = ((target - network.low) / span * (config.bins - 1)).round().clamp(0, config.bins - 1).long()
    guess = ((network.decode(raw) - network.low) / span * (config.bins - 1)).round().long()
    if config.head == "tokens":
        guess = raw.argmax(-1)
        entropy = action_loss(network, raw, target).mean(dim=(0, 1))
        row |= {f"cross-entropy {name}": float(entropy[i]) for i, name in enumerate(DIMENSIONS)}
        row["cross-entropy"] = float(entropy.mean())
    hits = (guess == true).float().mean(dim=(0, 1))
    for i, name in enumerate(DIMENSIONS):
        counts = torch.bincount(true[..., i].flatten(), minlength=config.bins).float()
        common = int(counts.argmax())
        place = float(network.low[i] + common / (config.bins - 1) * span[i])
        row |= {
            f"accuracy {name}": float(hits[i]),
            f"baseline accuracy {name}": float(counts[common] / counts.sum()),
            f"baseline l1 {name}": float((target[..., i] - place).abs().mean()),
        }
    for measure in ("accuracy", "baseline accuracy", "baseline l1"):
        row[measure] = float(np.mean([row[f"{measure} {name}"] for name in DIMENSIONS]))
    return row


def read_rows(path: Path) -> list[Row]:
    """The rows of a metrics file, one JSON object per line; a truncated line is skipped."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def draw_curves(rows: Sequence[Row], path: Path) -> None:
    """Plot the rows of a training into a PNG."""
    import matplotlib as mpl  # takes a second to import

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    panels = (
        ("L1 error, m/s and rad/s", "l1", "baseline l1"),
        ("action accuracy (256 tokens)", "accuracy", "baseline accuracy"),
        ("cross-entropy of actions", "cross-entropy", None),
        ("right gate, panels legible", "choice accuracy", None),
        ("losses", "losses", None),
        ("closed-loop success", "success", None),
    )
    figure, axes = plt.subplots(2, 3, figsize=(15, 8), constrained_layout=True)
    for axis, (title, name, baseline) in zip(axes.flat, panels, strict=True):
        axis.set_title(title)
        axis.set_xlabel("step")
        axis.grid(alpha=0.3)
        if name == "losses":
            for part in ("heat", "place", "facets", "cards", "choice", "text"):
                _line(axis, rows, part, part)
            axis.set_yscale("log")
        elif name == "success":
            for key in sorted({key for row in rows for key in row if key.startswith("success")}):
                _line(axis, rows, key, key.removeprefix("success ") or "all", width=2.5 if key == "success" else 1)
            axis.set_ylim(0, 1.02)
        else:
            _line(axis, rows, name, "overall", width=2.5)
            for dimension in DIMENSIONS:
                _line(axis, rows, f"{name} {dimension}", dimension)
        if name == "choice accuracy":
            _line(axis, rows, "text accuracy", "told instead of seen")
        if baseline:
            _line(axis, rows, baseline, "majority token", style="k--")
        if axis.lines:
            axis.legend(fontsize=8)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _line(axis: Any, rows: Sequence[Row], key: str, label: str, *, style: str = "-", width: float = 1) -> None:
    points = [(row["step"], row[key]) for row in rows if row.get(key) is not None]
    if points:
        axis.plot(*zip(*points, strict=True), style, label=label, linewidth=width)
