"""The gate selector as a training task: sentences and scenes as read, without images.

Its tasks come from the generators of all families, including the hard ones, with training ingredients. Errors of the
panel reader are simulated: some panels have uncertain or wrong readings, some words are unknown.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.reasoner_file import REMEMBERED, SELECTOR_FILE
from cognitivedrone.models.small_reasoner import STAGES, GateSelector, SelectorConfig
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.reasoners.calculator import calculate, evaluate
from cognitivedrone.reasoners.small import value_index
from cognitivedrone.tasks import BASE_FAMILIES, FAMILIES, HARD_FAMILIES
from cognitivedrone.tasks.generate import TRAIN, Draw
from cognitivedrone.tasks.memory import memory_track
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.training.common.phrasing import SPOKEN
from cognitivedrone.training.common.questions import ask
from cognitivedrone.training.common.sampling import Batch, token_noise
from cognitivedrone.training.common.training_task import Batches, Learner, Recipe, Row, to_tensors
from cognitivedrone.training.common.unknown_people import UNKNOWN_PERSON, with_unknown_person
from cognitivedrone.training.reasoner.reading import SEEN, SEEN_GROUPS, seen_attributes
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

_VALIDATION = 10**6
_SENTENCES = 30_000
_DOUBTED = 0.3  # share of a panel's other attributes that are uncertain as well
_GROUPS = tuple(SEEN_GROUPS.values())
_NAMES = (*FAMILIES, "directive")


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectorRecipe(Recipe):
    """Everything that determines a training of the gate selector, except processes and seed."""

    network: SelectorConfig = field(default_factory=SelectorConfig)
    batch: int = 256
    """Tasks; processes share them."""
    validation_tasks: int = 3000
    directives: float = 0.06
    """Share of sentences that are directives already."""
    relabelled: float = 0.3
    """Share of base tasks that ask for any of their gates, in other words."""
    spoken: float = 0.7
    """Share of problems with more wordings than the training tasks."""
    unknown_people: float = 0.4
    """Share of tasks about people that ask for an unknown identity among known ones."""
    earlier: float = 0.3
    """Share of problems on a track, after irrelevant earlier stages."""
    earlier_from: int = 2_500
    """First step with earlier stages: from the start, they would teach to ignore the memory before it is understood."""
    doubt: float = 0.25
    """Share of panels with uncertain readings, of one or several attributes."""
    wrong: float = 0.01
    """Share of panels that are misread as something else of the same kind."""
    lost_words: float = 0.03
    """Share of unknown words."""
    token_noise: float = 0.4
    """Share of sentences with token noise: words lost, left out and added."""

    model_file: ClassVar[str] = SELECTOR_FILE

    def training(self, *, start: Path | None = None, data: Path | None = None) -> SelectorTraining:
        """A new gate selector, with the vocabulary of all families."""
        del start, data
        rng, problems = np.random.default_rng((0, _VALIDATION + 1)), Problems(self)
        sentences = [problem.sentence for _ in range(_SENTENCES) for problem in problems.draw(rng)]
        vocabulary = Vocabulary.of(sentence.replace(UNKNOWN_PERSON, "") for sentence in sentences)
        network = replace(self.network, vocabulary=len(vocabulary.words), attributes=len(SEEN))
        return SelectorTraining(replace(self, network=network), vocabulary)


@dataclass(frozen=True, slots=True)
class Problem:
    """A sentence, a scene and the right gate."""

    sentence: str
    family: str
    labels: tuple[str, ...]
    gates: tuple[Gate, Gate, Gate]
    board: str | None
    target: int
    before: tuple[tuple[tuple[str, ...], int], ...] = ()
    """Earlier stages of the track: labels of their panels, and the gate that was flown through."""


class Problems:
    """Draws problems from the training ingredients."""

    def __init__(self, recipe: SelectorRecipe) -> None:
        self.recipe = recipe
        shares = dict.fromkeys(BASE_FAMILIES, 1.0) | dict.fromkeys(HARD_FAMILIES, 0.7)
        shares |= {"association": 3.0, "people": 1.5, "attributes": 1.5, "comparison": 1.0, "memory": 0.4}
        self._families = tuple(shares)
        self._shares = np.array(list(shares.values())) / sum(shares.values())
        self._past: deque[tuple[tuple[str, ...], int]] = deque(maxlen=STAGES - 1)

    def draw(self, rng: np.random.Generator) -> list[Problem]:
        """One problem, or all problems of a memory track."""
        problems = self._draw(rng)
        if problems[0].family != "memory":
            problem = problems[0]
            if rng.random() < self.recipe.earlier:
                before = list(self._past)[: int(rng.integers(1, STAGES))]
                problems = [replace(problem, before=tuple(before))]
            self._past.append((problem.labels, problem.target))
        return problems

    def _draw(self, rng: np.random.Generator) -> list[Problem]:
        family = self._families[int(rng.choice(len(self._families), p=self._shares))]
        if family == "memory":
            return _track(rng)
        pools = SPOKEN if rng.random() < self.recipe.spoken else TRAIN
        task = drawn_task(family, rng, family, pools)
        if family == "people" and rng.random() < self.recipe.unknown_people:
            task = with_unknown_person(rng, task)
            return [Problem(task.instruction, family, task.labels, task.gates, None, right_gate(task))]
        sentence, target, said = task.instruction, right_gate(task), family
        if rng.random() < self.recipe.directives:
            question = ask(rng, task.labels, task.board, task.gates, target, "directive")
            sentence, said = question.text, "directive"
        elif family in BASE_FAMILIES and rng.random() < self.recipe.relabelled:
            question = ask(rng, task.labels, task.board, task.gates, int(rng.integers(3)), None, pools)
            sentence, target, said = question.text, question.target, question.family
        return [Problem(sentence, said, task.labels, task.gates, task.board, target)]


def _gates(rng: np.random.Generator) -> tuple[Gate, Gate, Gate]:
    sizes, shapes = (rng.integers(len(names), size=3) for names in (SIZES, SHAPES))
    a, b, c = (
        Gate(SIZES[size], SHAPES[shape], COLORS[color])
        for size, shape, color in zip(sizes, shapes, rng.permutation(3), strict=True)
    )
    return a, b, c


def _track(rng: np.random.Generator) -> list[Problem]:
    targets = [int(target) for target in rng.integers(3, size=int(rng.integers(3, 6)))]
    puzzles = memory_track(Draw(rng, TRAIN, targets[0]), targets)
    before: list[tuple[tuple[str, ...], int]] = []
    problems = []
    for puzzle, target in zip(puzzles, targets, strict=True):
        labels = tuple(panel.label for panel in puzzle.panels)
        problems.append(Problem(puzzle.instruction, "memory", labels, _gates(rng), None, target, tuple(before)))
        before.append((labels, target))
    return problems


class Encoder:
    """Encodes problems as inputs of the gate selector."""

    def __init__(self, recipe: SelectorRecipe, vocabulary: Vocabulary) -> None:
        self._recipe, self._vocabulary = recipe, vocabulary

    def encode(self, rng: np.random.Generator, problems: list[Problem], *, doubts: bool) -> Batch:
        """A batch; with `doubts` including simulated reading errors."""
        n, length = len(problems), self._recipe.network.text_length
        batch: Batch = {
            "tokens": np.zeros((n, length), np.int64),
            "panels": np.zeros((n, 3, len(SEEN)), np.float32),
            "looks": np.zeros((n, 3, 8), np.float32),
            "board": np.zeros((n, len(SEEN)), np.float32),
            "values": np.zeros((n, 5), np.int64),
            "remembered": np.zeros((n, REMEMBERED, len(SEEN)), np.float32),
            "stages": np.full((n, REMEMBERED, 3), -1, np.int64),
            "target": np.array([problem.target for problem in problems]),
        }
        for row, problem in enumerate(problems):
            batch["tokens"][row] = self._tokens(rng, problem.sentence, lost=doubts)
            batch["looks"][row] = [look_of(gate) for gate in problem.gates]
            for place, label in enumerate(problem.labels):
                self._see(rng, batch["panels"][row, place], label, doubts=doubts)
            if problem.board is not None:
                self._see(rng, batch["board"][row], problem.board, doubts=doubts)
            batch["values"][row] = values_of(problem.sentence, problem.labels, problem.board)
            self._remember(rng, batch, row, problem, doubts=doubts)
        return batch

    def _tokens(self, rng: np.random.Generator, sentence: str, *, lost: bool) -> NDArray[np.int64]:
        tokens = self._vocabulary.encode(sentence, self._recipe.network.text_length)
        if not lost:
            return tokens
        gone = (rng.random(len(tokens)) < self._recipe.lost_words) & (tokens > 0)
        tokens = np.where(gone, 1, tokens)
        return token_noise(rng, tokens) if rng.random() < self._recipe.token_noise else tokens

    def _see(self, rng: np.random.Generator, row: NDArray[Any], label: str, *, doubts: bool) -> None:
        """Add the probabilities of a label's attribute values."""
        known = seen_attributes(label)
        there = known >= 0
        row[known[there]] = 1.0
        if not doubts:
            return
        kind = rng.random()
        if not there.any() or kind > self._recipe.wrong + self._recipe.doubt:
            return
        groups = rng.permutation(np.flatnonzero(there))
        wrong = kind < self._recipe.wrong
        for group in groups[: 1 if wrong else 1 + rng.binomial(len(groups) - 1, _DOUBTED)].tolist():
            span = _GROUPS[group]
            other = int(rng.integers(span.start, span.stop))
            sure = 0.0 if wrong else float(rng.uniform(0.25, 1.0))
            row[span] = 0.0
            row[known[group]] += sure
            row[other] += 1.0 - sure

    def _remember(self, rng: np.random.Generator, batch: Batch, row: int, problem: Problem, *, doubts: bool) -> None:
        for stage, (labels, flown) in enumerate(problem.before):
            for place, label in enumerate(labels):
                at = 3 * stage + place
                self._see(rng, batch["remembered"][row, at], label, doubts=doubts)
                batch["stages"][row, at] = stage, len(problem.before) - 1 - stage, int(place == flown)


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
        """Logits (B, 3); skips unused words and memories."""
        words = int((batch["tokens"] != 0).sum(1).max())
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


@dataclass(frozen=True)
class SelectorTraining:
    """Training task of the gate selector."""

    recipe: SelectorRecipe
    vocabulary: Vocabulary

    def identity(self) -> dict[str, Any]:
        """Its recipe."""
        return {"recipe": self.recipe.facts()}

    def facts(self) -> dict[str, Any]:
        """Vocabulary and attribute values."""
        return {"vocabulary": list(self.vocabulary.words), "facets": list(SEEN)}

    def network(self) -> GateSelector:
        """A new gate selector."""
        return GateSelector(self.recipe.network)

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

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng = np.random.default_rng(seed)
            early = seed[-1] * self.recipe.round_steps < self.recipe.earlier_from
            problems = Problems(replace(self.recipe, earlier=0.0) if early else self.recipe)
            encoder = Encoder(self.recipe, self.vocabulary)
            waiting: list[Problem] = []
            while True:
                while len(waiting) < self.recipe.batch:
                    waiting += problems.draw(rng)
                now, waiting = waiting[: self.recipe.batch], waiting[self.recipe.batch :]
                yield encoder.encode(rng, now, doubts=True)

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Problems of another seed, with certain readings; with the family of each."""
        rng = np.random.default_rng((seed, _VALIDATION))
        drawn, encoder = Problems(self.recipe), Encoder(self.recipe, self.vocabulary)
        problems: list[Problem] = []
        while len(problems) < self.recipe.validation_tasks:
            problems += drawn.draw(rng)
        parts = [problems[first : first + 250] for first in range(0, len(problems), 250)]
        families = [np.array([_NAMES.index(problem.family) for problem in part]) for part in parts]
        encoded = [encoder.encode(rng, part, doubts=False) for part in parts]
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
            row[f"choice accuracy {_NAMES[index]}"] = float(right[family == index].mean())
        return row

    def trial(self, network: nn.Module) -> Row:
        """Empty: there are no trials beside the curves."""
        del network
        return {}

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The gate selector's file."""
        from cognitivedrone.training.reasoner.export import export_selector

        export_selector(checkpoint, folder)


SELECTOR = SelectorRecipe(name="selector", steps=6_000, learning_rate=1e-3, warmup_steps=300)
