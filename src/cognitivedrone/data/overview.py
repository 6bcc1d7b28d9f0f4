"""Overview of a store: for the terminal, and for the HTML card."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

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


LEVELS: Final = " ▁▂▃▄▅▆▇█"


def summary(path: Path | str) -> RenderableType:
    """Counts by family, lengths, action histograms, size on disk and encoding. Raises `DataError`."""
    seen = overview(Store.open(path))
    return Group(_headline(Path(path), seen), "", _families(seen), _actions(seen), *_dropped(seen))


def _headline(path: Path, seen: Overview) -> RenderableType:
    manifest = seen.manifest
    recipe = manifest["recipe"].get("name", "unnamed")
    cameras = "two cameras' frames" if seen.down_camera else "frames"
    encodings = ", ".join(f"{name} ({count:,} episodes)" for name, count in seen.encodings.items())
    grid = Table.grid(padding=(0, 2))
    grid.add_row("data set", Text(str(path), style="bold"))
    grid.add_row("made by", f"recipe {recipe}, suite {manifest['suite']['name']}, seed {manifest['seed']}")
    grid.add_row("holds", f"{manifest['episodes']:,} episodes, {manifest['steps']:,} steps, {seen.flown} of flight")
    grid.add_row(
        "on disk", f"{megabytes(seen.bytes_on_disk)}; {megabytes(seen.frame_bytes)} a step, {cameras} as {encodings}"
    )
    return grid


def _families(seen: Overview) -> Table:
    table = Table("category", "family", box=box.SIMPLE_HEAD)
    for name in ("train", "val", "all"):
        table.add_column(name, justify="right")
    for row in seen.families:
        table.add_row(
            row.category.replace("_", " "), row.family.replace("_", " "), str(row.train), str(row.val), str(row.total)
        )
    table.add_section()
    table.add_row("all", "", *(f"{seen.statistics[name]['episodes']:,}" for name in ("train", "val", "all")))
    return table


def _actions(seen: Overview) -> Table:
    table = Table("", box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("min", justify="right")
    table.add_column("histogram", no_wrap=True)
    table.add_column("max")
    table.add_column("mean", justify="right")
    table.add_column("std", justify="right")
    described: dict[str, Any] = seen.statistics["all"]
    for k, shape in enumerate(seen.actions):
        spread = described["action"]
        _add_histogram(table, shape, f"{spread['mean'][k]:.2f}", f"{spread['std'][k]:.2f}")
    _add_histogram(table, seen.lengths, f"{described['length']['mean'] / CONTROL_HZ:.2f}", "")
    return table


def _add_histogram(table: Table, shape: Histogram, mean: str, std: str) -> None:
    table.add_row(f"{shape.name} {shape.unit}", f"{shape.low:.2f}", bars(shape), f"{shape.high:.2f}", mean, std)


def bars(shape: Histogram) -> str:
    """A histogram as one line of block characters; a non-empty bin is always visible."""
    top = max(shape.counts, default=0) or 1
    full = len(LEVELS) - 1
    return "".join(LEVELS[0 if count == 0 else max(1, round(full * count / top))] for count in shape.counts)


def _dropped(seen: Overview) -> list[RenderableType]:
    dropped = seen.manifest["dropped"]
    if not dropped:
        return ["No flight was dropped."]
    text = ", ".join(f"{count} {outcome.replace('_', ' ')}" for outcome, count in dropped.items())
    return [f"Flights flown but not kept: {text}."]
