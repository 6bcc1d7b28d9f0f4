"""Language alone as a subject of training: a policy that flies is taught to understand more, without a frame.

In the small VLA vision and language meet late, where what is seen and what is said are compared. So all else can be
held still while its text encoder learns from sentences and scenes that are told: of the families of training, and of
those of the hard ones that ask for a gate by what itself shows, not by what stands beside it or stood there before.
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
from cognitivedrone.training.common.attributes import panel_facets
from cognitivedrone.training.common.checkpoint import origin_of, read_checkpoint
from cognitivedrone.training.common.phrasing import SPOKEN
from cognitivedrone.training.common.sampling import Batch, muddled, told
from cognitivedrone.training.common.training_task import Batches, Learner, Recipe, Row, to_tensors
from cognitivedrone.training.common.unknown_people import STRANGER, with_stranger
from cognitivedrone.training.small_vla.losses import known_mean, text_loss, told_embedding, told_query
from cognitivedrone.training.small_vla.pilot import NetworkPilot
from cognitivedrone.training.small_vla.policy import trial
from cognitivedrone.training.small_vla.trained import load_trained
from cognitivedrone.types import Task

_VALIDATION = 10**6
_SENTENCES = 40_000  # whose words are added to the vocabulary
_NEW_WORD_SPREAD = 0.05  # as of all words at the beginning
_MOST_DOUBT = 0.45  # of a board that is not misread
SHARES = {
    "math": 0.12, "association": 0.14, "math_board": 0.06, "food": 0.05, "attributes": 0.08, "people": 0.08,
    "animals": 0.03, "letters": 0.02, "digits": 0.02, "logos": 0.02,
    "exclusion": 0.1, "comparison": 0.08, "two_step": 0.08, "negation": 0.06, "distraction": 0.03, "conjunction": 0.03,
}  # fmt: skip
"""How often each family is taught. Not among them: places beside something else, earlier stages and numbers of things,
of which a gate by itself, as the network sees it, says nothing."""
_FAMILIES = tuple(SHARES)


@dataclass(frozen=True, slots=True, kw_only=True)
class LanguageRecipe(Recipe):
    """Everything that decides what comes out of teaching a policy language alone, but its start, processes and seed."""

    batch: int = 256
    """Sentences; processes share them."""
    spoken: float = 0.6
    """Share of sentences that are said in more ways than the training tasks."""
    muddled: float = 0.1
    """Share of sentences that are put otherwise: words lost, left out and added, so that the rest must do."""
    directives: float = 0.08
    """Share of sentences that are directives."""
    strangers: float = 0.4
    """Share of sentences about people that ask for somebody unknown among known ones."""
    hidden: float = 0.3
    """Share of sentences about a board where there is none in view, so that nobody can know which gate is meant."""
    doubted: float = 0.4
    """Share of boards that are in doubt: they get a second reading, that of another sentence."""
    kept: float = 1.0
    """How much it counts to say, of the families that the policy knows, what it said before."""
    validation_sentences: int = 3000
    fly_tasks: int = 60
    """Tasks of a trial."""

    needs_start: ClassVar[bool] = True

    def training(self, *, start: Path | None = None, data: Path | None = None) -> LanguageTraining:
        """The policy of a checkpoint; beside the words that it knows, those that are taught."""
        del data
        assert start is not None  # noqa: S101  (tells the type checker)
        facts = read_checkpoint(start)[1]
        known = tuple(facts["vocabulary"])
        rng = np.random.default_rng((0, _VALIDATION + 1))
        sentences = (draw_told(rng, self).instruction.replace(STRANGER, "") for _ in range(_SENTENCES))
        new = {word for sentence in sentences for word in words_of(sentence)} - set(known)
        return LanguageTraining(
            self, start, Vocabulary((*known, *sorted(new))), facts["recipe"]["network"]["text_length"]
        )


LANGUAGE = LanguageRecipe(name="language", steps=3_000, learning_rate=1e-3, decay_share=0.5)


@dataclass(frozen=True)
class LanguageTraining:
    """A small VLA of which all is held still but its text encoder."""

    recipe: LanguageRecipe
    start: Path
    """Checkpoint of the policy."""
    vocabulary: Vocabulary
    """The policy's words, then new ones."""
    text_length: int
    """Words of a sentence that the policy reads."""

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
        """The policy's, with room for new words; nothing but its text encoder can learn."""
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

    def lesson(self, network: nn.Module) -> LanguageLoss:
        """The policy with its language teacher."""
        assert isinstance(network, SmallVLA)  # noqa: S101  (tells the type checker)
        before, known, _ = load_trained(self.start)
        return LanguageLoss(network, before.text, len(known.words), self.recipe.kept)

    def learner(self, network: nn.Module) -> None:
        """Nothing flies along."""
        del network

    def share(self, processes: int) -> LanguageTraining:
        """Sentences are shared."""
        return replace(self, recipe=replace(self.recipe, batch=-(-self.recipe.batch // processes)))

    def batches(self) -> Batches:
        """Sentences without end."""

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng = np.random.default_rng(seed)
            while True:
                yield self.told(rng, [draw_told(rng, self.recipe) for _ in range(self.recipe.batch)])

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Sentences of another seed as they are written, with the family of each."""
        plain = replace(self, recipe=replace(self.recipe, muddled=0.0, directives=0.0, hidden=0.0, doubted=0.0))
        rng = np.random.default_rng((seed, _VALIDATION))
        tasks = [draw_told(rng, self.recipe) for _ in range(self.recipe.validation_sentences)]
        parts = [tasks[first : first + 250] for first in range(0, len(tasks), 250)]
        families = [np.array([_FAMILIES.index(task.family) for task in part]) for part in parts]
        return [plain.told(rng, part) | {"family": own} for part, own in zip(parts, families, strict=True)]

    def validate(self, lesson: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """Loss, and share of sentences that were understood, overall and by family."""
        assert isinstance(lesson, LanguageLoss)  # noqa: S101
        device = next(lesson.parameters()).device
        losses, rights = [], []
        with torch.no_grad(), autocast():
            for batch in batches:
                loss, understood = text_loss(lesson.network, to_tensors(batch, device))
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
        """The `text_` fields of a batch about these tasks, with doubts about boards.

        Beside them `text_open` (T,), see `text_loss`; `other_board` (T, 3), `doubt` (T,): what else the board might
        show, and how likely that is; and `known` (T,): of which it is to say what it said before.
        """
        recipe, count = self.recipe, len(tasks)
        plain = rng.random(count) < recipe.directives
        rows = []
        for task, directive in zip(tasks, plain, strict=True):
            row = self.vocabulary.encode(task.directive if directive else task.instruction, self.text_length)
            rows.append(muddled(rng, row) if rng.random() < recipe.muddled else row)
        batch = told(tasks, np.stack(rows), plain)
        board = np.asarray(batch["text_board"], np.int64)
        hidden = rng.random(count) < recipe.hidden
        unknowable = hidden & (board[:, 0] >= 0) & ~plain
        boards = np.flatnonzero(board[:, 0] >= 0)
        others = board[rng.choice(boards, count)] if len(boards) else board
        same = (others < 0) | (rng.random(board.shape) < 0.5)
        doubted = (board[:, 0] >= 0) & (rng.random(count) < recipe.doubted)
        known = [task.family in BASE_FAMILIES and STRANGER not in task.instruction for task in tasks]
        return batch | {
            "text_board": np.where(hidden[:, None], -1, board),
            "text_named": np.where(unknowable, -1, batch["text_named"]),
            "text_open": unknowable,
            "other_board": np.where(same, board, others),
            "doubt": (rng.uniform(0.0, _MOST_DOUBT, count) * doubted).astype(np.float32),
            "known": np.array(known) & ~unknowable & ~doubted,
        }


class LanguageLoss(nn.Module):
    """The policy and its language teacher, who has it say of what it knew before what it said then.

    What it knew it learned from what it saw; what is told says nothing of how surely a thing is seen.
    """

    def __init__(self, network: SmallVLA, before: nn.Module, known_words: int, kept: float) -> None:
        super().__init__()
        self.network = network
        self.before = before.requires_grad_(requires_grad=False)
        self.known_words = known_words
        self.kept = kept

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, its parts and the share of sentences that were understood."""
        doubt = batch["doubt"][:, None]
        board = told_embedding(self.network, batch["text_board"]) * (1 - doubt)
        board = board + told_embedding(self.network, batch["other_board"]) * doubt
        query = told_query(self.network.text, batch, board)
        loss, right = text_loss(self.network, batch, query)
        # Words that are new were unknown to it: number 1 of every vocabulary.
        heard = torch.where(batch["text_tokens"] < self.known_words, batch["text_tokens"], 1)
        said = told_query(self.before, batch | {"text_tokens": heard}, board)
        moved = known_mean((query - said).square().sum(-1) / said.square().sum(-1), batch["known"])
        return loss + self.kept * moved, {
            "text": loss.detach(),
            "moved": moved.detach(),
            "text accuracy": right.float().mean(),
        }


def draw_told(rng: np.random.Generator, recipe: LanguageRecipe) -> Task:
    """A task of the training ingredients that can be told: every panel shows something of which there is a facet."""
    while True:
        family = _FAMILIES[int(rng.choice(len(SHARES), p=list(SHARES.values())))]
        task = drawn_task(family, rng, family, SPOKEN if rng.random() < recipe.spoken else TRAIN)
        if family == "people" and rng.random() < recipe.strangers:
            return with_stranger(rng, task)
        if all(panel_facets(label)[0] >= 0 for label in task.labels):
            return task
