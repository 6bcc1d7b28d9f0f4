"""Sentences about described scenes, and the network that learns language from them, without frames, with its loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import SLOTS
from cognitivedrone.models.eyes.panel_reader import Reader, ReaderConfig
from cognitivedrone.models.words.gate_selector import SelectorConfig
from cognitivedrone.models.words.language import Language, LanguageConfig, TextEncoder
from cognitivedrone.models.words.scene_tokens import INPUTS, SceneTokenizer, stacked
from cognitivedrone.models.words.text_encoder import parts_of
from cognitivedrone.training.language.problems import ABSENT, ALONE, Mix, Problem
from cognitivedrone.training.perception.attributes import gate_looks
from cognitivedrone.training.perception.readings import Readings
from cognitivedrone.training.trainer.training_task import Batch

_NAMING = frozenset({"letters", "digits", "logos", "animals", "math", "math_board", "distraction", "two_step"})
"""Families whose sentences mean one concept, regardless of the other options."""
_NAMING_SHARE = 0.3  # weight of naming the right concept, beside choosing among three


@dataclass(frozen=True, slots=True)
class TextMix:
    """Distribution of sentences about described scenes."""

    problems: Mix = field(default_factory=lambda: Mix(families=dict(ALONE)))
    doubt: float = 0.5
    """Share of attributes that are read with the reader's own doubts."""
    hidden: float = 0.15
    """Share of sentences about a board while no board is in view, so that the right gate is unknowable."""


def described(
    rng: np.random.Generator, problems: Sequence[Problem], tokenizer: SceneTokenizer, readings: Readings, mix: TextMix
) -> Batch:
    """Sentences with described scenes, T of them: `tokens`, `positions`, `parts` (T, L) as the text encoder takes them,
    and the fields of `scenes`.
    """
    tokens = stacked([tokenizer.encode(parts_of(problem.sentence)) for problem in problems])
    return {**tokens, **scenes(rng, problems, readings, mix)}


def scenes(
    rng: np.random.Generator,
    problems: Sequence[Problem],
    readings: Readings,
    mix: TextMix,
) -> Batch:
    """The scenes of T problems, as a panel reader could have read them.

    text_panels (T, 3, F) and text_board (T, F), probabilities of attribute values;
    text_looks (T, 3, 3); text_board_seen (T,) whether a board is in view; text_target (T,) the right gate, or `ABSENT`;
    text_open (T,) whether it cannot be known; text_named (T,) the attribute value that the sentence alone means, or -1.
    """
    count, size = len(problems), len(readings.index.schema.names)
    batch: dict[str, NDArray[np.generic]] = {
        "text_panels": np.zeros((count, 3, size), np.float32),
        "text_board": np.zeros((count, size), np.float32),
        "text_looks": np.stack([[gate_looks(gate) for gate in problem.gates] for problem in problems]),
        "text_board_seen": np.zeros(count, np.float32),
        "text_target": np.array([problem.target for problem in problems]),
        "text_open": np.zeros(count, np.bool_),
        "text_named": np.full(count, -1),
    }
    concept = readings.index.column("concept")
    for row, problem in enumerate(problems):
        for place, label in enumerate(problem.labels):
            batch["text_panels"][row, place] = readings.draw(rng, label, mix.doubt)
        if problem.board is not None:
            if rng.random() < mix.hidden:
                batch["text_open"][row] = problem.family != "directive"
            else:
                batch["text_board"][row] = readings.draw(rng, problem.board, mix.doubt)
                batch["text_board_seen"][row] = 1.0
        if problem.family in _NAMING and problem.target != ABSENT and not batch["text_open"][row]:
            batch["text_named"][row] = readings.index.of(problem.labels[problem.target])[concept]
    return batch


def text_loss(
    language: Language, schema: AttributeSchema, words: Tensor, batch: dict[str, Tensor]
) -> tuple[Tensor, Tensor]:
    """Loss of sentences about described scenes, and their logits (T, 4); fields as in `described`.

    `words` (T, L, W) are the encoded sentences. Those that are open have no knowable right gate: the target prefers no
    gate.
    """
    target, named = batch["text_target"], batch["text_named"]
    query, absent = language(words, batch["text_board"].float(), batch["text_board_seen"])
    looks = F.one_hot(batch["text_looks"], 8).sum(-2).float()
    match = language.match(query[:, None], batch["text_panels"], looks)[:, 0]
    logits = torch.cat([match, absent[:, None]], dim=1)
    # Three panels are too few to separate a wrong sum from a right one: a single concept is classified among all.
    concepts = schema.groups["concept"]
    among_all = language.scores(query)[:, concepts]
    naming = F.cross_entropy(among_all, (named - concepts.start).clamp(min=0), reduction="none")
    known = (named >= 0).float()
    evenly = -logits[:, :SLOTS].log_softmax(-1).mean(-1)
    choice = torch.where(batch["text_open"], evenly, F.cross_entropy(logits, target, reduction="none")).mean()
    return choice + _NAMING_SHARE * (naming * known).sum() / known.sum().clamp(min=1), logits


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
