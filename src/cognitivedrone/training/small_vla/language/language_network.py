"""The network that learns language, and its loss: text encoder and language, beside a panel reader that stays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor, nn

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.panel_reader import Reader, ReaderConfig
from cognitivedrone.models.words.gate_selector import SelectorConfig
from cognitivedrone.models.words.language import Language, LanguageConfig, TextEncoder
from cognitivedrone.models.words.scene_tokens import INPUTS
from cognitivedrone.training.small_vla.language.described import text_loss

_FROZEN_LAYERS = 2


class LanguageNetwork(nn.Module):
    """Text encoder and language; and the panel reader that they were trained for, which stays as it is."""

    learning_rates: ClassVar[dict[str, float]] = {"encoder": 0.1}
    """Of parts, as shares of the recipe's."""

    def __init__(self, encoder: SelectorConfig, language: LanguageConfig, reader: ReaderConfig, names: Sequence[str]):
        super().__init__()
        self.encoder = TextEncoder(encoder)
        self.language = Language(language, AttributeSchema(tuple(names)))
        self.reader = Reader(reader, len(names)).requires_grad_(requires_grad=False)
        for part in (self.encoder.words, self.encoder.places, self.encoder.embedded):
            part.requires_grad_(requires_grad=False)
        for layer in self.encoder.layers[:_FROZEN_LAYERS]:
            layer.requires_grad_(requires_grad=False)

    def train(self, mode: bool = True) -> LanguageNetwork:
        """As for every module, but the reader keeps its statistics."""
        super().train(mode)
        self.reader.eval()
        return self


class LanguageLoss(nn.Module):
    """Text encoder and language, with their loss."""

    def __init__(self, network: LanguageNetwork, schema: AttributeSchema) -> None:
        super().__init__()
        self.network = network
        self._schema = schema

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, the same and the share of sentences that were understood."""
        loss, logits = self.answers(batch)
        right = (logits.argmax(-1) == batch["text_target"]).float().mean()
        return loss, {"text": loss.detach(), "text accuracy": right.detach()}

    def answers(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """The loss, and logits (T, 4)."""
        words = self.network.encoder(*(batch[name] for name in INPUTS))
        return text_loss(self.network.language, self._schema, words, batch)
