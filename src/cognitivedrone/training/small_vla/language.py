"""Training of language: the text encoder, and what its sentences mean among described scenes. It needs no frames.

The encoder begins as that of a trained gate selector, which began as a pretrained one; attribute values begin as their
names in its words. So what a name means that no training sentence has is not lost. Word embeddings and first layers
stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import SLOTS
from cognitivedrone.models.eyes.panel_reader import Reader, ReaderConfig
from cognitivedrone.models.words.gate_selector import SelectorConfig
from cognitivedrone.models.words.language import Language, LanguageConfig, TextEncoder
from cognitivedrone.models.words.scene_tokens import INPUTS, SceneTokenizer, number_text, stacked
from cognitivedrone.models.words.text_encoder import FILE, parts_of
from cognitivedrone.training.language.problems import ABSENT, ALONE, NAMES, Mix, Problem
from cognitivedrone.training.language.text_training import TextLoss, TextMix, TextRecipe, TextTraining
from cognitivedrone.training.perception.attributes import gate_looks
from cognitivedrone.training.perception.readings import Readings
from cognitivedrone.training.trainer.start import StartingPoint, read_start, restore_part
from cognitivedrone.training.trainer.training_task import Batch, Given
from cognitivedrone.types import COLORS, SHAPES, SIZES

_NAMING = frozenset({"letters", "digits", "logos", "animals", "math", "math_board", "distraction", "two_step"})
"""Families whose sentences mean one concept, regardless of the other options."""
_NAMING_SHARE = 0.3  # weight of naming the right concept, beside choosing among three


def described(
    rng: np.random.Generator, problems: Sequence[Problem], tokenizer: SceneTokenizer, readings: Readings, mix: TextMix
) -> Batch:
    """Sentences with described scenes, T of them: `tokens`, `positions`, `parts` (T, L) as the text encoder takes them,
    and the fields of `scenes`.
    """
    tokens = stacked([tokenizer.encode(parts_of(problem.sentence)) for problem in problems])
    return {**tokens, **scenes(rng, problems, readings, mix)}


def scenes(rng: np.random.Generator, problems: Sequence[Problem], readings: Readings, mix: TextMix) -> Batch:
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


class LanguageLoss(TextLoss):
    """Text encoder and language, with their loss."""

    measure = "text"

    def __init__(self, network: LanguageNetwork, schema: AttributeSchema) -> None:
        super().__init__()
        self.network = network
        self._schema = schema

    def answers(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """The loss, and logits (T, 4)."""
        words = self.network.encoder(*(batch[name] for name in INPUTS))
        return text_loss(self.network.language, self._schema, words, batch)


_LENGTH = 0.7  # of the vectors that attribute values begin with


@dataclass(frozen=True, slots=True, kw_only=True)
class LanguageRecipe(TextRecipe):
    """Everything that determines a training run on language, except its start, processes and seed."""

    network: LanguageConfig = field(default_factory=LanguageConfig)

    model_file: ClassVar[str] = FILE

    def training(self, given: Given) -> LanguageTraining:
        """With the encoder of the gate selector whose checkpoint is given, and the panel reader that it listens to."""
        if given.start is None or str(given.start) == "small":
            raise TrainingError(
                "the recipe language starts from a gate selector; give its checkpoint, as in --start"
                " out/selector/checkpoint.safetensors"
            )
        selector = read_start(given.start, "selector")
        reader = read_start(Path(selector.facts["policy"]), "reader")
        network = replace(self.network, size=selector.facts["recipe"]["network"]["width"])
        return LanguageTraining(replace(self, network=network), selector, reader)


_FAMILIES = ALONE | {"exclusion": 0.12, "attributes": 0.12, "relations": 0.06, "counting": 0.02}
LANGUAGE = LanguageRecipe(
    name="language",
    steps=3_400,
    learning_rate=1e-3,
    warmup_steps=50,
    decay_share=0.7,
    weight_decay=0.01,
    clip=1.0,
    mix=TextMix(problems=Mix(families=_FAMILIES, lacking=0.3)),
)
DEBUG_LANGUAGE = replace(
    LANGUAGE,
    name="debug-language",
    network=LanguageConfig(width=24, layers=1, heads=2),
    steps=4,
    warmup_steps=1,
    batch=8,
    validation_sentences=32,
    round_steps=2,
    validate_every=2,
)
"""The whole path in seconds, for tests."""


@dataclass(frozen=True)
class LanguageTraining(TextTraining):
    """Training task of text encoder and language."""

    recipe: LanguageRecipe
    selector: StartingPoint
    """The gate selector whose encoder it begins with."""
    reader: StartingPoint

    def identity(self) -> dict[str, Any]:
        """Recipe, with the sizes of all networks, and the starts."""
        network = {
            "encoder": self.selector.facts["recipe"]["network"],
            "language": self.recipe.network.facts(),
            "reader": self.reader.reader_facts(),
        }
        return {
            "recipe": self.recipe.facts() | {"network": network},
            "data": f"{self.selector.origin}; {self.reader.origin}",
        }

    def facts(self) -> dict[str, Any]:
        """Word pieces, and attribute values."""
        return {"pieces": self.selector.facts["pieces"], "attributes": self.reader.facts["attributes"]}

    @property
    def tokenizer(self) -> SceneTokenizer:
        """Of the encoder's word pieces."""
        return SceneTokenizer(self.selector.facts["pieces"])

    def network(self) -> LanguageNetwork:
        """The encoder of the gate selector, and a language that knows the names of attribute values."""
        names = self.reader.facts["attributes"]
        network = LanguageNetwork(
            SelectorConfig.of(self.selector.facts["recipe"]["network"]),
            self.recipe.network,
            ReaderConfig.of(self.reader.reader_facts()),
            names,
        )
        restore_part(self.reader, "reader", network.reader)
        weights = self.selector.tensors()
        own = {name: weights[name][: len(value)] for name, value in network.encoder.state_dict().items()}
        network.encoder.load_state_dict(own)
        with torch.no_grad():
            network.eval()
            meanings = _meanings(network.encoder, self.tokenizer, [spoken(name) for name in names])
            for span in self.index.groups.values():
                meanings[span] = F.normalize(meanings[span] - meanings[span].mean(0), dim=-1)
            network.language.prototypes.copy_(_LENGTH * meanings)
            looks = _meanings(network.encoder, self.tokenizer, [f"{word} gate" for word in (*COLORS, *SHAPES, *SIZES)])
            network.language.looks.copy_(_LENGTH * F.normalize(looks - looks.mean(0), dim=-1))
        return network.train()

    def loss_module(self, network: LanguageNetwork) -> LanguageLoss:
        """The network with its loss."""
        return LanguageLoss(network, self.index.schema)

    def described(
        self, rng: np.random.Generator, problems: Sequence[Problem], size: int, readings: Readings, mix: TextMix
    ) -> list[Batch]:
        """As `described.described`, with `family`."""
        ordered, tokenizer = sorted(problems, key=lambda problem: len(problem.sentence)), self.tokenizer
        return [
            described(rng, part, tokenizer, readings, mix)
            | {"family": np.array([NAMES.index(problem.family) for problem in part])}
            for part in (ordered[first : first + size] for first in range(0, len(ordered), size))
        ]

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The text encoder; and the language in the checkpoint is calibrated."""
        from cognitivedrone.training.small_vla.export import export_language

        export_language(checkpoint, folder, self.temperature)


def spoken(name: str) -> str:
    """The name of an attribute value in words: "concept/letter:A" is "letter A", "hat_color/red" "hat color red"."""
    group, _, value = name.partition("/")
    kind, _, concept = value.partition(":")
    words = (concept or kind).replace("_", " ")
    if group != "concept":
        return f"{group.replace('_', ' ')} {words}"
    if kind == "number":
        return f"number {number_text(int(words)) if words.isdecimal() else words}"
    return {"letter": f"letter {words}", "logo": f"logo of {words}"}.get(kind, words)


def _meanings(encoder: TextEncoder, tokenizer: SceneTokenizer, texts: Sequence[str]) -> Tensor:
    """(n, W) of texts, each of length 1."""
    batch = stacked([tokenizer.encode((text,)) for text in texts])
    words = encoder(*(torch.from_numpy(batch[name]) for name in INPUTS))
    return F.normalize(words.sum(1), dim=-1)  # the mean's direction: padding is zero
