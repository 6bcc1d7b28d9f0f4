"""Memory, descriptors and threads of a process that flies many short episodes: none may grow with their number.

Run: python benchmarks/endurance.py [--episodes 2000] [--every 100] [--out FILE]

Every episode is a new task with new pictures. The drone flies into the floor, and every tenth time the policy raises.
"""

from __future__ import annotations

import argparse
import resource
import threading
import warnings
from pathlib import Path

import numpy as np

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.interfaces import Policy
from cognitivedrone.pilot import Pilot
from cognitivedrone.types import ActionChunk, EpisodeContext, Observation


class Diver(Policy):
    """Flies into the floor, and raises in every tenth flight."""

    def __init__(self) -> None:
        self.flights = 0

    def reset(self, context: EpisodeContext) -> None:
        self.flights += 1

    def act(self, observation: Observation) -> ActionChunk:
        if self.flights % 10 == 0:
            raise RuntimeError("CUDA out of memory")
        return np.array([[0.0, 0.0, -1.5, 0.0]], np.float32)


def measured() -> dict[str, float]:
    """Resident memory in MB, open descriptors, threads."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return {
        "memory_mb": round(pages * resource.getpagesize() / 1e6, 1),
        "descriptors": len([*Path("/proc/self/fd").iterdir()]),
        "threads": threading.active_count(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--every", type=int, default=100, help="episodes between two rows")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    job = resolve(Plan.of(policy="diver", suite="open-v1:train", episodes=options.episodes), named=False)
    runner = PilotRunner(job, pilot=Pilot(Diver()))
    rows: list[dict[str, float]] = []
    try:
        for episode in job.episodes:
            if episode % options.every == 0:
                rows.append({"episodes": episode, **measured()})
                print(rows[-1], flush=True)
            runner.fly(episode, film=False)
        rows.append({"episodes": options.episodes, **measured()})
        print(rows[-1])
    finally:
        runner.close()
    keep(options.out, "Memory and descriptors of many short episodes", rows)


if __name__ == "__main__":
    main()
