"""Calibration: temperatures that make probabilities mean what they say, by pictures that were never trained."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.eyes.panel_reader import Reader
from cognitivedrone.references import parse_reference
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.panel_crops import PanelCrops, WiderWorld, draw_any_label
from cognitivedrone.training.perception.pictures import TrainingPictures

CROPS = 6_000
"""Panel crops that temperatures are fitted to."""
_FEWEST = 100  # samples of a group; others keep their temperature
_TEMPERATURES = np.exp(np.linspace(np.log(0.4), np.log(4.0), 60))
_SEED = 88
_DRAWN = frozenset({"animal", "food", "object", "logo"})

Floats = NDArray[np.float32]


def calibrated(reader: Reader, index: AttributeIndex) -> dict[str, float]:
    """Set the reader's temperatures, group by group; returns those that were found."""
    logits, attributes = calibration_readings(reader, index)
    found: dict[str, float] = {}
    for column, (group, span) in enumerate(index.groups.items()):
        there = attributes[:, column] >= 0
        if int(there.sum()) < _FEWEST:
            continue
        found[group] = temperature_of(logits[there][:, span], attributes[there, column] - span.start)
        reader.temperature[span] = found[group]
    return found


def temperature_of(logits: Tensor, target: Tensor) -> float:
    """The temperature by which logits (n, classes) predict targets (n,) best, in likelihood."""
    losses = [float(F.cross_entropy(logits / float(value), target)) for value in _TEMPERATURES]
    return float(_TEMPERATURES[int(np.argmin(losses))])


@torch.no_grad()
def calibration_readings(reader: Reader, index: AttributeIndex, count: int = CROPS) -> tuple[Tensor, Tensor]:
    """Uncalibrated logits (n, F) of crops of the sets for calibration, and their attribute values (n, groups)."""
    rng = np.random.default_rng(_SEED)
    panel_crops = calibration_crops(reader.config.crop_size, index)
    reader = reader.eval()
    logits, attributes = [], []
    for _ in range(-(-count // 200)):
        images, known = panel_crops.draw(rng, 200)
        pixels = torch.from_numpy(images).permute(0, 3, 1, 2).float() / 255
        pixels = pixels.contiguous(memory_format=torch.channels_last)
        logits.append(reader(pixels) * reader.temperature)
        attributes.append(torch.from_numpy(known))
    return torch.cat(logits), torch.cat(attributes)


def calibration_crops(crop_size: int, index: AttributeIndex) -> PanelCrops:
    """Panel crops in which things are shown by the sets for calibration alone."""
    pictures = TrainingPictures(calibration=True)

    def draw_label(rng: np.random.Generator) -> str:
        while True:
            label = draw_any_label(rng)
            shown = parse_reference(label)
            if shown.kind not in _DRAWN or pictures.references(shown.kind, shown.concept):
                return label

    return PanelCrops(crop_size, index.of, draw_label, WiderWorld(pictures=pictures, share=1.0))
