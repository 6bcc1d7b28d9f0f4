"""The recipe `paper` in full: time, memory and size of its flights, and whether they replay.

Run: python benchmarks/collect_paper.py FOLDER [--episodes 8062] [--workers 2] [--out results/collect_paper.json]

Collects into FOLDER, which must be new, so that the time is that of one go, and leaves the set there. Then it flies
every fiftieth episode again and compares all positions and attitudes to the last bit.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from collection import MEGABYTE, Peak

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.collect.collector import collect
from cognitivedrone.collect.config import CollectPlan
from cognitivedrone.collect.recipe import RECIPES
from cognitivedrone.collect.replay import replay
from cognitivedrone.data.store import Store

EVERY = 50
"""Episodes from one that is replayed to the next."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--episodes", type=int, default=RECIPES["paper"].episodes)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    with Peak() as peak:
        report = collect(CollectPlan.of(out=options.folder, episodes=options.episodes, workers=options.workers))
    store = Store.open(options.folder)
    size = sum(path.stat().st_size for path in options.folder.rglob("*") if path.is_file())
    replays = [replay(store.episode(number)).same_bits for number in range(0, len(store), EVERY)]
    row = {
        "episodes": len(store),
        "steps": store.n_steps,
        "steps_per_episode": store.n_steps / len(store),
        "workers": options.workers,
        "wall_s": report.seconds,
        "episodes_per_s": report.episodes_per_s,
        "memory_mb": peak.megabytes,
        "not_passed": sum(report.dropped.values()),
        "size_gb": size / MEGABYTE / 1e3,
        "kb_per_episode": size / len(store) / 1e3,
        "kb_per_step": size / store.n_steps / 1e3,
        "replayed": len(replays),
        "replayed_equal": sum(replays),
    }
    print("\n".join(f"{name} {figure}" for name, figure in row.items()))
    keep(options.out, "The recipe paper: all its flights, with frames", [row], seed=0)


if __name__ == "__main__":
    main()
