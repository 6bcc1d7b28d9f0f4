"""Training on language alone: teaches a trained policy to understand more, without frames.

The small VLA fuses vision and language late, where it compares images with sentences. So everything but its text
encoder can be frozen, and the text encoder learns from sentences and ground-truth scenes: of the training families, and
of those hard ones that ask for a gate by its own content, not by neighbouring gates or earlier stages.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.text import Vocabulary, words_of
from cognitivedrone.tasks import BASE_FAMILIES
from cognitivedrone.tasks.generate import TRAIN
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.training.common.attributes import panel_attributes
from cognitivedrone.training.common.checkpoint import origin_of, read_checkpoint
from cognitivedrone.training.common.phrasing import SPOKEN
from cognitivedrone.training.common.sampling import Batch, token_noise, told
from cognitivedrone.training.common.training_task import Batches, Learner, Recipe, Row, to_tensors
from cognitivedrone.training.common.unknown_people import UNKNOWN_PERSON, with_unknown_person
from cognitivedrone.training.small_vla.losses import known_mean, text_loss, told_embedding, told_query
from cognitivedrone.training.small_vla.pilot import NetworkPilot
from cognitivedrone.training.small_vla.policy import trial
from cognitivedrone.training.small_vla.trained import load_trained
from cognitivedrone.types import Task

_VALIDATION = 10**6
_SENTENCES = 40_000  # their words are added to the vocabulary
_NEW_WORD_SPREAD = 0.05  # as for all words at initialisation
_MOST_DOUBT = 0.45  # for a board that is not misread
SHARES = {
    "math": 0.12, "association": 0.14, "math_board": 0.06, "food": 0.05, "attributes": 0.08, "people": 0.08,
    "animals": 0.03, "letters": 0.02, "digits": 0.02, "logos": 0.02,
    "exclusion": 0.1, "comparison": 0.08, "two_step": 0.08, "negation": 0.06, "distraction": 0.03, "conjunction": 0.03,
}  # fmt: skip
"""Frequency of each family. Families about positions relative to other things, earlier stages and counts are absent,
because the network sees each gate by itself."""
_FAMILIES = tuple(SHARES)


@dataclass(frozen=True, slots=True, kw_only=True)
class LanguageRecipe(Recipe):
    """Everything that determines a training on language alone, except its start, processes and seed."""

    batch: int = 256
    """Number of sentences; processes share them."""
    spoken: float = 0.6
    """Share of sentences with more wordings than the training tasks."""
    token_noise: float = 0.1
    """Share of sentences with token noise: words lost, left out and added."""
    directives: float = 0.08
    """Share of sentences that are directives."""
    unknown_people: float = 0.4
    """Share of sentences about people that ask for an unknown identity among known ones."""
    hidden: float = 0.3
    """Share of sentences about a board while no board is in view, so that the right gate is unknowable."""
    doubted: float = 0.4
    """Share of boards with uncertain readings: they get a second reading, that of another sentence."""
    distillation_weight: float = 1.0
    """Distillation weight: for families that the policy already knew, how much its old answers count."""
    validation_sentences: int = 3000
    fly_tasks: int = 60
    """Number of tasks in a trial."""

    needs_start: ClassVar[bool] = True

    def training(self, *, start: Path | None = None, data: Path | None = None) -> LanguageTraining:
        """The policy of a checkpoint; beside the words that it knows, those that are taught."""
        del data
        assert start is not None  # noqa: S101  (tells the type checker)
        facts = read_checkpoint(start)[1]
        known = tuple(facts["vocabulary"])
        rng = np.random.default_rng((0, _VALIDATION + 1))
        sentences = (draw_told(rng, self).instruction.replace(UNKNOWN_PERSON, "") for _ in range(_SENTENCES))
        new = {word for sentence in sentences for word in words_of(sentence)} - set(known)
        return LanguageTraining(
            self, start, Vocabulary((*known, *sorted(new))), facts["recipe"]["network"]["text_length"]
        )


LANGUAGE = LanguageRecipe(name="language", steps=3_000, learning_rate=1e-3, decay_share=0.5)


@dataclass(frozen=True)
class LanguageTraining:
    """A small VLA that is frozen except for its text encoder."""

    recipe: LanguageRecipe
    start: Path
    """Checkpoint of the policy."""
    vocabulary: Vocabulary
    """The policy's words, then new ones."""
    text_length: int
    """Number of words of a sentence that the policy reads."""

    def identity(self) -> dict[str, Any]:
        """Recipe, with the policy's network and stream, and the start."""
        facts = read_checkpoint(self.start)[1]
        network = facts["recipe"]["network"] | {"vocabulary": len(self.vocabulary.words)}
        return {
            "recipe": self.recipe.facts() | {"network": network, "stream": facts["recipe"]["stream"]},
            "data": origin_of(facts),
        }

    def facts(self) -> dict[str, Any]:
        """The vocabulary."""
        return {"vocabulary": list(self.vocabulary.words)}

    def network(self) -> SmallVLA:
        """The policy's network, extended for new words; only its text encoder can learn."""
        network, known, _ = load_trained(self.start)
        words = nn.Embedding(len(self.vocabulary.words), network.config.text_width)
        nn.init.normal_(words.weight, std=_NEW_WORD_SPREAD)
        with torch.no_grad():
            words.weight[: len(known.words)] = network.text.words.weight
        network.text.words = words
        network.config = replace(network.config, vocabulary=len(self.vocabulary.words))
        network.requires_grad_(requires_grad=False)
        network.text.requires_grad_()
        return network

    def loss_module(self, network: nn.Module) -> LanguageLoss:
        """The policy with its language losses."""
        assert isinstance(network, SmallVLA)  # noqa: S101  (tells the type checker)
        before, known, _ = load_trained(self.start)
        return LanguageLoss(network, before.text, len(known.words), self.recipe.distillation_weight)

    def learner(self, network: nn.Module) -> None:
        """None: nothing flies."""
        del network

    def share(self, processes: int) -> LanguageTraining:
        """Processes share the sentences."""
        return replace(self, recipe=replace(self.recipe, batch=-(-self.recipe.batch // processes)))

    def batches(self) -> Batches:
        """Endless sentences."""

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng = np.random.default_rng(seed)
            while True:
                yield self.told(rng, [draw_told(rng, self.recipe) for _ in range(self.recipe.batch)])

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Unaltered sentences of another seed, with the family of each."""
        plain = replace(self, recipe=replace(self.recipe, token_noise=0.0, directives=0.0, hidden=0.0, doubted=0.0))
        rng = np.random.default_rng((seed, _VALIDATION))
        tasks = [draw_told(rng, self.recipe) for _ in range(self.recipe.validation_sentences)]
        parts = [tasks[first : first + 250] for first in range(0, len(tasks), 250)]
        families = [np.array([_FAMILIES.index(task.family) for task in part]) for part in parts]
        return [plain.told(rng, part) | {"family": own} for part, own in zip(parts, families, strict=True)]

    def validate(self, loss_module: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """Loss, and share of sentences that were understood, overall and by family."""
        assert isinstance(loss_module, LanguageLoss)  # noqa: S101
        device = next(loss_module.parameters()).device
        losses, rights = [], []
        with torch.no_grad(), autocast():
            for batch in batches:
                loss, understood = text_loss(loss_module.network, to_tensors(batch, device))
                losses.append(float(loss))
                rights.append(understood.cpu().numpy())
        right, family = np.concatenate(rights), np.concatenate([batch["family"] for batch in batches])
        row: Row = {"text": float(np.mean(losses)), "text accuracy": float(right.mean())}
        return row | {f"text accuracy {_FAMILIES[i]}": float(right[family == i].mean()) for i in np.unique(family)}

    def trial(self, network: nn.Module) -> Row:
        """Success in closed loop on training tasks under another seed, by family."""
        assert isinstance(network, SmallVLA)  # noqa: S101
        return trial(NetworkPilot(network, self.vocabulary), "open-v1:train", self.recipe.fly_tasks)

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The ONNX file that flies."""
        from cognitivedrone.training.small_vla.export import export

        export(checkpoint, folder / self.recipe.model_file)

    def told(self, rng: np.random.Generator, tasks: list[Task]) -> Batch:
        """The `text_` fields of a batch about these tasks, with uncertain boards.

        In addition `text_open` (T,), see `text_loss`; `other_board` (T, 3), `doubt` (T,): an alternative content of the
        board and its probability; and `known` (T,): whether distillation applies.
        """
        recipe, count = self.recipe, len(tasks)
        plain = rng.random(count) < recipe.directives
        rows = []
        for task, directive in zip(tasks, plain, strict=True):
            row = self.vocabulary.encode(task.directive if directive else task.instruction, self.text_length)
            rows.append(token_noise(rng, row) if rng.random() < recipe.token_noise else row)
        batch = told(tasks, np.stack(rows), plain)
        board = np.asarray(batch["text_board"], np.int64)
        hidden = rng.random(count) < recipe.hidden
        unknowable = hidden & (board[:, 0] >= 0) & ~plain
        boards = np.flatnonzero(board[:, 0] >= 0)
        others = board[rng.choice(boards, count)] if len(boards) else board
        same = (others < 0) | (rng.random(board.shape) < 0.5)
        doubted = (board[:, 0] >= 0) & (rng.random(count) < recipe.doubted)
        known = [task.family in BASE_FAMILIES and UNKNOWN_PERSON not in task.instruction for task in tasks]
        return batch | {
            "text_board": np.where(hidden[:, None], -1, board),
            "text_named": np.where(unknowable, -1, batch["text_named"]),
            "text_open": unknowable,
            "other_board": np.where(same, board, others),
            "doubt": (rng.uniform(0.0, _MOST_DOUBT, count) * doubted).astype(np.float32),
            "known": np.array(known) & ~unknowable & ~doubted,
        }


class LanguageLoss(nn.Module):
    """The policy and its language losses, with distillation on what it already knew.

    It learned that from images; ground-truth scenes contain no information about how certain a perception is.
    """

    def __init__(self, network: SmallVLA, before: nn.Module, known_words: int, distillation_weight: float) -> None:
        super().__init__()
        self.network = network
        self.before = before.requires_grad_(requires_grad=False)
        self.known_words = known_words
        self.distillation_weight = distillation_weight

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, its parts and the share of sentences that were understood."""
        doubt = batch["doubt"][:, None]
        board = told_embedding(self.network, batch["text_board"]) * (1 - doubt)
        board = board + told_embedding(self.network, batch["other_board"]) * doubt
        query = told_query(self.network.text, batch, board)
        loss, right = text_loss(self.network, batch, query)
        # The old policy did not know new words: number 1 of every vocabulary.
        heard = torch.where(batch["text_tokens"] < self.known_words, batch["text_tokens"], 1)
        said = told_query(self.before, batch | {"text_tokens": heard}, board)
        moved = known_mean((query - said).square().sum(-1) / said.square().sum(-1), batch["known"])
        return loss + self.distillation_weight * moved, {
            "text": loss.detach(),
            "moved": moved.detach(),
            "text accuracy": right.float().mean(),
        }


def draw_told(rng: np.random.Generator, recipe: LanguageRecipe) -> Task:
    """A task of training ingredients in which every panel shows a known attribute value."""
    while True:
        family = _FAMILIES[int(rng.choice(len(SHARES), p=list(SHARES.values())))]
        task = drawn_task(family, rng, family, SPOKEN if rng.random() < recipe.spoken else TRAIN)
        if family == "people" and rng.random() < recipe.unknown_people:
            return with_unknown_person(rng, task)
        if all(panel_attributes(label)[0] >= 0 for label in task.labels):
            return task
