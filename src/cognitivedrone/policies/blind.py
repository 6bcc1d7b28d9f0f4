"""Policies that look at nothing: the floor of every score."""

from __future__ import annotations

import numpy as np

from cognitivedrone.types import ActionChunk, Observation


class Hover:
    """Stays where it is."""

    def reset(self, instruction: str) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> ActionChunk:
        """Zero velocity."""
        return np.zeros((1, 4), dtype=np.float32)


class Random:
    """Flies forward with smooth random turns: a new wish every second."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self._wish = np.zeros(4)

    def seed(self, seed: int) -> None:
        """Draw from `seed` from now on."""
        self._rng = np.random.default_rng(seed)

    def reset(self, instruction: str) -> None:
        """Start from rest."""
        self._wish = np.zeros(4)

    def act(self, observation: Observation) -> ActionChunk:
        """The same wish for ten steps."""
        self._wish = self._rng.normal([0.8, 0.0, 0.0, 0.0], [0.4, 0.4, 0.15, 0.4])
        return np.repeat(self._wish[None], 10, axis=0).astype(np.float32)
