"""What a panel reader would tell of a label, without rendering it: for training language from described scenes.

A bank of a reader's own answers to crops of panels gives its doubts and errors as they are; without a reader, the
answers are certain. So what is learnt from described scenes holds for scenes that are seen in flight.

And calibration: temperatures that make a reader's probabilities mean what they say, by pictures never trained.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.eyes.panel_reader import Reader, ReaderConfig
from cognitivedrone.references import parse_reference
from cognitivedrone.terminal.progress import counted
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.panel_crops import PanelCrops, WiderWorld, draw_any_label
from cognitivedrone.training.perception.pictures import TrainingPictures
from cognitivedrone.training.trainer.start import StartingPoint, restore_part

CROPS = 12_000
"""Crops that a bank is made from."""
KEPT = 24
"""Answers that are kept of an attribute value."""
KEPT_UNKNOWN = 500
"""Whole answers that are kept of pictures of nothing known: a reader guesses in every group, each time otherwise."""

CALIBRATION_CROPS = 6_000
"""Panel crops that temperatures are fitted to."""
_FEWEST = 100  # samples of a group; others keep their temperature
_TEMPERATURES = np.exp(np.linspace(np.log(0.4), np.log(4.0), 60))
_SEED = 88
_DRAWN = frozenset({"animal", "food", "object", "logo"})

Floats = NDArray[np.float32]
DrawCrops = Callable[[np.random.Generator, int], tuple[NDArray[np.uint8], NDArray[np.int64]]]
"""Crops (n, g, g, 3) and their attribute values (n, groups)."""


@dataclass(frozen=True)
class Bank:
    """A reader's own answers."""

    values: dict[int, NDArray[np.float16]] = field(default_factory=dict)
    """By attribute value: probabilities (n, values of its group)."""
    unknown: NDArray[np.float16] | None = None
    """(n, F): whole answers to what was never taught, each group's probabilities by themselves."""


class Readings:
    """Readings of labels; a pure function of the reader's weights, the seed, and the generator given."""

    def __init__(self, index: AttributeIndex, bank: Bank | None = None) -> None:
        self.index = index
        self._given = bank or Bank()
        self._bank = self._given.values
        self._unknown = index.schema.names.index("kind/unknown")
        self._spans = tuple(index.groups.values())
        self._kinds = index.groups["kind"]
        self._applies = index.schema.applies

    def moved(self, index: AttributeIndex) -> Readings:
        """The same answers for a longer list of attribute values; there are none yet for the new ones."""
        rows = {name: row for row, name in enumerate(index.schema.names)}
        names, bank = self.index.schema.names, {}
        unknown = self._given.unknown
        if unknown is not None:
            wider = np.zeros((len(unknown), len(index.schema.names)), np.float16)
            wider[:, [rows[name] for name in names]] = unknown
            unknown = wider
        for group, span in self.index.groups.items():
            places = [rows[name] - index.groups[group].start for name in names[span]]
            for value in range(span.start, span.stop):
                if value in self._bank:
                    wider = np.zeros((len(self._bank[value]), index.groups[group].stop - index.groups[group].start))
                    wider[:, places] = self._bank[value]
                    bank[rows[names[value]]] = wider.astype(np.float16)
        return Readings(index, Bank(bank, unknown))

    def exact(self, label: str) -> Floats:
        """(F,): the probabilities of a reader without doubts."""
        row = np.zeros(len(self.index.schema.names), np.float32)
        known = self.index.of(label)
        row[known[known >= 0]] = 1.0
        return row

    def draw(self, rng: np.random.Generator, label: str, doubt: float) -> Floats:
        """(F,): what a reader could have reported; each group is taken from the bank with the probability `doubt`."""
        row = self.exact(label)
        if not self._bank:
            return row
        known = self.index.of(label)
        doubted = rng.random(len(known)) < doubt
        if doubted[0] and known[0] == self._unknown and self._given.unknown is not None:
            row[:] = self._given.unknown[int(rng.integers(len(self._given.unknown)))]
            return self._weighted(row)
        for column in np.flatnonzero(doubted & (known >= 0)).tolist():
            rows = self._bank.get(int(known[column]))
            if rows is not None:
                row[self._spans[column]] = rows[int(rng.integers(len(rows)))]
        return self._weighted(row)

    def _weighted(self, row: Floats) -> Floats:
        weighted: Floats = row * (row[self._kinds] @ self._applies)
        return weighted


def _answers(
    reader: Reader, draw: DrawCrops, rng: np.random.Generator, batches: Iterable[int]
) -> Iterator[tuple[Tensor, NDArray[np.int64]]]:
    """Logits (200, F) of crops, and their attribute values (200, groups)."""
    reader.eval()
    for _ in batches:
        images, attributes = draw(rng, 200)
        pixels = torch.from_numpy(images).permute(0, 3, 1, 2).float() / 255
        yield reader(pixels.contiguous(memory_format=torch.channels_last)).float(), attributes


@torch.no_grad()
def read_bank(reader: Reader, index: AttributeIndex, draw: DrawCrops, seed: int = 0) -> Bank:
    """A reader's answers to crops."""
    unknown, spans = index.schema.names.index("kind/unknown"), index.groups.values()
    found: dict[int, list[NDArray[np.float16]]] = {}
    whole: list[NDArray[np.float16]] = []
    main = os.environ.get("RANK", "0") == "0" and multiprocessing.parent_process() is None
    batches = counted(range(CROPS // 200), "reading panels of what is known", CROPS // 200, show=main)
    for logits, attributes in _answers(reader, draw, np.random.default_rng((seed, 77)), batches):
        shares = torch.cat([logits[:, span].softmax(-1) for span in spans], dim=1).numpy().astype(np.float16)
        for column, span in enumerate(spans):
            for row in np.flatnonzero(attributes[:, column] >= 0).tolist():
                rows = found.setdefault(int(attributes[row, column]), [])
                if len(rows) < KEPT:
                    rows.append(shares[row, span])
        whole += list(shares[attributes[:, 0] == unknown])
    strange = np.stack(whole[:KEPT_UNKNOWN]) if whole else None
    return Bank({value: np.stack(rows) for value, rows in found.items()}, strange)


def readings_of(
    start: StartingPoint, index: AttributeIndex, crops: Callable[[int], PanelCrops] | None = None
) -> Readings:
    """The readings of a trained reader, or of a policy's; of panel crops for training, or of those of a crop size."""
    reader = Reader(ReaderConfig.of(start.reader_facts()), len(index.schema.names))
    restore_part(start, "reader", reader)
    size = reader.config.crop_size
    panel_crops = PanelCrops(size, index.of, wider=WiderWorld()) if crops is None else crops(size)
    return Readings(index, read_bank(reader, index, panel_crops.draw))


@torch.no_grad()
def calibrated(reader: Reader, index: AttributeIndex) -> dict[str, float]:
    """Set the reader's temperatures, group by group, by crops of the sets for calibration; returns those found."""
    draw = calibration_crops(reader.config.crop_size, index).draw
    answers = [*_answers(reader, draw, np.random.default_rng(_SEED), range(-(-CALIBRATION_CROPS // 200)))]
    logits = torch.cat([logits for logits, _ in answers]) * reader.temperature
    attributes = torch.from_numpy(np.concatenate([attributes for _, attributes in answers]))
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
