"""The summary in the terminal says how many, how long, how large and what the actions look like."""

from pathlib import Path

import numpy as np
import pytest
from made_stores import write_store
from rich.console import Console

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.overview import Histogram, bars, histogram, megabytes, overview, summary
from cognitivedrone.data.store import Store
from cognitivedrone.tasks import BASE_FAMILIES


def shown(store: Path) -> str:
    console = Console(width=160, record=True)
    with console.capture() as captured:
        console.print(summary(store))
    return captured.get()


def test_summary_names_what_is_in_the_set(sound_store: Path, flights: list[Episode], tmp_path: Path) -> None:
    assert "No flight was dropped." in shown(write_store(tmp_path / "one", flights[:1]))
    text = shown(sound_store)
    assert f"40 episodes, {sum(map(len, flights))} steps" in text
    assert "recipe test, suite open-v1:train, seed 3" in text
    assert "frames as png (40 episodes)" in text
    assert "10 collision" in text
    assert all(family.replace("_", " ") in text for family in BASE_FAMILIES)
    assert all(name in text for name in ("vx", "vy", "vz", "yaw rate"))


def test_overview_counts_every_episode_and_every_byte(sound_store: Path, flights: list[Episode]) -> None:
    seen = overview(Store.open(sound_store))
    assert sum(family.total for family in seen.families) == 40
    assert all(sum(shape.counts) == sum(map(len, flights)) for shape in seen.actions)
    assert sum(seen.lengths.counts) == 40
    assert (seen.lengths.low, seen.lengths.high) == pytest.approx((0.2, 0.5))
    assert seen.bytes_on_disk == sum(file.stat().st_size for file in sound_store.rglob("*") if file.is_file())


def test_histogram_of_a_constant_is_one_full_bin() -> None:
    shape = histogram(np.zeros(7), "vy", "m/s")
    assert sum(shape.counts) == max(shape.counts) == 7
    assert shape.low < 0 < shape.high


def test_bars_show_every_bin_that_is_not_empty() -> None:
    assert bars(Histogram("x", "m", 0, 1, (0, 1, 500, 1000))) == " ▁▄█"


def test_sizes_are_readable() -> None:
    assert [megabytes(size) for size in (12, 4_600, 512_000, 80_300_000, 2.5e9)] == [
        "12 bytes", "4.6 KB", "512 KB", "80.3 MB", "2.50 GB"
    ]  # fmt: skip
