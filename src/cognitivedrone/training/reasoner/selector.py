"""The gate selector as a training task: sentences and described scenes, without images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.words.gate_selector import GateSelector, SelectorConfig
from cognitivedrone.models.words.scene_tokens import INPUTS, SceneTokenizer, stacked
from cognitivedrone.models.words.selector_file import SELECTOR_FILE
from cognitivedrone.reasoners.scene_text import ReadScene, SceneWriter
from cognitivedrone.training.language.problems import NAMES, SHARES, Mix, Problem
from cognitivedrone.training.language.text_training import TextLoss, TextMix, TextRecipe, TextTraining
from cognitivedrone.training.perception.readings import Readings
from cognitivedrone.training.reasoner.selector_files import ORIGIN, packaged_pieces, pretrained_pieces, take_pretrained
from cognitivedrone.training.trainer.start import StartingPoint, read_start
from cognitivedrone.training.trainer.training_task import Batch, Given
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectorRecipe(TextRecipe):
    """Everything that determines a training run of the gate selector, except its start, processes and seed."""

    network: SelectorConfig = field(default_factory=SelectorConfig)
    pretrained: bool = True
    """Whether it starts from the pretrained encoder."""

    model_file: ClassVar[str] = SELECTOR_FILE

    def training(self, given: Given) -> SelectorTraining:
        """A new gate selector, for what the panel reader of the policy reads."""
        pieces = pretrained_pieces() if self.pretrained else packaged_pieces()
        network = replace(self.network, pieces=len(pieces))
        return SelectorTraining(replace(self, network=network), pieces, read_start(given.start, "reader"))


def scene_of(rng: np.random.Generator, problem: Problem, readings: Readings, doubt: float) -> ReadScene:
    """A problem's scene as a reader could have read it."""

    def read(label: str) -> NDArray[np.float32]:
        return readings.draw(rng, label, doubt)

    size = len(readings.index.schema.names)
    return ReadScene(
        panels=np.stack([read(label) for label in problem.labels]),
        looks=np.stack([look_of(gate) for gate in problem.gates]),
        board=np.zeros(size, np.float32) if problem.board is None else read(problem.board),
        earlier=[
            [(read(label), int(place == flown)) for place, label in enumerate(labels)]
            for labels, flown in problem.before
        ],
    )


def look_of(gate: Gate) -> NDArray[np.float32]:
    """(8,) colours, shapes and sizes of a gate, one of each."""
    attributes = [gate.color == name for name in COLORS] + [gate.shape == name for name in SHAPES]
    return np.array([*attributes, *(gate.size == name for name in SIZES)], dtype=np.float32)


class SelectorLoss(TextLoss):
    """The gate selector and its loss."""

    measure = "choice"

    def __init__(self, network: GateSelector) -> None:
        super().__init__()
        self.network = network

    def answers(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """The loss, and logits (T, 4)."""
        logits = self.network(*(batch[name] for name in INPUTS)).float()
        return F.cross_entropy(logits, batch["text_target"]), logits


@dataclass(frozen=True)
class SelectorTraining(TextTraining):
    """Training task of the gate selector."""

    recipe: SelectorRecipe
    pieces: tuple[str, ...]
    reader: StartingPoint

    def identity(self) -> dict[str, Any]:
        """Its recipe, and the origin of policy and encoder."""
        pretrained = f"; {ORIGIN}" if self.recipe.pretrained else ""
        return super().identity() | {"data": f"{self.reader.origin}{pretrained}"}

    def facts(self) -> dict[str, Any]:
        """Word pieces and attribute values."""
        facts = self.reader.facts
        return {"pieces": list(self.pieces), "attributes": facts["attributes"], "policy": str(self.reader.path)}

    def network(self) -> GateSelector:
        """A new gate selector, which knows English already; what it knows of single words stays as it is."""
        network = GateSelector(self.recipe.network)
        if self.recipe.pretrained:
            take_pretrained(network)
        network.words.requires_grad_(requires_grad=False)
        return network

    def loss_module(self, network: GateSelector) -> SelectorLoss:
        """The gate selector with its loss."""
        return SelectorLoss(network)

    def described(
        self, rng: np.random.Generator, problems: Sequence[Problem], size: int, readings: Readings, mix: TextMix
    ) -> list[Batch]:
        """The problems as the reasoner writes them, encoded: `INPUTS`, `text_target` and `family`."""
        writer, tokenizer = SceneWriter(readings.index.schema), SceneTokenizer(self.pieces)
        encoded = [
            tokenizer.encode(writer.write(each.sentence, scene_of(rng, each, readings, mix.doubt)).parts)
            for each in problems
        ]
        order = sorted(range(len(problems)), key=lambda number: len(encoded[number][0]))
        return [
            {
                **stacked([encoded[number] for number in part]),
                "text_target": np.array([problems[number].target for number in part]),
                "family": np.array([NAMES.index(problems[number].family) for number in part]),
            }
            for part in (order[first : first + size] for first in range(0, len(order), size))
        ]

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The calibrated gate selector and the picture classifier; the policy's export has a reasoner's other files."""
        from cognitivedrone.training.reasoner.classifier import write_classifier
        from cognitivedrone.training.reasoner.selector_files import export_selector

        export_selector(checkpoint, folder, self.temperature)
        if self.recipe.pretrained:
            write_classifier(folder)


SELECTOR = SelectorRecipe(
    name="selector",
    steps=4_000,
    learning_rate=1e-4,
    warmup_steps=50,
    decay_share=0.8,
    weight_decay=0.01,
    round_steps=50,
    validate_every=500,
    batch=24,
    validation_sentences=600,
    mix=TextMix(problems=Mix(families=SHARES | {"memory": 0.6}, earlier=0.08), hidden=0.0),
)
DEBUG_SELECTOR = replace(
    SELECTOR,
    name="debug-selector",
    network=SelectorConfig(width=32, layers=2, apart=1, heads=2, hidden=64),
    pretrained=False,
    steps=6,
    warmup_steps=1,
    batch=8,
    validation_sentences=32,
    round_steps=2,
    validate_every=2,
)
"""The whole path in seconds, for tests."""
