"""How well a panel reader reads drawings of each set, and whether its probabilities mean what they say.

Run: python benchmarks/reading.py [--reader runs/reader/reader.safetensors] [--sets calibration] [--crops 600]
    [--photographic] [--out results/reading.json]

For each set: how often the most likely thing is the right one among all (top 1) and among three (choice), how often a
picture is taken for something unknown, and the expected calibration error of the most likely thing. Panels are 22 to
60 pixels high, before any wall, turned and lit as in training. `--sets held-out` shows sets that tests are made of:
look at them once, when nothing will be changed any more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from PIL import Image

from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.benchmark.reasoning.reason_scoring import calibration_error
from cognitivedrone.labels.extended import extended_pack
from cognitivedrone.models.eyes.panel_reader import Reader, ReaderConfig
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks import vocabulary
from cognitivedrone.training.perception import panel_crops
from cognitivedrone.training.perception.attributes import AttributeIndex, concept_name
from cognitivedrone.training.perception.photographic import Photographic
from cognitivedrone.training.perception.pictures import OTHERS, PACK
from cognitivedrone.training.trainer.start import read_start, restore_part

Sets = Literal["train", "calibration", "held-out"]
SETS: dict[Sets, tuple[str, ...]] = {
    "train": vocabulary.TRAIN_PICTURE_SETS,
    "calibration": vocabulary.CALIBRATION_PICTURE_SETS,
    "held-out": vocabulary.HELD_OUT_PICTURE_SETS,
}
MEASURES = ("top_1", "choice", "unknown", "calibration_error")
UNKNOWN: dict[Sets, str] = {"train": OTHERS, "calibration": OTHERS, "held-out": "others-held-out"}


@dataclass(frozen=True)
class Config:
    """What is read."""

    reader: Path | None = None
    """A reader's or a policy's file; the packaged policy by default."""
    sets: Sets = "calibration"
    crops: int = 600
    """Crops of every set."""
    photographic: bool = False
    """Whether pictures are changed as photographs would show them; otherwise they are drawn on white."""
    seed: int = 0
    out: Path | None = None
    """File for the figures."""


def main(config: Config) -> None:
    """Print the table."""
    start = read_start(config.reader, "reader")
    index = AttributeIndex(start.facts["attributes"])
    reader = Reader(ReaderConfig.of(start.reader_facts()), len(index.schema.names))
    restore_part(start, "reader", reader)
    reader.eval()
    panel_crops.HEIGHTS = (22.0, 60.0)
    print(f"{config.sets}, {config.crops} crops a set{', photographic' if config.photographic else ''}")
    print(f"{'set':18} {'things':>6} {'top 1':>7} {'choice':>7} {'unknown':>8} {'error':>6}")
    rows: list[dict[str, Any]] = []
    for style in SETS[config.sets]:
        shares, names = read(config, reader, index, style)
        rows.append({"set": style, "things": len(set(names)), **measures(shares, names, index)})
        show(rows[-1])
    mean = {name: float(np.mean([row[name] for row in rows])) for name in MEASURES}
    rows.append({"set": "mean of the sets", **mean})
    show(rows[-1])
    shares, _ = read(config, reader, index, UNKNOWN[config.sets], unknown=True)
    unknown = index.schema.names.index("kind/unknown")
    rows.append({"set": "other things", "unknown": float((shares[:, unknown] > 0.5).mean())})
    print(f"{'other things':18} taken for unknown {rows[-1]['unknown']:.1%}")
    keep(config.out, f"A panel reader on the sets {config.sets}, {config.crops} crops each", rows, seed=config.seed)


def show(row: Mapping[str, Any]) -> None:
    """Print a line."""
    print(f"{row['set']:18} {row.get('things', ''):6} " + " ".join(f"{row[name]:7.1%}" for name in MEASURES))


def measures(shares: np.ndarray, names: list[str], index: AttributeIndex) -> dict[str, float]:
    """The measures of a set."""
    span = index.groups["concept"]
    places = np.array([index.schema.names.index(name) - span.start for name in names])
    concepts = shares[:, span]
    best = concepts.argmax(1)
    rng = np.random.default_rng(0)
    chosen = []
    for number, place in enumerate(places):
        alike = [other for other in set(places.tolist()) if other != place]
        two = rng.choice(alike, 2, replace=False)
        chosen.append(concepts[number, place] > concepts[number, two].max())
    unknown = shares[:, index.schema.names.index("kind/unknown")] > 0.5
    error = calibration_error(concepts.max(1), best == places) or 0.0
    values = float((best == places).mean()), float(np.mean(chosen)), float(unknown.mean()), error
    return dict(zip(MEASURES, values, strict=True))


@torch.no_grad()
def read(
    config: Config, reader: Reader, index: AttributeIndex, style: str, *, unknown: bool = False
) -> tuple[np.ndarray, list[str]]:
    """Probabilities (n, F) of crops of a set, and the names of what they show."""
    pack, rng = extended_pack(PACK), np.random.default_rng(config.seed)
    kinds = ("unknown",) if unknown else ("animal", "food", "object", "logo")
    concepts = [(kind, concept) for kind in kinds for concept in (("picture",) if unknown else pack.concepts(kind))]
    references = [
        reference
        for kind, concept in concepts
        for reference in pack.pictures(kind, concept)
        if reference.partition("@")[2].partition("~")[0] == style
    ]
    if not references and not unknown:
        references = [f"{kind}/{concept}@{style}" for kind, concept in concepts if style in pack.styles(kind)]
    draw = Photographic(side=64)
    images, names = [], []
    for number in rng.integers(len(references), size=config.crops).tolist():
        reference = references[number]
        parsed = parse_reference(reference)
        picture = (
            draw.draw(pack.cutout(reference), rng)
            if config.photographic or unknown
            else np.asarray(Image.fromarray(pack.image(reference)).resize((64, 64), Image.Resampling.BOX))
        )
        images.append(panel_crops.panel_image_of(Image.fromarray(picture), reader.config.crop_size, rng))
        kind = parsed.kind if parsed.kind == "logo" else "thing"
        names.append("kind/unknown" if unknown else concept_name(kind, parsed.concept))
    pixels = torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).float() / 255
    logits = torch.cat(
        [reader(part.contiguous(memory_format=torch.channels_last)) for part in torch.split(pixels, 200)]
    )
    return index.schema.probabilities(logits.numpy()), names


if __name__ == "__main__":
    main(tyro.cli(Config))
