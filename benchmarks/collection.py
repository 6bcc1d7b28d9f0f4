"""Speed, memory and size of collecting data: the recipe `paper` with one worker and with two.

Run: python benchmarks/collection.py [episodes] [--out results/collection.json]

Prints kept episodes a second from the call to the finished store, starting of the processes included, the ratio of two
workers to one, how long 8,062 episodes take at that speed, the largest memory of all processes together (proportional
set size, which counts shared pages once), the share of flights that were passed, and the size of a frame on disk.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import threading
from pathlib import Path
from typing import Any

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.collect.collector import CollectReport, collect
from cognitivedrone.collect.config import CollectPlan
from cognitivedrone.collect.recipe import RECIPES
from cognitivedrone.data.store import Store

MEGABYTE = 1e6


def memory_of(pid: int) -> float:
    """Proportional set size of a process and all below it, MB."""
    total = 0.0
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        total += sum(int(line.split()[1]) * 1024 / MEGABYTE for line in lines if line.startswith("Pss:"))
    except OSError:  # it ended meanwhile
        return 0.0
    return total + sum(memory_of(int(child)) for child in children)


class Peak:
    """The largest memory while it runs, looked at twice a second."""

    def __enter__(self) -> Peak:
        self.megabytes = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def _watch(self) -> None:
        while not self._stop.wait(0.5):
            self.megabytes = max(self.megabytes, memory_of(os.getpid()))

    def __exit__(self, *exc: object) -> None:
        self._stop.set()
        self._thread.join()


def measure(out: Path, episodes: int, workers: int) -> tuple[CollectReport, dict[str, Any]]:
    """The report, and its row."""
    with Peak() as peak:
        report = collect(CollectPlan.of(out=out, episodes=episodes, workers=workers), progress=False)
    whole = RECIPES["paper"].episodes / report.episodes_per_s / 60
    print(
        f"workers {workers}: {report.episodes_per_s:5.1f} episodes/s ({whole:.1f} min for {RECIPES['paper'].episodes}),"
        f" memory {peak.megabytes:.0f} MB, {100 * report.success_rate:.2f} % of flights passed"
    )
    speed = {"episodes_per_s": report.episodes_per_s, "minutes_8062": whole, "memory_mb": peak.megabytes}
    return report, {"workers": workers, **speed, "passed": report.success_rate}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("episodes", type=int, nargs="?", default=512)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    episodes = options.episodes
    print(
        f"{platform.processor() or platform.machine()}, {len(os.sched_getaffinity(0))} CPUs, load {os.getloadavg()[0]}"
    )
    with tempfile.TemporaryDirectory() as folder:
        one, row_of_one = measure(Path(folder, "one"), episodes, 1)
        two, row_of_two = measure(Path(folder, "two"), episodes, 2)
        print(f"two workers to one: {two.episodes_per_s / one.episodes_per_s:.2f}")
        store = Store.open(two.out)
        size = sum(path.stat().st_size for path in two.out.rglob("*") if path.is_file())
        print(
            f"{store.n_steps / len(store):.1f} steps and {size / len(store) / 1e3:.0f} KB an episode,"
            f" {size / store.n_steps / 1e3:.2f} KB a step, frames as {RECIPES['paper'].encoding}"
        )

    rows = [row_of_one, row_of_two]
    keep(options.out, f"Speed and memory of collecting, {episodes} episodes of the recipe paper", rows, seed=0)


if __name__ == "__main__":
    main()
