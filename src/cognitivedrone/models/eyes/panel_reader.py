"""The panel reader: from crops of panels and boards to attribute values.

Its answer is nearly plain text, probabilities of named attribute values (`attributes.AttributeSchema`): all that
policy and reasoner know of a panel. So what a new picture or concept is can be taught here alone.

Shapes: B scenes, S = 3 gate slots, F attribute values, E the embedding.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import Block


@dataclass(frozen=True, slots=True)
class ReaderConfig:
    """Sizes of the reader."""

    crop_size: int = 48
    """Height and width of a panel crop, pixels."""
    panel_encoder: tuple[int, int, int, int] = (32, 64, 128, 256)
    """Channels at strides 2, 4, 8 and 16."""
    embedding: int = 192

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @classmethod
    def of(cls, facts: dict[str, Any]) -> ReaderConfig:
        """Read back what `facts` gave."""
        return cls(**{**facts, "panel_encoder": tuple(facts["panel_encoder"])})


class Reader(nn.Module):
    """Network from crops of panels and boards to logits of attribute values.

    An embedding has a fixed length, so that a new attribute value can begin as the mean of its pictures' embeddings.
    """

    def __init__(self, config: ReaderConfig, attributes: int) -> None:
        super().__init__()
        self.config = config
        self.panel_encoder = panel_encoder(config.panel_encoder, config.crop_size, config.embedding)
        self.attributes = nn.Linear(config.embedding, attributes)
        self.temperature: Tensor
        self.register_buffer("temperature", torch.ones(attributes))

    def embed(self, panel_images: Tensor) -> Tensor:
        """From panel crops (n, 3, g, g), 0 to 1, channels last in memory for speed, to embeddings (n, E)."""
        embedded: Tensor = self.panel_encoder((panel_images - 0.5) * 4)
        scaled: Tensor = F.normalize(embedded.float(), dim=-1) * self.config.embedding**0.5
        return scaled

    def forward(self, panel_images: Tensor) -> Tensor:
        """From panel crops (n, 3, g, g), 0 to 1, to logits (n, F), calibrated by `temperature`."""
        logits: Tensor = self.attributes(self.embed(panel_images)).float() / self.temperature
        return logits


class Probabilities(nn.Module):
    """From a reader's logits to probabilities, as `AttributeSchema.probabilities`."""

    def __init__(self, schema: AttributeSchema) -> None:
        super().__init__()
        self._spans = tuple(schema.groups.values())
        self._kinds = schema.groups["kind"]
        self.applies: Tensor
        self.register_buffer("applies", torch.from_numpy(schema.applies), persistent=False)

    def forward(self, logits: Tensor) -> Tensor:
        """From (..., F) to (..., F)."""
        shares = torch.cat([logits[..., span].float().softmax(-1) for span in self._spans], dim=-1)
        return shares * (shares[..., self._kinds] @ self.applies)


def panel_encoder(channels: tuple[int, int, int, int], crop_size: int, embedding: int) -> nn.Sequential:
    """The panel encoder: from crops (n, 3, crop_size, crop_size), about -2 to 2, to (n, embedding)."""
    c1, c2, c3, c4 = channels
    return nn.Sequential(
        nn.Conv2d(3, c1, 4, 2, 1, bias=False),
        nn.BatchNorm2d(c1),
        nn.ReLU(),
        Block(c1, c2, 2),
        Block(c2, c2),
        Block(c2, c3, 2),
        Block(c3, c4, 2),
        nn.Flatten(),
        nn.Linear(c4 * (crop_size // 16) ** 2, embedding),
    )
