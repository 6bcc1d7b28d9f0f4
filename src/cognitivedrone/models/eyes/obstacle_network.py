"""The obstacle eye's network (`obstacle_eye`): a small residual network that sees half of the resolution.

Whether something is a pillar in front or a patch of the wall behind is decided by where it meets the floor, so the last
blocks see widely (dilated convolutions, arXiv 1511.07122). For each part it names one of some distances, or none, as
depth estimators do that classify (arXiv 1806.02446): at an edge the mean of near and far would be a distance at which
nothing is.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.eyes.finder import Block
from cognitivedrone.models.eyes.obstacle_eye import DEPTHS_M

Channels = tuple[int, int, int]
"""At strides 2, 4 and 8 of the half-sized image."""


class ObstacleNetwork(nn.Module):
    """The network; `forward` is used in flight, `logits` in training."""

    def __init__(self, channels: Channels = (32, 64, 96)) -> None:
        super().__init__()
        first, second, third = channels
        self.stem = nn.Sequential(nn.Conv2d(3, first, 4, 2, 1, bias=False), nn.BatchNorm2d(first), nn.ReLU())
        self.body = nn.Sequential(
            Block(first, second, stride=2),
            Block(second, third, stride=2),
            Block(third, third, dilation=2),
            Block(third, third, dilation=4),
        )
        self.head = nn.Conv2d(third, len(DEPTHS_M) + 1, 1)
        self.log_depths: Tensor
        self.register_buffer("log_depths", torch.tensor(DEPTHS_M).log(), persistent=False)

    def logits(self, image: Tensor) -> Tensor:
        """Logits (B, depths + 1, PARTS, PARTS) of the distances `DEPTHS_M` and, last, of none, for images uint8
        (B, 256, 256, 3).
        """
        half = F.avg_pool2d(image.permute(0, 3, 1, 2).float() / 255, 2)
        found: Tensor = self.head(self.body(self.stem((half - 0.5) * 4)))
        return found

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """As `ObstacleEye.look`."""
        return occupied_and_depth(self.logits(image).float(), self.log_depths)


def occupied_and_depth(logits: Tensor, log_depths: Tensor) -> tuple[Tensor, Tensor]:
    """Probability (B, PARTS, PARTS) of any distance, and the geometric mean of the distances by theirs, m."""
    there = logits[:, :-1].softmax(dim=1)
    occupied = 1 - logits.softmax(dim=1)[:, -1]
    return occupied, (there * log_depths[:, None, None]).sum(dim=1).exp()
