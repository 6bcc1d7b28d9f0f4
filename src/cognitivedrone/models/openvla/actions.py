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

    Raises `ModelError` for what is not four finite numbers each, in order.
    """

    q01: tuple[float, ...]
    """vx, vy, vz in m/s, yaw rate in rad/s."""
    q99: tuple[float, ...]
    mask: tuple[bool, ...] = (True,) * ACTION_SIZE
    """Whether the network's output in a dimension is scaled."""

    def __post_init__(self) -> None:
        for name, values in (("q01", self.q01), ("q99", self.q99), ("mask", self.mask)):
            if len(values) != ACTION_SIZE:
                raise ModelError(
                    f"{name} has {len(values)} numbers; a drone's action has {ACTION_SIZE}: vx, vy, vz, yaw rate."
                    " Fine-tune the checkpoint on flights before you fly it"
                )
        low, high = np.asarray(self.q01), np.asarray(self.q99)
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
            raise ModelError(f"q01 is {list(self.q01)} and q99 {list(self.q99)}; they must be finite, q01 <= q99")

    def to_json(self) -> dict[str, Any]:
        """The form under `norm_stats.KEY.action` of a published `config.json`."""
        return {"q01": list(self.q01), "q99": list(self.q99), "mask": list(self.mask)}

    def normalise(self, actions: Commands) -> Commands:
        """Actions (..., 4) normalised for training, in [-1, 1]; 0 in a dimension that never moves."""
        low, high, mask = self._arrays()
        width = high - low
        moving = width > STILL
        scaled = np.clip(2.0 * (actions - low) / np.where(moving, width, 1.0) - 1.0, -1.0, 1.0)
        scaled = np.where(moving, scaled, 0.0)
        return np.asarray(np.where(mask, scaled, actions))

    def flown(self, normalised: Commands) -> Commands:
        """The network's outputs (..., 4) in [-1, 1] as velocities; a dimension that never moves keeps its value."""
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


def choose_statistics(norm_stats: Mapping[str, Any], key: str | None) -> tuple[str, ActionStatistics]:
    """The statistics under `key`, or the only ones that are a drone's: published checkpoints also hold those of arms.

    Raises `ModelError` where there are none, several and no key, an unknown key, or those of another robot.
    """
    if not isinstance(norm_stats, Mapping) or not norm_stats:
        raise ModelError(
            "the checkpoint has no action statistics (norm_stats in config.json, or dataset_statistics.json beside it);"
            " without them its answers have no unit: copy that file there, or fine-tune the checkpoint on flights"
        )
    if key is None:
        key = _only_drone(norm_stats)
    if key not in norm_stats:
        raise ModelError(f"the checkpoint has no statistics {key!r}; {did_you_mean(key, norm_stats)}")
    check_form(_Statistics, norm_stats[key], f"statistics {key!r} lack readable q01 and q99: ", ModelError)
    try:
        table = norm_stats[key]["action"]
        q01, q99 = (tuple(float(value) for value in table[name]) for name in ("q01", "q99"))
        return key, ActionStatistics(q01, q99, tuple(table.get("mask", [True] * len(q01))))
    except TypeError:  # of null among the numbers
        raise ModelError(f"statistics {key!r} lack readable q01 and q99") from None
    except ModelError as error:
        raise ModelError(f"statistics {key!r}: {error}") from None


def _only_drone(norm_stats: Mapping[str, Any]) -> str:
    if len(norm_stats) == 1:
        return next(iter(norm_stats))
    drones = sorted(key for key, table in norm_stats.items() if _numbers(table) == ACTION_SIZE)
    if not drones:
        raise ModelError(
            f"the checkpoint has the statistics of {len(norm_stats)} data sets, none with the {ACTION_SIZE} numbers of"
            " a drone's action: vx, vy, vz, yaw rate. Fine-tune it on flights before you fly it"
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
