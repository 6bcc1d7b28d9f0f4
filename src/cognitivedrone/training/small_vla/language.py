"""Training on language alone: teaches a trained policy to understand more, without frames.

The small VLA fuses vision and language late, where it compares what panels show with sentences. So everything but its
language can be frozen, and that learns from sentences and described scenes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from cognitivedrone.models.sentence import WordConfig
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.text import Lexicon
from cognitivedrone.training.common.attributes import AttributeIndex
from cognitivedrone.training.common.lexicon import training_lexicon, with_vectors
from cognitivedrone.training.common.problems import ALONE, NAMES, Mix, Problem, Problems
from cognitivedrone.training.common.readings import readings_of
from cognitivedrone.training.common.sampling import Batch, TextMix, described
from cognitivedrone.training.common.start import Start, read_start
from cognitivedrone.training.common.training_task import Batches, Given, Learner, Recipe, Row, to_tensors
from cognitivedrone.training.small_vla.losses import text_loss
from cognitivedrone.training.small_vla.pilot import NetworkPilot
from cognitivedrone.training.small_vla.policy import trial
from cognitivedrone.training.small_vla.trained import trained

_VALIDATION = 10**6


@dataclass(frozen=True, slots=True, kw_only=True)
class LanguageRecipe(Recipe):
    """Everything that determines a training run on language alone, except its start, processes and seed."""

    batch: int = 256
    """Number of sentences; processes share them."""
    mix: TextMix = field(default_factory=TextMix)
    validation_sentences: int = 3000
    fly_tasks: int = 60
    """Number of tasks in a trial."""

    needs_start: ClassVar[bool] = True

    def training(self, given: Given) -> LanguageTraining:
        """The policy of a checkpoint or model file; beside the words that it knows, those that are taught."""
        origin = read_start(given.start, "policy")
        known = Lexicon(tuple(origin.facts["vocabulary"]), origin.facts["trained_words"])
        new = training_lexicon(self.mix.problems)
        return LanguageTraining(self, origin, known.taught(new.words[2 : new.trained]))


_FAMILIES = ALONE | {"exclusion": 0.2, "attributes": 0.16, "letters": 0.04, "digits": 0.04, "logos": 0.05}
_MIX = TextMix(problems=Mix(families=_FAMILIES, lacking=0.4))
LANGUAGE = LanguageRecipe(name="language", steps=8_000, learning_rate=1e-3, decay_share=0.5, mix=_MIX)
"""More of what is learnt late: two features, of which one must be absent, and what has many names."""


@dataclass(frozen=True)
class LanguageTraining:
    """A small VLA that is frozen except for its language."""

    recipe: LanguageRecipe
    start: Start
    """The policy."""
    lexicon: Lexicon
    """The policy's words, and new ones."""

    def identity(self) -> dict[str, Any]:
        """Recipe, with the policy's network and stream, and the start."""
        told = self.start.facts["recipe"]
        network = told["network"] | {"words": {"words": len(self.lexicon.words), "trained": self.lexicon.trained}}
        return {
            "recipe": self.recipe.facts() | {"network": network, "stream": told.get("stream")},
            "data": self.start.origin,
        }

    def facts(self) -> dict[str, Any]:
        """Words and attribute values."""
        return {
            "vocabulary": list(self.lexicon.words),
            "trained_words": self.lexicon.trained,
            "attributes": self.start.facts["attributes"],
        }

    def network(self) -> SmallVLA:
        """The policy's network, extended for new words; only its language can learn."""
        return extended(self.start, self.lexicon)

    def loss_module(self, network: nn.Module) -> LanguageLoss:
        """The policy with its language loss."""
        assert isinstance(network, SmallVLA)  # noqa: S101  (tells the type checker)
        return LanguageLoss(network)

    def learner(self, network: nn.Module) -> None:
        """None: nothing flies."""
        del network

    def share(self, processes: int) -> LanguageTraining:
        """Processes share the sentences."""
        return replace(self, recipe=replace(self.recipe, batch=-(-self.recipe.batch // processes)))

    def batches(self) -> Batches:
        """Endless sentences."""
        readings = readings_of(self.start, AttributeIndex(self.start.facts["attributes"]))
        length = self.start.facts["recipe"]["network"]["text_length"]
        recipe = self.recipe

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng, problems = np.random.default_rng(seed), Problems(recipe.mix.problems)
            waiting: list[Problem] = []
            while True:
                while len(waiting) < recipe.batch:
                    waiting += problems.draw(rng)
                now, waiting = waiting[: recipe.batch], waiting[recipe.batch :]
                yield described(rng, now, self.lexicon, length, readings, recipe.mix)

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Unaltered sentences of another seed, with the family of each."""
        readings = readings_of(self.start, AttributeIndex(self.start.facts["attributes"]))
        plain = replace(self.recipe.mix, token_noise=0.0, hidden=0.0)
        rng, drawn = np.random.default_rng((seed, _VALIDATION)), Problems(plain.problems)
        problems: list[Problem] = []
        while len(problems) < self.recipe.validation_sentences:
            problems += drawn.draw(rng)
        length = self.start.facts["recipe"]["network"]["text_length"]
        parts = [problems[first : first + 250] for first in range(0, len(problems), 250)]
        return [
            described(rng, part, self.lexicon, length, readings, plain)
            | {"family": np.array([NAMES.index(problem.family) for problem in part])}
            for part in parts
        ]

    def validate(self, loss_module: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """Loss, and share of sentences that were understood, overall and by family."""
        assert isinstance(loss_module, LanguageLoss)  # noqa: S101
        device = next(loss_module.parameters()).device
        loss_module.eval()
        losses, rights = [], []
        with torch.no_grad(), autocast():
            for batch in batches:
                loss, understood = text_loss(loss_module.network, to_tensors(batch, device))
                losses.append(float(loss))
                rights.append(understood.cpu().numpy())
        loss_module.train()
        right, family = np.concatenate(rights), np.concatenate([batch["family"] for batch in batches])
        row: Row = {"text": float(np.mean(losses)), "text accuracy": float(right.mean())}
        return row | {f"text accuracy {NAMES[i]}": float(right[family == i].mean()) for i in np.unique(family)}

    def trial(self, network: nn.Module) -> Row:
        """Success in closed loop on training tasks under another seed, by family."""
        assert isinstance(network, SmallVLA)  # noqa: S101
        return trial(NetworkPilot(network, self.lexicon), "open-v1:train", self.recipe.fly_tasks)

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The ONNX file that flies."""
        from cognitivedrone.training.small_vla.export import export

        export(checkpoint, folder / self.recipe.model_file)


def extended(start: Start, lexicon: Lexicon) -> SmallVLA:
    """The policy of a start with the words of a larger lexicon; only its language can learn."""
    before, known = trained(start)
    config: SmallVLAConfig = replace(before.config, words=WordConfig(len(lexicon.words), lexicon.trained))
    network = SmallVLA(config, before.schema)
    tensors = before.state_dict()
    own = network.language.words.own.weight.detach().clone()
    rows = {word: row for row, word in enumerate(known.words[: known.trained])}
    for row, word in enumerate(lexicon.words[: lexicon.trained]):
        if word in rows:
            own[row] = tensors["language.words.own.weight"][rows[word]]
    tensors["language.words.own.weight"] = own
    tensors["language.words.vectors"] = network.language.words.vectors
    network.load_state_dict(tensors)
    with_vectors(network.language.words, lexicon)
    network.requires_grad_(requires_grad=False)
    network.language.requires_grad_()
    return network


class LanguageLoss(nn.Module):
    """The policy and its language loss; all else stays in evaluation mode."""

    def __init__(self, network: SmallVLA) -> None:
        super().__init__()
        self.network = network

    def train(self, mode: bool = True) -> LanguageLoss:
        """As for every module, but frozen parts keep their statistics."""
        super().train(mode)
        self.network.finder.eval()
        self.network.flight.eval()
        return self

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, the same and the share of sentences that were understood."""
        loss, right = text_loss(self.network, batch)
        return loss, {"text": loss.detach(), "text accuracy": right.float().mean()}
