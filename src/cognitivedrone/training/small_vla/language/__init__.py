"""Training of language: the text encoder, and what its sentences mean among described scenes. It needs no frames.

The encoder begins as that of a trained gate selector, which began as a pretrained one; attribute values begin as their
names in its words. So what a name means that no training sentence has is not lost. Word embeddings and first layers
stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.eyes.panel_reader import ReaderConfig
from cognitivedrone.models.words.gate_selector import SelectorConfig
from cognitivedrone.models.words.language import LanguageConfig, TextEncoder
from cognitivedrone.models.words.scene_tokens import INPUTS, SceneTokenizer, number_text, stacked
from cognitivedrone.models.words.text_encoder import FILE
from cognitivedrone.training.language.problems import ALONE, NAMES, Mix, Problem, Problems
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.calibration import calibration_crops, temperature_of
from cognitivedrone.training.perception.readings import Readings, readings_of
from cognitivedrone.training.small_vla.language.described import LanguageLoss, LanguageNetwork, TextMix, described
from cognitivedrone.training.trainer.start import StartingPoint, read_start, restore_part
from cognitivedrone.training.trainer.training_task import Batch, Batches, Given, Learner, Recipe, Row, to_tensors
from cognitivedrone.types import COLORS, SHAPES, SIZES

_VALIDATION = 10**6
_POOL = 8  # batches that are drawn at once and sorted by length: padding costs as much as text
_LENGTH = 0.7  # of the vectors that attribute values begin with


@dataclass(frozen=True, slots=True, kw_only=True)
class LanguageRecipe(Recipe):
    """Everything that determines a training run on language, except its start, processes and seed."""

    batch: int = 64
    """Sentences; processes share them."""
    network: LanguageConfig = field(default_factory=LanguageConfig)
    mix: TextMix = field(default_factory=TextMix)
    validation_sentences: int = 2000

    model_file: ClassVar[str] = FILE
    needs_start: ClassVar[bool] = True

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
class LanguageTraining:
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
    def index(self) -> AttributeIndex:
        """The attribute values."""
        return AttributeIndex(tuple(self.reader.facts["attributes"]))

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

    def loss_module(self, network: nn.Module) -> LanguageLoss:
        """The network with its loss."""
        assert isinstance(network, LanguageNetwork)  # noqa: S101  (for the type checker)
        return LanguageLoss(network, self.index.schema)

    def learner(self, network: nn.Module) -> None:
        """None: nothing flies."""
        del network

    def share(self, processes: int) -> LanguageTraining:
        """Processes share the sentences."""
        return replace(self, recipe=replace(self.recipe, batch=-(-self.recipe.batch // processes)))

    def batches(self) -> Batches:
        """Endless sentences, in batches of similar lengths."""
        readings, tokenizer, recipe = self._readings(), self.tokenizer, self.recipe

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng, problems = np.random.default_rng(seed), Problems(recipe.mix.problems)
            while True:
                pool = _parts(problems, rng, _POOL * recipe.batch, recipe.batch)
                for number in rng.permutation(len(pool)):
                    yield described(rng, pool[int(number)], tokenizer, readings, recipe.mix)

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Sentences of another seed, with the family of each."""
        rng, problems = np.random.default_rng((seed, _VALIDATION)), Problems(self.recipe.mix.problems)
        return self._described(rng, problems, self._readings(), replace(self.recipe.mix, hidden=0.0))

    def validate(self, loss_module: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """Loss, and share of sentences that were understood, overall and by family."""
        assert isinstance(loss_module, LanguageLoss)  # noqa: S101
        device = next(loss_module.parameters()).device
        loss_module.eval()
        losses, rights = [], []
        with torch.no_grad(), autocast():
            for batch in batches:
                tensors = to_tensors(batch, device)
                loss, logits = loss_module.answers(tensors)
                losses.append(float(loss))
                rights.append((logits.argmax(-1) == tensors["text_target"]).cpu().numpy())
        loss_module.train()
        right, family = np.concatenate(rights), np.concatenate([batch["family"] for batch in batches])
        row: Row = {"text": float(np.mean(losses)), "text accuracy": float(right.mean())}
        return row | {f"text accuracy {NAMES[i]}": float(right[family == i].mean()) for i in np.unique(family)}

    def trial(self, network: nn.Module) -> Row:
        """Empty: there are no trials beside the curves."""
        del network
        return {}

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The text encoder; and the language in the checkpoint is calibrated."""
        from cognitivedrone.training.small_vla.export import export_language

        export_language(checkpoint, folder, self.temperature)

    def temperature(self, loss_module: LanguageLoss) -> float:
        """The temperature at which its probabilities are right, for panels drawn by artists that were never trained."""
        readings = readings_of(self.reader, self.index, lambda size: calibration_crops(size, self.index))
        mix = replace(self.recipe.mix, doubt=1.0, hidden=0.0)
        rng = np.random.default_rng((0, _VALIDATION + 2))
        batches = self._described(rng, Problems(mix.problems), readings, mix)
        loss_module.eval()
        with torch.no_grad():
            logits = torch.cat([loss_module.answers(to_tensors(batch, torch.device("cpu")))[1] for batch in batches])
        return temperature_of(logits, torch.cat([torch.from_numpy(batch["text_target"]) for batch in batches]))

    def _described(self, rng: np.random.Generator, problems: Problems, readings: Readings, mix: TextMix) -> list[Batch]:
        parts = _parts(problems, rng, self.recipe.validation_sentences, 100)
        return [
            described(rng, part, self.tokenizer, readings, mix)
            | {"family": np.array([NAMES.index(problem.family) for problem in part])}
            for part in parts
        ]

    def _readings(self) -> Readings:
        return readings_of(self.reader, self.index)


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


def _parts(problems: Problems, rng: np.random.Generator, count: int, size: int) -> list[list[Problem]]:
    """So many problems, in parts of similar lengths."""
    pool: list[Problem] = []
    while len(pool) < count:
        pool += problems.draw(rng)
    pool = sorted(pool[:count], key=lambda problem: len(problem.sentence))
    return [pool[first : first + size] for first in range(0, count, size)]
