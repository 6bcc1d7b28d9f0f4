"""Training recipes of the small models, as named frozen dataclasses."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeAlias

from cognitivedrone.errors import TrainingError, did_you_mean
from cognitivedrone.models.small_vla import SmallVLAConfig
from cognitivedrone.training.common.sampling import StreamRecipe
from cognitivedrone.training.common.training_task import Schedule
from cognitivedrone.training.reasoner.reader import READER, ReaderRecipe
from cognitivedrone.training.reasoner.selector import MIND, SelectorRecipe
from cognitivedrone.training.small_vla.losses import LossWeights


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainRecipe(Schedule):
    """Everything that determines a training of the small VLA, except processes and seed."""

    network: SmallVLAConfig = field(default_factory=SmallVLAConfig)
    stream: StreamRecipe = field(default_factory=StreamRecipe)
    """Its batch is that of the whole training; processes share it."""
    losses: LossWeights = field(default_factory=LossWeights)
    validation_frames: int = 512
    fly_tasks: int = 60
    """Number of tasks in a trial."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LanguageRecipe(Schedule):
    """Everything that determines a training on language alone, except its start, processes and seed."""

    batch: int = 256
    """Number of sentences; processes share them."""
    spoken: float = 0.6
    """Share of sentences with more wordings than the training tasks."""
    muddled: float = 0.1
    """Share of sentences with token noise: words lost, left out and added."""
    directives: float = 0.08
    """Share of sentences that are directives."""
    strangers: float = 0.4
    """Share of sentences about people that ask for an unknown identity among known ones."""
    hidden: float = 0.3
    """Share of sentences about a board while no board is in view, so that the right gate is unknowable."""
    doubted: float = 0.4
    """Share of boards with uncertain readings: they get a second reading, that of another sentence."""
    kept: float = 1.0
    """Distillation weight: for families that the policy already knew, how much its old answers count."""
    validation_sentences: int = 3000
    fly_tasks: int = 60
    """Number of tasks in a trial."""


SMALL = TrainRecipe(name="small", steps=9_000, decay_share=1 / 3, stream=StreamRecipe(spoken=0.5, muddled=0.1))

_SHORT = replace(SMALL, name="ablation-tokens", steps=1_000)
_ABLATION = (
    _SHORT,
    replace(_SHORT, name="ablation-regression", network=replace(_SHORT.network, head="regression")),
    replace(_SHORT, name="ablation-chunk2", stream=replace(_SHORT.stream, chunk=2)),
    replace(_SHORT, name="ablation-chunk4", stream=replace(_SHORT.stream, chunk=4)),
    replace(_SHORT, name="ablation-128px", network=replace(_SHORT.network, image_size=128)),
    replace(_SHORT, name="ablation-instructions", stream=replace(_SHORT.stream, directives=False)),
)

RECIPES: dict[str, TrainRecipe] = {
    "small": SMALL,
    "race": replace(
        SMALL,
        name="race",
        steps=3_000,
        stream=StreamRecipe(suite="race", crowded=0.5, muddled=0.7, sentences=2, texts=1, cards=0),
        losses=replace(SMALL.losses, text=0.0),
    ),
    "base": replace(
        SMALL,
        name="base",
        steps=30_000,
        stream=replace(SMALL.stream, batch=128, worlds=32, cards=512),
        network=replace(SMALL.network, backbone=(48, 96, 160), sight=(48, 96, 160, 256), text_layers=4),
    ),
    "debug": replace(
        SMALL,
        name="debug",
        steps=6,
        stream=StreamRecipe(batch=4, sentences=2, texts=4, cards=4, worlds=4, sampled=0.5, pool=2, learner=0.5),
        network=SmallVLAConfig(
            backbone=(8, 8, 16), blocks=1, sight=(8, 8, 8, 8), embedding=16, text_width=16, text_layers=1, glimpse=32
        ),
        warmup_steps=1,
        round_steps=2,
        validate_every=2,
        validation_frames=8,
        fly_every=4,
        fly_tasks=2,
    ),
} | {recipe.name: recipe for recipe in _ABLATION}
"""`small`: the shipped policy. `race`: the baseline without language. `base`: larger, for a GPU. `debug`: the whole
training path in seconds, for tests. `ablation-*`: a ninth of `small`, all but the first with one change."""


LANGUAGE = LanguageRecipe(name="language", steps=3_000, learning_rate=1e-3, decay_share=0.5)

Recipe: TypeAlias = TrainRecipe | LanguageRecipe | SelectorRecipe | ReaderRecipe

ALL_RECIPES: dict[str, Recipe] = {**RECIPES, "language": LANGUAGE, "mind": MIND, "reader": READER}
"""`language`: teaches a trained policy more language. `mind`: the small reasoner's gate selector. `reader`: its network
for reading panels, which starts from a policy's panel encoder."""


def find_recipe(name: str) -> Recipe:
    """The recipe of that name; raises `TrainingError` with similar names."""
    if name not in ALL_RECIPES:
        raise TrainingError(f"unknown recipe {name!r}; {did_you_mean(name, ALL_RECIPES)}")
    return ALL_RECIPES[name]
