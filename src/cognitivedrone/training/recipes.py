"""Training recipes of the small models, as named frozen dataclasses."""

from __future__ import annotations

from dataclasses import replace

from cognitivedrone.errors import TrainingError, did_you_mean
from cognitivedrone.models.small_vla import SmallVLAConfig
from cognitivedrone.training.obstacles import DEBUG_OBSTACLES, OBSTACLES
from cognitivedrone.training.reasoner.reader import READER
from cognitivedrone.training.reasoner.selector import DEBUG_SELECTOR, SELECTOR
from cognitivedrone.training.small_vla.language import DEBUG_LANGUAGE, LANGUAGE
from cognitivedrone.training.small_vla.policy import FLIGHT, PLACES, TrainRecipe
from cognitivedrone.training.small_vla.sampling import StreamRecipe
from cognitivedrone.training.teach.training import TEACH
from cognitivedrone.training.trainer.training_task import Recipe

SMALL = TrainRecipe(
    name="small", steps=4_000, decay_share=1 / 3, stream=StreamRecipe(typed=0.5, sentences=4, layouts=0.4)
)

RECIPES: dict[str, TrainRecipe] = {
    "small": SMALL,
    "race": replace(
        SMALL,
        name="race",  # with the steps of the policy that it is compared with
        stream=StreamRecipe(suite="race", crowded=0.5, sentences=2),
        network=replace(SMALL.network, reader=None),
    ),
    "debug": replace(
        SMALL,
        name="debug",
        steps=6,
        stream=StreamRecipe(batch=4, sentences=2, worlds=4, sampled=0.5, pool=2, learner=0.5),
        network=SmallVLAConfig(
            # PyTorch 2.13 crashes in the gradient of 1x1 convolutions of fewer than 16 channels (AVX-512, float32).
            backbone=(16, 16, 16),
            blocks=1,
        ),
        warmup_steps=1,
        round_steps=2,
        validate_every=2,
        validation_frames=8,
        fly_every=4,
        fly_tasks=2,
    ),
}
"""`small`: the packaged policy. `race`: the baseline without language. `debug`: the whole training path in seconds, for
tests."""


ALL_RECIPES: dict[str, Recipe] = {
    **RECIPES,
    "language": LANGUAGE,
    "debug-language": DEBUG_LANGUAGE,
    "flight": FLIGHT,
    "places": PLACES,
    "obstacles": OBSTACLES,
    "debug-obstacles": DEBUG_OBSTACLES,
    "selector": SELECTOR,
    "debug-selector": DEBUG_SELECTOR,
    "reader": READER,
    "teach": TEACH,
}
"""`reader`: reads panels, the first part of a pilot. `selector`: the reasoner's choice. `language`: what words mean.
`flight`: more flying; `places`: also in places; `obstacles`: the eye that sees what is in the way. `teach`: teaches a
trained pilot a user's pictures and words."""


def find_recipe(name: str) -> Recipe:
    """The recipe of that name; raises `TrainingError` with similar names."""
    if name not in ALL_RECIPES:
        raise TrainingError(f"unknown recipe {name!r}; {did_you_mean(name, ALL_RECIPES)}")
    return ALL_RECIPES[name]
