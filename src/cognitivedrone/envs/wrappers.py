"""Observation wrappers for learners: instructions as vectors, for libraries without `Text`, and smaller images."""

from __future__ import annotations

import itertools
import zlib
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from PIL import Image as PillowImage

from cognitivedrone.errors import SimulationError
from cognitivedrone.models.words.text import words_of
from cognitivedrone.types import IMAGE_SIZE, Action, FloatArray

SIZE = 256
"""Default length of an instruction's vector."""


Seen = dict[str, Any]
"""An observation."""


class HashInstruction(gymnasium.ObservationWrapper[Seen, Action, Seen], RecordConstructorArgs):
    """Replaces the instruction of the observation by a vector: a `Box` (size,) float32 instead of the `Text`.

    See `hash_instruction`. Raises `SimulationError` for a size below 1.
    """

    def __init__(self, env: gymnasium.Env[Seen, Action], size: int = SIZE) -> None:
        RecordConstructorArgs.__init__(self, size=size)
        super().__init__(env)
        if size < 1:
            raise SimulationError(f"size is {size}; an instruction's vector has at least 1 number")
        self.size = size
        self.observation_space = _replaced(env, "instruction", spaces.Box(-1, 1, (size,), np.float32))

    def observation(self, observation: Seen) -> Seen:
        """The observation with the vector of its instruction."""
        return {**observation, "instruction": hash_instruction(observation["instruction"], self.size)}


class ShrinkImage(gymnasium.ObservationWrapper[Seen, Action, Seen], RecordConstructorArgs):
    """Shrinks the image by `factor` on each side, averaging over squares: 128 x 128 for 2.

    Raises `SimulationError` unless 256 is a multiple of the factor.
    """

    def __init__(self, env: gymnasium.Env[Seen, Action], factor: int = 2) -> None:
        RecordConstructorArgs.__init__(self, factor=factor)
        super().__init__(env)
        if factor < 1 or IMAGE_SIZE % factor:
            raise SimulationError(f"factor is {factor}; the image's {IMAGE_SIZE} pixels must be a multiple of it")
        self.factor = factor
        side = IMAGE_SIZE // factor
        self.observation_space = _replaced(env, "image", spaces.Box(0, 255, (side, side, 3), np.uint8))

    def observation(self, observation: Seen) -> Seen:
        """The observation with a smaller image."""
        image = PillowImage.fromarray(observation["image"]).reduce(self.factor)
        return {**observation, "image": np.array(image)}


def hash_instruction(text: str, size: int = SIZE) -> FloatArray:
    """A sentence as (size,) float32 of length 1: signed feature hashing of its words and pairs of neighbouring words.

    The hashing trick of Weinberger et al. (arXiv 0902.2206): every word and pair adds 1 or -1 at one position; its
    CRC-32 determines position and sign. No vocabulary is needed, and the result is the same on every machine. Words are
    those of `models.words.text.words_of`, with markers for the beginning and the end of the sentence.
    """
    words = ["<", *words_of(text), ">"]
    vector = np.zeros(size, dtype=np.float32)
    for feature in (*words[1:-1], *map(" ".join, itertools.pairwise(words))):
        code = zlib.crc32(feature.encode("utf-8", "surrogatepass"))
        vector[(code >> 1) % size] += 1 - 2 * (code & 1)
    length = float(np.linalg.norm(vector))
    return vector / np.float32(length) if length else vector


def _replaced(env: gymnasium.Env[Seen, Action], key: str, space: spaces.Box) -> spaces.Dict:
    """The environment's observation space with another space under `key`."""
    if not isinstance(env.observation_space, spaces.Dict) or key not in env.observation_space.spaces:
        raise SimulationError(f"the observation space is {env.observation_space}; expected a Dict with {key!r}")
    return spaces.Dict({**env.observation_space.spaces, key: space})
