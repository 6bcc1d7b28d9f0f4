"""Action tokens: velocities to the 256 bins on the last tokens of the vocabulary, and back; scaling statistics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, did_you_mean
from cognitivedrone.files.schema import check_form
from cognitivedrone.models.openvla.config import ACTION_SIZE, WORDS
from cognitivedrone.types import Commands, FloatArray

BINS = 256
EDGES: FloatArray = np.linspace(-1.0, 1.0, BINS)
"""Edges between the bins; values below the first edge are in the first bin."""
CENTRES: FloatArray = (EDGES[:-1] + EDGES[1:]) / 2
"""(255,): the last edge closes the last bin, so that ids `WORDS - 256` and `WORDS - 255` have the same centre."""
STILL = 1e-6
"""A dimension whose quantiles differ by no more than this, m/s or rad/s, counts as never moving."""

Tokens: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ActionStatistics:
    """Quantiles of the actions that a network was trained on: q01 is flown for -1, q99 for 1.

    Raises `ModelError` for what is not as many finite numbers each, in order.
    """

    q01: tuple[float, ...]
    """Of a drone: vx, vy, vz in m/s, yaw rate in rad/s; of other robots, more."""
    q99: tuple[float, ...]
    mask: tuple[bool, ...] = (True,) * ACTION_SIZE
    """Whether the network's output in a dimension is scaled."""

    def __post_init__(self) -> None:
        sizes = {len(self.q01), len(self.q99), len(self.mask)}
        if len(sizes) > 1 or min(sizes) < ACTION_SIZE:
            raise ModelError(
                f"q01, q99 and mask have {len(self.q01)}, {len(self.q99)} and {len(self.mask)} numbers; they need"
                f" equally many, and a drone's action has {ACTION_SIZE}: vx, vy, vz, yaw rate"
            )
        low, high = np.asarray(self.q01), np.asarray(self.q99)
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
            raise ModelError(f"q01 is {list(self.q01)} and q99 {list(self.q99)}; they must be finite, q01 <= q99")

    def to_json(self) -> dict[str, Any]:
        """The form under `norm_stats.KEY.action` of a published `config.json`."""
        return {"q01": list(self.q01), "q99": list(self.q99), "mask": list(self.mask)}

    def normalise(self, actions: FloatArray) -> FloatArray:
        """Actions (..., width) normalised for training, in [-1, 1]; 0 in a dimension that never moves."""
        low, high, mask = self._arrays()
        width = high - low
        moving = width > STILL
        scaled = np.clip(2.0 * (actions - low) / np.where(moving, width, 1.0) - 1.0, -1.0, 1.0)
        scaled = np.where(moving, scaled, 0.0)
        return np.asarray(np.where(mask, scaled, actions))

    def flown(self, normalised: FloatArray) -> FloatArray:
        """The network's outputs (..., width) in [-1, 1] as velocities; a dimension that never moves keeps its value."""
        low, high, mask = self._arrays()
        return np.asarray(np.where(mask, 0.5 * (normalised + 1.0) * (high - low) + low, normalised))

    def _arrays(self) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        return np.asarray(self.q01, np.float64), np.asarray(self.q99, np.float64), np.asarray(self.mask, np.bool_)


@dataclass(frozen=True, slots=True)
class _Quantiles:
    """As published: of any robot, whose number of dimensions is looked at later."""

    q01: tuple[float, ...]
    q99: tuple[float, ...]
    mask: tuple[bool, ...] = ()


@dataclass(frozen=True, slots=True)
class _Statistics:
    action: _Quantiles


@dataclass(frozen=True, slots=True)
class Flying:
    """Which of a network's numbers fly, and by what they are multiplied.

    As text `0+1+2+5`, and `1.875+1.875+0.5+1.5`; raises `ModelError` for another form.
    """

    dims: tuple[int, ...] = tuple(range(ACTION_SIZE))
    scale: tuple[float, ...] = (1.0,) * ACTION_SIZE

    @classmethod
    def parse(cls, dims: str | None, scale: str | None) -> Flying:
        """Of the policy's arguments."""
        try:
            chosen = cls().dims if dims is None else tuple(int(each) for each in str(dims).split("+"))
            factors = cls().scale if scale is None else tuple(float(each) for each in str(scale).split("+"))
        except ValueError:
            chosen = factors = ()
        sizes = {len(chosen), len(factors)}
        if sizes != {ACTION_SIZE} or min(chosen) < 0 or not np.isfinite(factors).all():
            raise ModelError(
                f"dims={dims} or scale={scale} is not {ACTION_SIZE} numbers, for vx, vy, vz and yaw rate; write for"
                " example dims=0+1+2+5,scale=1.875+1.875+0.5+1.5"
            )
        return cls(chosen, factors)

    def of(self, actions: FloatArray) -> Commands:
        """(..., 4) of a network's actions (..., width)."""
        chosen: Commands = np.asarray(actions)[..., self.dims] * np.asarray(self.scale)
        return chosen


def choose_statistics(
    norm_stats: Mapping[str, Any], key: str | None, dims: tuple[int, ...] | None = None
) -> tuple[str, ActionStatistics]:
    """The statistics under `key`, or the only ones that are a drone's: published checkpoints also hold those of arms.

    `dims` are the numbers that fly where there are more than a drone's. Raises `ModelError` where there are none,
    several and no key, an unknown key, or those of another robot.
    """
    if not isinstance(norm_stats, Mapping) or not norm_stats:
        raise ModelError(
            "the checkpoint has no action statistics (norm_stats in config.json, or dataset_statistics.json beside it);"
            " without them its answers have no unit: copy that file there, or fine-tune the checkpoint on flights"
        )
    if key is None:
        key = _only_drone(norm_stats, dims)
    if key not in norm_stats:
        hint = did_you_mean(key, norm_stats)
        raise ModelError(f"the checkpoint has no statistics {key!r}; {hint}; there are {_widths(norm_stats)}")
    width = _numbers(norm_stats[key])
    if width is not None and ((dims is None and width != ACTION_SIZE) or (dims and max(dims) >= width)):
        raise ModelError(
            f"statistics {key!r} have {width} numbers; a drone's action has {ACTION_SIZE}: vx, vy, vz, yaw rate. Say"
            f" which fly, such as dims=0+1+2+5, or fine-tune it on flights; the checkpoint has {_widths(norm_stats)}"
        )
    check_form(_Statistics, norm_stats[key], f"statistics {key!r} lack readable q01 and q99: ", ModelError)
    try:
        table = norm_stats[key]["action"]
        q01, q99 = (tuple(float(value) for value in table[name]) for name in ("q01", "q99"))
        return key, ActionStatistics(q01, q99, tuple(table.get("mask", [True] * len(q01))))
    except TypeError:  # of null among the numbers
        raise ModelError(f"statistics {key!r} lack readable q01 and q99") from None
    except ModelError as error:
        raise ModelError(f"statistics {key!r}: {error}") from None


def _widths(norm_stats: Mapping[str, Any]) -> str:
    """The keys, each with the number of its dimensions."""
    shown = [f"{key} ({_numbers(norm_stats[key]) or '?'})" for key in sorted(norm_stats)]
    return ", ".join(shown[:8]) + (f" and {len(shown) - 8} more" if len(shown) > 8 else "")


def _only_drone(norm_stats: Mapping[str, Any], dims: tuple[int, ...] | None) -> str:
    if len(norm_stats) == 1:
        return next(iter(norm_stats))
    enough = ACTION_SIZE if dims is None else max(dims) + 1
    widths = {key: _numbers(table) or 0 for key, table in norm_stats.items()}
    drones = sorted(key for key, width in widths.items() if (width == enough if dims is None else width >= enough))
    if not drones:
        raise ModelError(
            f"the checkpoint has the statistics of {len(norm_stats)} data sets, none with the {enough} numbers of a"
            f" drone's action: vx, vy, vz, yaw rate. Say which fly (dims=0+1+2+5), or fine-tune it; it has"
            f" {_widths(norm_stats)}"
        )
    if len(drones) > 1:
        more = ", ..." if len(drones) > 8 else ""
        raise ModelError(
            f"the checkpoint has the statistics of {len(drones)} data sets of drones; add unnorm_key=NAME,"
            f" one of {', '.join(drones[:8])}{more}"
        )
    return drones[0]


def _numbers(table: Any) -> int | None:
    """The number of action components, if the statistics give it."""
    try:
        return len(table["action"]["q01"])
    except (KeyError, TypeError):
        return None


def to_tokens(normalised: FloatArray) -> Tokens:
    """Token ids of actions (..., 4) in [-1, 1]: `WORDS` - 1 for -1, `WORDS` - 256 for 1."""
    return np.asarray(WORDS - np.digitize(np.clip(normalised, -1.0, 1.0), EDGES), dtype=np.int64)


def from_tokens(tokens: Tokens) -> FloatArray:
    """Bin centres of the ids (..., 4); a token that is not an action counts as the nearest one that is."""
    return np.asarray(CENTRES[np.clip(WORDS - tokens - 1, 0, len(CENTRES) - 1)])
