"""Racing: single gates, one per stage, without a choice. The task of the RaceVLA baseline.

Source: RaceVLA (arXiv 2503.02572), a drone that flies through one gate after another as a sentence instructs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks.families import FAMILIES
from cognitivedrone.tasks.generate import Draw, Panel, Puzzle
from cognitivedrone.tasks.suites import VERSION, drawn_task, train_task
from cognitivedrone.types import Task

STREAM_NAME = f"{VERSION}:race-train"
"""Used in the ids of `race_task`; not a suite that can be loaded."""
INSTRUCTIONS: tuple[str, ...] = (
    "Fly through the gates",
    "Fly through the gate",
    "Race through the gates",
    "Go through all the gates",
)
_NUMBERS = (Panel("1", "number/1@inter"), Panel("2", "number/2@inter"), Panel("3", "number/3@inter"))
"""Every task needs options, even without panels: here, the numbers of the gates."""


def race(draw: Draw) -> Puzzle:
    """The next gate of a race."""
    return single_gate(draw.pick(INSTRUCTIONS))


def single_gate(instruction: str) -> Puzzle:
    """A single gate without a choice."""
    return Puzzle(instruction, _NUMBERS, alone=True)


def race_task(index: int, seed: int = 0) -> Task:
    """Stage `index` of an endless stream for training, a track of one stage; all randomness comes from (seed, index).

    Raises `TaskError` for a negative index or seed.
    """
    if index < 0 or seed < 0:
        raise TaskError(f"{STREAM_NAME}: index {index} and seed {seed} must not be negative")
    return drawn_task("race", np.random.default_rng([3, seed, index]), f"{STREAM_NAME}/{seed}-{index}")


def crowded_task(index: int, seed: int = 0) -> Task:
    """A room of `train_task` with a racing instruction: three gates, and no indication which one is right.

    Raises `TaskError` for a negative index or seed.
    """
    room = train_task(index, seed)
    instruction = INSTRUCTIONS[int(np.random.default_rng([4, seed, index]).integers(len(INSTRUCTIONS)))]
    return replace(room, family="race", category=FAMILIES["race"], instruction=instruction)
