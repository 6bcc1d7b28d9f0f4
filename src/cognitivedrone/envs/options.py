"""What the environments take beside actions: the arguments of their constructors, and the options of `reset`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.errors import SimulationError, TaskError, UnknownOption, did_you_mean
from cognitivedrone.plan import Scenario
from cognitivedrone.tasks import Suite

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
