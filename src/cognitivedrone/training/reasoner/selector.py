"""The gate selector as a training task: sentences and described scenes, without images.

Its tasks come from the generators of all families, including the hard ones, with training ingredients. Panels are
described as the panel reader would tell them, with its own doubts and errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.gate_selector import GateSelector, SelectorConfig
from cognitivedrone.models.reasoner_file import REMEMBERED, SELECTOR_FILE
from cognitivedrone.models.sentence import WordConfig
from cognitivedrone.models.small_vla import Language
from cognitivedrone.models.text import TOKEN, Lexicon
from cognitivedrone.reasoners.calculator import calculate, evaluate
from cognitivedrone.reasoners.small import value_index
from cognitivedrone.training.common.attributes import AttributeIndex
from cognitivedrone.training.common.calibration import calibration_crops, temperature_of
from cognitivedrone.training.common.lexicon import training_lexicon, with_vectors
from cognitivedrone.training.common.problems import NAMES, SHARES, Mix, Problem, Problems
from cognitivedrone.training.common.readings import Readings, readings_of
from cognitivedrone.training.common.sampling import Batch, token_noise
from cognitivedrone.training.common.start import Start, read_start
from cognitivedrone.training.common.training_task import Batches, Given, Learner, Recipe, Row, to_tensors
from cognitivedrone.training.small_vla.trained import trained
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

_VALIDATION = 10**6


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectorRecipe(Recipe):
    """Everything that determines a training run of the gate selector, except its start, processes and seed."""

    network: SelectorConfig = field(default_factory=SelectorConfig)
    batch: int = 256
    """Tasks; processes share them."""
    validation_tasks: int = 3000
    mix: Mix = field(default_factory=lambda: Mix(families=SHARES | {"memory": 0.6}, earlier=0.15))
    earlier_from: int = 4_000
    """First step with earlier stages: from the start, they would teach to ignore the memory before it is understood."""
    doubt: float = 0.5
    """Share of attributes that are read with the reader's own doubts."""
    lost_words: float = 0.03
    """Share of words that are not understood at all."""
    strange_words: float = 0.05
    """Share of words in whose place a word stands that no training sentence has: that a sentence is not understood is
    no sign that no gate matches the instruction."""
    hidden_words: float = 0.25
    """Share of words that are read by their word vector and spelling alone, as synonyms are that were never trained."""
    token_noise: float = 0.3
    """Share of sentences with token noise: words lost, left out and added."""

    model_file: ClassVar[str] = SELECTOR_FILE
    needs_start: ClassVar[bool] = True

    def training(self, given: Given) -> SelectorTraining:
        """A new gate selector, for what the panel reader of the policy tells."""
        lexicon = training_lexicon(self.mix)
        network = replace(self.network, words=WordConfig(len(lexicon.words), lexicon.trained))
        return SelectorTraining(replace(self, network=network), lexicon, read_start(given.start, "policy"))


class Encoder:
    """Encodes problems as inputs of the gate selector."""

    def __init__(self, recipe: SelectorRecipe, lexicon: Lexicon, readings: Readings) -> None:
        self._recipe, self._lexicon, self._readings = recipe, lexicon, readings
        self._strange = np.array([lexicon.encode(word, 1)[0] for word in lexicon.words[lexicon.trained :]])

    def encode(self, rng: np.random.Generator, problems: list[Problem], *, noise: bool) -> Batch:
        """A batch; with `noise`, words are lost."""
        n, length, size = len(problems), self._recipe.network.text_length, len(self._readings.index.schema.names)
        batch: Batch = {
            "tokens": np.zeros((n, length, TOKEN), np.int64),
            "panels": np.zeros((n, 3, size), np.float32),
            "looks": np.zeros((n, 3, 8), np.float32),
            "board": np.zeros((n, size), np.float32),
            "values": np.zeros((n, 5), np.int64),
            "remembered": np.zeros((n, REMEMBERED, size), np.float32),
            "stages": np.full((n, REMEMBERED, 3), -1, np.int64),
            "target": np.array([problem.target for problem in problems]),
        }
        for row, problem in enumerate(problems):
            batch["tokens"][row] = self._tokens(rng, problem.sentence, noise=noise)
            batch["looks"][row] = [look_of(gate) for gate in problem.gates]
            for place, label in enumerate(problem.labels):
                batch["panels"][row, place] = self._read(rng, label)
            if problem.board is not None:
                batch["board"][row] = self._read(rng, problem.board)
            batch["values"][row] = values_of(problem.sentence, problem.labels, problem.board)
            for stage, (labels, flown) in enumerate(problem.before):
                for place, label in enumerate(labels):
                    at = 3 * stage + place
                    batch["remembered"][row, at] = self._read(rng, label)
                    batch["stages"][row, at] = stage, len(problem.before) - 1 - stage, int(place == flown)
        return batch

    def _read(self, rng: np.random.Generator, label: str) -> NDArray[np.float32]:
        return self._readings.draw(rng, label, self._recipe.doubt)

    def _tokens(self, rng: np.random.Generator, sentence: str, *, noise: bool) -> NDArray[np.int64]:
        tokens = self._lexicon.encode(sentence, self._recipe.network.text_length)
        if not noise:
            return tokens
        lost = (rng.random(len(tokens)) < self._recipe.lost_words) & (tokens[:, 0] > 0)
        tokens[lost] = 0
        tokens[lost, 0] = 1
        if len(self._strange):
            strange = (rng.random(len(tokens)) < self._recipe.strange_words) & (tokens[:, 0] > 0)
            tokens[strange] = self._strange[rng.integers(len(self._strange), size=int(strange.sum()))]
        return token_noise(rng, tokens) if rng.random() < self._recipe.token_noise else tokens


def look_of(gate: Gate) -> NDArray[np.float32]:
    """(8,) colours, shapes and sizes of a gate, one of each."""
    told = [gate.color == name for name in COLORS] + [gate.shape == name for name in SHAPES]
    return np.array([*told, *(gate.size == name for name in SIZES)], dtype=np.float32)


def values_of(sentence: str, labels: tuple[str, ...], board: str | None) -> list[int]:
    """The five input values of the gate selector: of the sums on panels and board, and of the sum in the sentence."""
    on_panels = [_sum(label) for label in labels]
    on_board = None if board is None else _sum(board)
    return [value_index(value) for value in (*on_panels, on_board, calculate(sentence, on_board))]


def _sum(label: str) -> int | None:
    kind, _, rest = label.partition("/")
    return evaluate(rest.rpartition("@")[0]) if kind == "sum" else None


class SelectorLoss(nn.Module):
    """The gate selector and its loss."""

    def __init__(self, network: GateSelector) -> None:
        super().__init__()
        self.network = network

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, loss and accuracy of the choice."""
        logits = self.logits(batch)
        loss = F.cross_entropy(logits, batch["target"])
        right = (logits.argmax(-1) == batch["target"]).float().mean()
        return loss, {"choice": loss.detach(), "choice accuracy": right.detach()}

    def logits(self, batch: dict[str, Tensor]) -> Tensor:
        """Logits (B, 4); skips unused words and memories."""
        words = int((batch["tokens"][..., 0] != 0).sum(1).max())
        panels = int((batch["stages"][..., 0] >= 0).sum(1).max())
        logits: Tensor = self.network(
            batch["tokens"][:, :words],
            batch["panels"],
            batch["looks"],
            batch["board"],
            batch["values"],
            batch["remembered"][:, :panels],
            batch["stages"][:, :panels],
        )
        return logits.float()


def take_language(network: GateSelector, lexicon: Lexicon, language: Language, known: Lexicon) -> None:
    """Start a gate selector with what a policy's language, for the words `known`, has learnt of words and sentences."""
    rows = {word: row for row, word in enumerate(known.words[: known.trained])}
    with torch.no_grad():
        for row, word in enumerate(lexicon.words[: lexicon.trained]):
            if word in rows:
                network.words.own.weight[row] = language.words.own.weight[rows[word]]
        network.words.groups.load_state_dict(language.words.groups.state_dict())
        network.words.meaning.load_state_dict(language.words.meaning.state_dict())
        length = min(len(network.places), len(language.places))
        network.places[:length] = language.places[:length]
        network.layers.load_state_dict(language.layers.state_dict())


@dataclass(frozen=True)
class SelectorTraining:
    """Training task of the gate selector."""

    recipe: SelectorRecipe
    lexicon: Lexicon
    start: Start
    """The policy whose panel reader it listens to."""

    def identity(self) -> dict[str, Any]:
        """Its recipe, and the policy's origin."""
        return {"recipe": self.recipe.facts(), "data": self.start.origin}

    def facts(self) -> dict[str, Any]:
        """Words and attribute values."""
        return {
            "vocabulary": list(self.lexicon.words),
            "trained_words": self.lexicon.trained,
            "attributes": self.start.facts["attributes"],
            "policy": str(self.start.path),
        }

    def network(self) -> GateSelector:
        """A new gate selector, which knows the policy's language already."""
        network = GateSelector(self.recipe.network, len(self.start.facts["attributes"]))
        with_vectors(network.words, self.lexicon)
        network.words.hidden = self.recipe.hidden_words
        policy, known = trained(self.start)
        if (policy.config.text_width, policy.config.text_layers) == (self.recipe.network.width, len(network.layers)):
            take_language(network, self.lexicon, policy.language, known)
        return network

    def loss_module(self, network: nn.Module) -> SelectorLoss:
        """The gate selector with its loss."""
        assert isinstance(network, GateSelector)  # noqa: S101  (tells the type checker)
        return SelectorLoss(network)

    def learner(self, network: nn.Module) -> None:
        """None: a gate selector does not fly."""
        del network

    def share(self, processes: int) -> SelectorTraining:
        """Processes share the problems."""
        return replace(self, recipe=replace(self.recipe, batch=-(-self.recipe.batch // processes)))

    def batches(self) -> Batches:
        """Endless problems."""
        encoder = self._encoder()

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng = np.random.default_rng(seed)
            early = seed[-1] * self.recipe.round_steps < self.recipe.earlier_from
            problems = Problems(replace(self.recipe.mix, earlier=0.0) if early else self.recipe.mix)
            waiting: list[Problem] = []
            while True:
                while len(waiting) < self.recipe.batch:
                    waiting += problems.draw(rng)
                now, waiting = waiting[: self.recipe.batch], waiting[self.recipe.batch :]
                yield encoder.encode(rng, now, noise=True)

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Problems of another seed, with all of their words; with the family of each."""
        rng = np.random.default_rng((seed, _VALIDATION))
        drawn, encoder = Problems(self.recipe.mix), self._encoder()
        problems: list[Problem] = []
        while len(problems) < self.recipe.validation_tasks:
            problems += drawn.draw(rng)
        parts = [problems[first : first + 250] for first in range(0, len(problems), 250)]
        families = [np.array([NAMES.index(problem.family) for problem in part]) for part in parts]
        encoded = [encoder.encode(rng, part, noise=False) for part in parts]
        return [batch | {"family": family} for batch, family in zip(encoded, families, strict=True)]

    def validate(self, loss_module: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """Loss and accuracy of the choice, overall and by family."""
        assert isinstance(loss_module, SelectorLoss)  # noqa: S101
        device = next(loss_module.parameters()).device
        loss_module.eval()
        losses, rights = [], []
        with torch.no_grad(), autocast():
            for batch in batches:
                tensors = to_tensors(batch, device)
                logits = loss_module.logits(tensors)
                losses.append(F.cross_entropy(logits, tensors["target"], reduction="none"))
                rights.append(logits.argmax(-1) == tensors["target"])
        loss_module.train()
        right, family = torch.cat(rights).cpu().numpy(), np.concatenate([batch["family"] for batch in batches])
        row: Row = {"choice": float(torch.cat(losses).mean()), "choice accuracy": float(right.mean())}
        for index in np.unique(family):
            row[f"choice accuracy {NAMES[index]}"] = float(right[family == index].mean())
        return row

    def trial(self, network: nn.Module) -> Row:
        """Empty: there are no trials beside the curves."""
        del network
        return {}

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The files of gate selector and panel reader, which belong together; the gate selector is calibrated."""
        from cognitivedrone.training.reasoner.export import export_panel_reader, export_selector

        export_selector(checkpoint, folder, self.temperature)
        export_panel_reader(self.start, folder)

    def temperature(self, network: GateSelector) -> float:
        """The temperature at which a trained gate selector's probabilities are right, for panels drawn by artists that
        were never trained, all of them read with their doubts.
        """
        index = AttributeIndex(self.start.facts["attributes"])
        recipe = replace(self.recipe, doubt=1.0)
        readings = readings_of(self.start, index, lambda size: calibration_crops(size, index))
        encoder = Encoder(recipe, self.lexicon, readings)
        rng, drawn = np.random.default_rng((0, _VALIDATION + 2)), Problems(recipe.mix)
        loss_module, logits, targets = SelectorLoss(network).eval(), [], []
        for _ in range(-(-recipe.validation_tasks // 250)):
            problems: list[Problem] = []
            while len(problems) < 250:
                problems += drawn.draw(rng)
            batch = to_tensors(encoder.encode(rng, problems[:250], noise=False))
            with torch.no_grad():
                logits.append(loss_module.logits(batch) * network.temperature)
            targets.append(batch["target"])
        return temperature_of(torch.cat(logits), torch.cat(targets))

    def _encoder(self) -> Encoder:
        index = AttributeIndex(self.start.facts["attributes"])
        return Encoder(self.recipe, self.lexicon, readings_of(self.start, index))


SELECTOR = SelectorRecipe(name="selector", steps=7_000, learning_rate=1e-3, warmup_steps=300)
