"""What the environments take: their spaces, the arguments of their constructors, and the options of `reset`."""

from __future__ import annotations

import math
import string
from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.spaces.utils import flatten, flatten_space, unflatten
from gymnasium.vector.utils import batch_differing_spaces, read_from_shared_memory, write_to_shared_memory
from numpy.typing import NDArray

from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.errors import ActionError, SimulationError, TaskError, UnknownOption, did_you_mean
from cognitivedrone.plan import Scenario
from cognitivedrone.sim.drawing.camera import FAR_M
from cognitivedrone.sim.dynamics import MAX_BODY_RATE_RAD_S, MAX_POSITION_M, MAX_VELOCITY_M_S
from cognitivedrone.tasks import Suite
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


def observation_space(*, down_camera: bool = False, depth: bool = False) -> spaces.Dict:
    """The space of `Observation`, for one world. Beyond the bounds, a flight counts as diverged."""
    # The heading frame mixes the world's x and y, so one component can be as large as both together.
    fastest = math.sqrt(2) * MAX_VELOCITY_M_S
    picture = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
    return spaces.Dict(
        {
            "image": picture,
            **({"depth": spaces.Box(0, FAR_M, (IMAGE_SIZE, IMAGE_SIZE), np.float32)} if depth else {}),
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


RESET_OPTIONS = ("episode", "seed")
"""Of `reset`; a vector environment also takes `RESET_MASK`."""
RESET_MASK = "reset_mask"


class NotReset(SimulationError, ResetNeeded):
    """An environment was used before its first `reset`; also one of Gymnasium's `ResetNeeded`."""


class Episode(NamedTuple):
    """A track of a suite, and the seed of its start, appearance and wind. None: draw it."""

    number: int | None
    seed: int | None


ANY_EPISODE = Episode(None, None)


def scenario_of(constructor: Callable[..., Any], suite: str | Suite, options: Mapping[str, Any]) -> Scenario:
    """The scenario of an environment's options.

    Raises `UnknownOption` for one that neither a scenario nor the constructor has, and what `Scenario` raises.
    """
    known = {*Scenario().values(), *signature(constructor).parameters} - {"self", "options"}
    for name in options:
        if name not in known:
            # These words are Python's own; TorchRL's GymEnv looks for them when it tries `frameskip`.
            raise UnknownOption(
                f"got an unexpected keyword argument {name!r}; {did_you_mean(name, known | {'max_episode_steps'})}"
            )
    return Scenario.of(suite=suite if isinstance(suite, str) else suite.name, **options)


def read_options(suite: Suite, options: Mapping[str, Any] | None, more: Sequence[str] = ()) -> Episode:
    """What the options of `reset` ask for. Raises `TaskError`, before anything is changed, for a wrong one."""
    options, count = options or {}, len(suite.tracks)
    known = (*RESET_OPTIONS, *more)
    for name in options:
        if name not in known:
            raise TaskError(f"unknown reset option {name!r}; {did_you_mean(str(name), known)}")
    episode, seed = options.get("episode"), options.get("seed")
    if episode is None and "episode" not in options:
        index = None
    elif _is_whole(episode) and 0 <= episode < count:
        index = int(episode)
    else:
        raise TaskError(f"suite {suite.name!r} has episodes 0 to {count - 1}, not {episode!r}")
    if "seed" in options and not (_is_whole(seed) and seed >= 0):
        raise TaskError(f"the seed of an episode is {seed!r}; it is a whole number, 0 or more")
    return Episode(index, None if seed is None else int(seed))


def drawn(suite: Suite, rng: np.random.Generator, wanted: Episode) -> tuple[int, int]:
    """The index of an episode, and its seed: those that are wanted, or random ones."""
    index = int(rng.integers(len(suite.tracks))) if wanted.number is None else wanted.number
    return index, int(rng.integers(2**31)) if wanted.seed is None else wanted.seed


def worlds_to_reset(options: Mapping[str, Any] | None, begun: NDArray[np.bool_]) -> list[int]:
    """The worlds that `reset` shall begin: those of `options["reset_mask"]`, (worlds,) bool, or all.

    `begun` (worlds,): which have an episode. Raises `TaskError` for another kind of mask, one that resets nothing, and
    one that leaves out a world without an episode. The options are not changed: wrappers read the mask after us.
    """
    if options is None or RESET_MASK not in options:
        return list(range(len(begun)))
    mask = options[RESET_MASK]
    if not isinstance(mask, np.ndarray) or mask.shape != begun.shape or mask.dtype != np.bool_:
        what = f"shape {mask.shape} and type {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TaskError(f"{RESET_MASK} is an array of {len(begun)} bool, one for each world; {what} was given")
    if not mask.any():
        raise TaskError(f"{RESET_MASK} resets no world; set at least one of its values to True")
    if not (begun | mask).all():
        world = int(np.argmin(begun | mask))
        raise NotReset(f"world {world} has no episode that {RESET_MASK} could keep; reset all worlds first")
    return [int(world) for world in np.flatnonzero(mask)]


def seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """The seed of each world: `seed + i`, or item i of a list; None keeps its random numbers. Raises `TaskError`."""
    if seed is None:
        return [None] * count
    seeds = [int(seed) + world for world in range(count)] if _is_whole(seed) else _listed(seed)
    if len(seeds) != count:
        raise TaskError(f"{len(seeds)} seeds were given for {count} worlds; give one for each, or a single number")
    for each in seeds:
        if each is not None and not (_is_whole(each) and each >= 0):
            raise TaskError(f"the seed of a world is {each!r}; it is a whole number, 0 or more, or None")
    return [None if each is None else int(each) for each in seeds]


def check_begun(runner: TrackRunner, action: str, world: int | None = None) -> None:
    """Raise `NotReset` if no episode was begun, before `action`, the name of a method."""
    if not runner.track:
        where = "the environment" if world is None else f"world {world}"
        raise NotReset(f"{action}() was called before {where} was reset; call reset() first")


def _listed(seed: Any) -> list[int | None]:
    if not isinstance(seed, list | tuple | np.ndarray):
        raise TaskError(f"seed is {seed!r}; it is a whole number, or a list of one for each world")
    return list(seed)


def _is_whole(value: object) -> TypeGuard[int]:
    return isinstance(value, int | np.integer)
