"""Overview of a store in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from cognitivedrone.data.pages.overview import Histogram, Overview, megabytes, overview
from cognitivedrone.data.store import Store
from cognitivedrone.types import CONTROL_HZ

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
