"""Observation and action spaces of both environments, and validation of actions."""

from __future__ import annotations

import math
import string
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.spaces.utils import flatten, flatten_space, unflatten
from gymnasium.vector.utils import batch_differing_spaces, read_from_shared_memory, write_to_shared_memory
from numpy.typing import NDArray

from cognitivedrone.errors import ActionError
from cognitivedrone.sim.dynamics import MAX_BODY_RATE_RAD_S, MAX_POSITION_M, MAX_VELOCITY_M_S
from cognitivedrone.tasks.validate import MAX_TEXT
from cognitivedrone.types import ACTION_LIMITS, IMAGE_SIZE, FloatArray

Info = dict[str, Any]


_ASCII = string.ascii_letters + string.digits + string.punctuation + " "
_LATIN = "".join(chr(code) for code in range(0xA1, 0x180) if code != 0xAD)  # the soft hyphen cannot be seen
_SIGNS = "\u2013\u2014\u2018\u2019\u201c\u201d\u201e\u2022\u2026\u20ac\u2212"
_LAST = 0x10FFFF
"""The largest code point of Unicode."""


class InstructionSpace(spaces.Text):
    """Sentences of 1 to 1000 characters, in any language; samples are of Latin letters, digits and signs.

    Flattened (`FlattenObservation`), a sentence is its code points, (1000,) int32, followed by zeros: nothing is lost,
    whatever its letters. Gymnasium's own `Text` knows only the letters that it samples.

    Under `AsyncVectorEnv` with shared memory, the instructions arrive as one array (num_envs,) of `str`. Gymnasium's
    own `Text` decodes that memory once, before anything is written to it, so every observation then holds "aaaa...".
    """

    def __init__(self, seed: int | np.random.Generator | None = None) -> None:
        super().__init__(max_length=MAX_TEXT, charset=_ASCII + _LATIN + _SIGNS, seed=seed)

    def contains(self, x: Any) -> bool:
        """Whether this is a sentence of valid length."""
        return isinstance(x, str) and self.min_length <= len(x) <= self.max_length


@read_from_shared_memory.register(InstructionSpace)
def _read_instructions(space: InstructionSpace, shared_memory: Any, n: int = 1) -> NDArray[np.str_]:
    """The instructions (n,), as an array that shows the current content of the memory, as for `Box`."""
    return _strings(space, shared_memory)[:n]


@write_to_shared_memory.register(InstructionSpace)
def _write_instruction(space: InstructionSpace, index: int, value: str, shared_memory: Any) -> None:
    _strings(space, shared_memory)[index] = value


def _strings(space: InstructionSpace, shared_memory: Any) -> NDArray[np.str_]:
    """A view of the memory that Gymnasium allocates for `Text`: 4 bytes per character, as in NumPy."""
    view: NDArray[np.str_] = np.frombuffer(shared_memory.get_obj(), dtype=f"U{space.max_length}")
    return view


@flatten.register(InstructionSpace)
def _flatten_instruction(space: InstructionSpace, x: str) -> NDArray[np.int32]:  # type: ignore[misc]
    codes = np.zeros(space.max_length, np.int32)
    codes[: len(x)] = [ord(character) for character in x]
    return codes


@flatten_space.register(InstructionSpace)
def _flatten_instruction_space(space: InstructionSpace) -> spaces.Box:
    return spaces.Box(0, _LAST, (space.max_length,), np.int32)


@unflatten.register(InstructionSpace)
def _unflatten_instruction(space: InstructionSpace, x: NDArray[Any]) -> str:  # type: ignore[misc]  # noqa: ARG001
    return "".join(chr(code) for code in np.asarray(x).astype(int) if code)


# The only function of Gymnasium that looks up a space's class directly and so misses its base class.
batch_differing_spaces.register(InstructionSpace, batch_differing_spaces.dispatch(spaces.Text))


def action_space() -> spaces.Box:
    """(4,): vx, vy, vz in m/s and yaw rate in rad/s, heading frame."""
    limit = np.array(ACTION_LIMITS, dtype=np.float32)
    return spaces.Box(-limit, limit, dtype=np.float32)


def observation_space(*, down_camera: bool = False) -> spaces.Dict:
    """The space of `Observation`, for one world. Beyond the bounds, a flight counts as diverged."""
    # The heading frame mixes the world's x and y, so one component can be as large as both together.
    fastest = math.sqrt(2) * MAX_VELOCITY_M_S
    picture = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
    return spaces.Dict(
        {
            "image": picture,
            **({"down": picture} if down_camera else {}),
            "instruction": InstructionSpace(),
            "velocity": _within(fastest, 3),
            "height": _within(MAX_POSITION_M, 1),
            "yaw_rate": _within(MAX_BODY_RATE_RAD_S, 1),
        }
    )


def check_actions(actions: FloatArray, shape: tuple[int, ...]) -> None:
    """Raises `ActionError` unless the actions are of this shape, (4,) or (worlds, 4), and finite."""
    given = np.asarray(actions)
    if given.shape != shape:
        raise ActionError(f"the action has shape {given.shape}; the action space has {shape}")
    if not np.isfinite(given).all():
        if len(shape) == 1:
            raise ActionError(f"action {given.tolist()} holds a number that is not finite")
        raise ActionError(f"world {int(np.argmax(~np.isfinite(given).all(axis=1)))}: the action is not finite")


def _within(limit: float, size: int) -> spaces.Box:
    return spaces.Box(-limit, limit, (size,), np.float32)
