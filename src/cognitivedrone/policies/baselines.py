"""Baseline policies that ignore the image: the lower bound of every score."""

from __future__ import annotations

import numpy as np

from cognitivedrone.interfaces import Policy
from cognitivedrone.types import ActionChunk, EpisodeContext, Observation


class Hover(Policy):
    """Stays where it is."""

    reads_english_only = True

    def act(self, observation: Observation) -> ActionChunk:
        """Zero velocity."""
        return np.zeros((1, 4), dtype=np.float32)


class Random(Policy):
    """Flies forward with random turns: a new velocity every second."""

    reads_english_only = True

    needs_seed = True

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self._wish = np.zeros(4)

    def reset(self, context: EpisodeContext) -> None:
        """Start from rest; a new flight reseeds the generator."""
        if context.stage == 0:
            self._rng = np.random.default_rng(context.seed)
        self._wish = np.zeros(4)

    def act(self, observation: Observation) -> ActionChunk:
        """The same velocity for ten steps."""
        self._wish = self._rng.normal([0.8, 0.0, 0.0, 0.0], [0.4, 0.4, 0.15, 0.4])
        return np.repeat(self._wish[None], 10, axis=0).astype(np.float32)
