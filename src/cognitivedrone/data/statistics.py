"""Statistics of a store, by split: what normalises actions in training, and what a reader wants to know first."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Split

VAL_SHARE: Final = 0.05
SPLITS: Final[tuple[Split, ...]] = ("train", "val")


@dataclass(frozen=True, slots=True)
class Flown:
    """What statistics need to know of an episode."""

    index: int
    family: str
    category: str
    action: NDArray[np.float32]
    """(T, 4)."""
    state: NDArray[np.float32]
    """(T, 5)."""


def draw_of(suite_digest: str, index: int) -> float:
    """A number in [0, 1) that an episode has for good: it depends on the suite's content and its index alone."""
    digest = hashlib.sha256(f"{suite_digest}/{index}".encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2**64


def validation_indices(suite_digest: str, families: Mapping[int, str]) -> list[int]:
    """The episodes of the `val` split, in order; `families` names the family of every episode index.

    An episode is in `val` where its draw is below 5 %. So that small sets have all families in both splits too, a
    family of two episodes or more that would be missing from a split lends it the episode whose draw lies nearest.
    """
    val: set[int] = set()
    for family in set(families.values()):
        members = sorted((draw_of(suite_digest, index), index) for index, name in families.items() if name == family)
        below = sum(draw < VAL_SHARE for draw, _ in members)
        if len(members) > 1:
            below = min(max(below, 1), len(members) - 1)
        val.update(index for _, index in members[:below])
    return sorted(val)


def statistics(episodes: Sequence[Flown], val: Iterable[int]) -> dict[str, dict[str, Any]]:
    """Counts, lengths and the spread of actions and states, for `train`, `val` and `all`, as plain JSON."""
    chosen = frozenset(val)
    members = {
        "train": [episode for episode in episodes if episode.index not in chosen],
        "val": [episode for episode in episodes if episode.index in chosen],
        "all": list(episodes),
    }
    return {split: _describe(flown) for split, flown in members.items()}


def _describe(episodes: Sequence[Flown]) -> dict[str, Any]:
    lengths = [len(episode.action) for episode in episodes]
    description: dict[str, Any] = {
        "episodes": len(episodes),
        "steps": sum(lengths),
        "families": _count(episode.family for episode in episodes),
        "categories": _count(episode.category for episode in episodes),
    }
    if episodes:
        description["length"] = {"min": min(lengths), "max": max(lengths), "mean": sum(lengths) / len(lengths)}
        description["action"] = spread(np.concatenate([episode.action for episode in episodes]))
        description["state"] = spread(np.concatenate([episode.state for episode in episodes]))
    return description


def spread(values: NDArray[Any]) -> dict[str, list[float]]:
    """Of values (N, D): quantiles at 1 and 99 %, mean, standard deviation, least and largest, D numbers each."""
    exact = values.astype(np.float64)
    return {
        "q01": np.quantile(exact, 0.01, axis=0).tolist(),
        "q99": np.quantile(exact, 0.99, axis=0).tolist(),
        "mean": exact.mean(axis=0).tolist(),
        "std": exact.std(axis=0).tolist(),
        "min": exact.min(axis=0).tolist(),
        "max": exact.max(axis=0).tolist(),
    }


def _count(names: Iterable[str]) -> dict[str, int]:
    return dict(sorted(Counter(names).items()))
