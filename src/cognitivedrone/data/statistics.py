"""Statistics of a store by split, for normalising actions in training and for a first overview."""

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
LARGE: Final = 1000
"""From this number of episodes on, a hash alone selects `val`: each of ten families is then represented."""
EXACT: Final = "exactly 5 %"
"""The manifest's name for the rule of smaller sets."""


@dataclass(frozen=True, slots=True)
class Flown:
    """The parts of an episode that statistics need."""

    index: int
    family: str
    category: str
    action: NDArray[np.float32]
    """(T, 4)."""
    state: NDArray[np.float32]
    """(T, 5)."""


def draw_of(suite_digest: str, index: int) -> float:
    """A permanent number in [0, 1) for an episode: it depends only on the suite's content and its index."""
    digest = hashlib.sha256(f"{suite_digest}/{index}".encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2**64


def draw_splits(suite_digest: str, families: Mapping[int, str]) -> dict[str, Any]:
    """The splits of a set in the manifest's form; `families` names the family of every episode index.

    A set of `LARGE` episodes or more is split by `threshold_indices`, without an entry `rule`. A smaller one has
    exactly 5 % for validation, by `exact_indices`.
    """
    if len(families) >= LARGE:
        val = threshold_indices(suite_digest, families)
        return {"train": len(families) - len(val), "val": val}
    val = exact_indices(suite_digest, families)
    return {"train": len(families) - len(val), "val": val, "rule": EXACT}


def threshold_indices(suite_digest: str, families: Mapping[int, str]) -> list[int]:
    """The episodes whose draw is below 5 %, in order: about 5 %, regardless of the other episodes.

    If a family of two episodes or more would be missing from a split, its episode with the nearest draw is moved there.
    """
    val: set[int] = set()
    for members in _by_draw(suite_digest, families).values():
        below = sum(draw < VAL_SHARE for draw, _ in members)
        if len(members) > 1:
            below = min(max(below, 1), len(members) - 1)
        val.update(index for _, index in members[:below])
    return sorted(val)


def exact_indices(suite_digest: str, families: Mapping[int, str]) -> list[int]:
    """5 % of the episodes to the nearest whole number, at least one of two or more; in order.

    Each family gets its share, as nearly as whole numbers allow. Within a family the lowest draws are taken.
    """
    count = len(families)
    wanted = max((count + 10) // 20, 1) if count > 1 else 0
    places = sorted(
        ((rank + 0.5) / len(members), draw, index)
        for members in _by_draw(suite_digest, families).values()
        for rank, (draw, index) in enumerate(members)
    )
    return sorted(index for *_, index in places[:wanted])


def _by_draw(suite_digest: str, families: Mapping[int, str]) -> dict[str, list[tuple[float, int]]]:
    """Draws and indices of every family, sorted by draw."""
    members: dict[str, list[tuple[float, int]]] = {}
    for index, family in families.items():
        members.setdefault(family, []).append((draw_of(suite_digest, index), index))
    return {family: sorted(drawn) for family, drawn in members.items()}


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
    """Spread of values (N, D): 1 % and 99 % quantiles, mean, standard deviation, minimum and maximum, D each."""
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
