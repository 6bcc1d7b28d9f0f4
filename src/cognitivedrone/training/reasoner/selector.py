"""The gate selector as a training task: sentences and described scenes, without images.

Its tasks come from the generators of all families, including the hard ones, with training ingredients. Panels are
described as the panel reader would describe them, with its own doubts and errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.reasoner_file import SELECTOR_FILE
from cognitivedrone.models.words.gate_selector import GateSelector, SelectorConfig
from cognitivedrone.models.words.scene_tokens import INPUTS, SceneTokenizer, stacked
from cognitivedrone.reasoners.scene_text import ReadScene, SceneWriter
from cognitivedrone.training.language.problems import NAMES, SHARES, Mix, Problem, Problems
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.calibration import calibration_crops, temperature_of
from cognitivedrone.training.perception.readings import Readings, readings_of
from cognitivedrone.training.reasoner.selector_files import ORIGIN, packaged_pieces, pretrained_pieces, take_pretrained
from cognitivedrone.training.trainer.start import StartingPoint, read_start
from cognitivedrone.training.trainer.training_task import Batch, Batches, Given, Learner, Recipe, Row, to_tensors
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

_VALIDATION = 10**6
_POOL = 8  # batches that are drawn at once and sorted by length: padding costs as much as text


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectorRecipe(Recipe):
    """Everything that determines a training run of the gate selector, except its start, processes and seed."""

    network: SelectorConfig = field(default_factory=SelectorConfig)
    pretrained: bool = True
    """Whether it starts from the pretrained encoder."""
    batch: int = 24
    """Problems; processes share them."""
    validation_tasks: int = 600
    mix: Mix = field(default_factory=lambda: Mix(families=SHARES | {"memory": 0.6}, earlier=0.08))
    doubt: float = 0.5
    """Share of attributes that are read with the reader's own doubts."""

    model_file: ClassVar[str] = SELECTOR_FILE
    needs_start: ClassVar[bool] = True

    def training(self, given: Given) -> SelectorTraining:
        """A new gate selector, for what the panel reader of the policy reads."""
        pieces = pretrained_pieces() if self.pretrained else packaged_pieces()
        network = replace(self.network, pieces=len(pieces))
        return SelectorTraining(replace(self, network=network), pieces, read_start(given.start, "reader"))


class SelectorEncoder:
    """Writes problems as a reader reports them, and encodes them as inputs of the gate selector."""

    def __init__(self, doubt: float, tokenizer: SceneTokenizer, readings: Readings) -> None:
        self._doubt, self._tokenizer, self._readings = doubt, tokenizer, readings
        self._writer = SceneWriter(readings.index.schema)

    def scene(self, rng: np.random.Generator, problem: Problem) -> ReadScene:
        """A problem's scene as a reader could have read it."""
        size = len(self._readings.index.schema.names)
        return ReadScene(
            panels=np.stack([self._read(rng, label) for label in problem.labels]),
            looks=np.stack([look_of(gate) for gate in problem.gates]),
            board=np.zeros(size, np.float32) if problem.board is None else self._read(rng, problem.board),
            earlier=[
                [(self._read(rng, label), int(place == flown)) for place, label in enumerate(labels)]
                for labels, flown in problem.before
            ],
        )

    def encode(self, rng: np.random.Generator, problem: Problem) -> tuple[NDArray[np.int64], ...]:
        """Tokens, positions and parts of one problem."""
        text = self._writer.write(problem.sentence, self.scene(rng, problem))
        return self._tokenizer.encode(text.parts)

    def batches(self, rng: np.random.Generator, problems: Sequence[Problem], size: int) -> list[Batch]:
        """All of the problems in batches of similar lengths, with their targets and families."""
        encoded = [self.encode(rng, problem) for problem in problems]
        order = sorted(range(len(problems)), key=lambda number: len(encoded[number][0]))
        return [
            {
                **stacked([encoded[number] for number in part]),
                "target": np.array([problems[number].target for number in part]),
                "family": np.array([NAMES.index(problems[number].family) for number in part]),
            }
            for part in (order[first : first + size] for first in range(0, len(order), size))
        ]

    def _read(self, rng: np.random.Generator, label: str) -> NDArray[np.float32]:
        return self._readings.draw(rng, label, self._doubt)


def look_of(gate: Gate) -> NDArray[np.float32]:
    """(8,) colours, shapes and sizes of a gate, one of each."""
    attributes = [gate.color == name for name in COLORS] + [gate.shape == name for name in SHAPES]
    return np.array([*attributes, *(gate.size == name for name in SIZES)], dtype=np.float32)


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
        """Logits (B, 4)."""
        logits: Tensor = self.network(*(batch[name] for name in INPUTS))
        return logits.float()


@dataclass(frozen=True)
class SelectorTraining:
    """Training task of the gate selector."""

    recipe: SelectorRecipe
    pieces: tuple[str, ...]
    start: StartingPoint
    """The panel reader that it listens to, or a policy with it."""

    def identity(self) -> dict[str, Any]:
        """Its recipe, and the origin of policy and encoder."""
        pretrained = f"; {ORIGIN}" if self.recipe.pretrained else ""
        return {"recipe": self.recipe.facts(), "data": f"{self.start.origin}{pretrained}"}

    def facts(self) -> dict[str, Any]:
        """Word pieces and attribute values."""
        return {
            "pieces": list(self.pieces),
            "attributes": self.start.facts["attributes"],
            "policy": str(self.start.path),
        }

    def network(self) -> GateSelector:
        """A new gate selector, which knows English already; what it knows of single words stays as it is."""
        network = GateSelector(self.recipe.network)
        if self.recipe.pretrained:
            take_pretrained(network)
        network.words.requires_grad_(requires_grad=False)
        return network

    def loss_module(self, network: nn.Module) -> SelectorLoss:
        """The gate selector with its loss."""
        assert isinstance(network, GateSelector)  # noqa: S101  (for the type checker)
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
            problems = Problems(self.recipe.mix)
            while True:
                pool = encoder.batches(rng, drawn(problems, rng, _POOL * self.recipe.batch), self.recipe.batch)
                for number in rng.permutation(len(pool)):
                    yield pool[int(number)]

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Problems of another seed, with the family of each."""
        rng = np.random.default_rng((seed, _VALIDATION))
        problems = drawn(Problems(self.recipe.mix), rng, self.recipe.validation_tasks)
        return self._encoder().batches(rng, problems, 2 * self.recipe.batch)

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
        """The calibrated gate selector and the picture classifier; the policy's export has a reasoner's other files."""
        from cognitivedrone.training.reasoner.classifier import write_classifier
        from cognitivedrone.training.reasoner.selector_files import export_selector

        export_selector(checkpoint, folder, self.temperature)
        if self.recipe.pretrained:
            write_classifier(folder)

    def temperature(self, choose: Callable[[Batch], Tensor]) -> float:
        """The temperature at which the probabilities of a gate selector, given as its logits (B, 4) of a batch, are
        right, for panels drawn by artists that were never trained, all of them read with their doubts.
        """
        index = AttributeIndex(self.start.facts["attributes"])
        readings = readings_of(self.start, index, lambda size: calibration_crops(size, index))
        encoder = SelectorEncoder(1.0, SceneTokenizer(self.pieces), readings)
        rng = np.random.default_rng((0, _VALIDATION + 2))
        problems = drawn(Problems(self.recipe.mix), rng, self.recipe.validation_tasks)
        batches = encoder.batches(rng, problems, 2 * self.recipe.batch)
        logits = torch.cat([choose(batch) for batch in batches])
        return temperature_of(logits, torch.cat([torch.from_numpy(batch["target"]) for batch in batches]))

    def _encoder(self) -> SelectorEncoder:
        index = AttributeIndex(self.start.facts["attributes"])
        return SelectorEncoder(self.recipe.doubt, SceneTokenizer(self.pieces), readings_of(self.start, index))


def drawn(problems: Problems, rng: np.random.Generator, count: int) -> list[Problem]:
    """So many problems."""
    found: list[Problem] = []
    while len(found) < count:
        found += problems.draw(rng)
    return found[:count]


SELECTOR = SelectorRecipe(
    name="selector",
    steps=4_000,
    learning_rate=1e-4,
    warmup_steps=50,
    decay_share=0.8,
    weight_decay=0.01,
    round_steps=50,
    validate_every=500,
)
DEBUG_SELECTOR = replace(
    SELECTOR,
    name="debug-selector",
    network=SelectorConfig(width=32, layers=2, apart=1, heads=2, hidden=64),
    pretrained=False,
    steps=6,
    warmup_steps=1,
    batch=8,
    validation_tasks=32,
    round_steps=2,
    validate_every=2,
)
"""The whole path in seconds, for tests."""
