"""Overview of a store: shared by the terminal's summary and the HTML card."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.store import Store
from cognitivedrone.types import CONTROL_HZ

ACTION_NAMES: Final = (("vx", "m/s"), ("vy", "m/s"), ("vz", "m/s"), ("yaw rate", "rad/s"))
BINS: Final = 24


@dataclass(frozen=True, slots=True)
class Histogram:
    """Counts of values in equal bins from `low` to `high`."""

    name: str
    unit: str
    low: float
    high: float
    counts: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class FamilyCount:
    """Episodes of a family."""

    category: str
    family: str
    train: int
    val: int

    @property
    def total(self) -> int:
        """Episodes in both splits."""
        return self.train + self.val


@dataclass(frozen=True, slots=True)
class Overview:
    """Overview of a store."""

    manifest: dict[str, Any]
    statistics: dict[str, Any]
    families: tuple[FamilyCount, ...]
    """By category, then by name."""
    actions: tuple[Histogram, ...]
    """One histogram for each of the four components."""
    lengths: Histogram
    """Lengths of the episodes, in seconds."""
    bytes_on_disk: int
    frame_bytes: float
    """Approximate mean size of a step's encoded frames: the shards' bytes over their steps."""
    down_camera: bool
    """Whether every step has a frame of the camera that looks down, too."""
    encodings: dict[str, int]
    """Episodes by image encoding."""
    hours: float
    """Hours of flight."""

    @property
    def flown(self) -> str:
        """The time of flight as text, below an hour in minutes."""
        return f"{self.hours:.1f} h" if self.hours >= 1 else f"{60 * self.hours:.1f} min"


def overview(store: Store) -> Overview:
    """The overview of a store, without reading frames. Raises `DataError` if a shard or the statistics are broken."""
    facts = store.facts()
    shard_bytes = sum(receipt["bytes"] for receipt in store.manifest["shards"])
    actions = store.actions()
    seconds = np.array([entry["length"] for entry in facts]) / CONTROL_HZ
    return Overview(
        manifest=store.manifest,
        statistics=store.statistics(),
        families=_family_counts(store, facts),
        actions=tuple(histogram(actions[:, k], *name) for k, name in enumerate(ACTION_NAMES)),
        lengths=histogram(seconds, "length", "s"),
        bytes_on_disk=sum(file.stat().st_size for file in store.path.rglob("*") if file.is_file()),
        frame_bytes=shard_bytes / max(1, store.n_steps),
        down_camera=store.down_camera,
        encodings=dict(sorted(Counter(entry["encoding"] for entry in facts).items())),
        hours=store.n_steps / CONTROL_HZ / 3600,
    )


def histogram(values: NDArray[Any], name: str, unit: str, bins: int = BINS) -> Histogram:
    """Histogram of values (N,) over their whole range; an empty range is widened so that it can be shown."""
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    if high - low < 1e-6:
        low, high = low - 0.5, high + 0.5
    counts, _ = np.histogram(values, bins=bins, range=(low, high))
    return Histogram(name, unit, low, high, tuple(int(count) for count in counts))


def _family_counts(store: Store, facts: list[dict[str, Any]]) -> tuple[FamilyCount, ...]:
    counts = Counter(
        (entry["task"]["category"], entry["task"]["family"], store.split_of(entry["index"])) for entry in facts
    )
    names = sorted({(category, family) for category, family, _ in counts})
    return tuple(FamilyCount(*name, counts[*name, "train"], counts[*name, "val"]) for name in names)


def megabytes(size: float) -> str:
    """A size in human-readable form."""
    for unit in ("bytes", "KB", "MB"):
        if size < 1000:
            return f"{size:.0f} {unit}" if unit == "bytes" or size >= 100 else f"{size:.1f} {unit}"
        size /= 1000
    return f"{size:.2f} GB"
