"""Print how long one 10 Hz control step of flight takes (40 ticks of 2.5 ms): python benchmarks/dynamics.py.

Medians over batches of different size, as a multiple of real time, and as a ratio to MuJoCo's bare physics without an
autopilot.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mujoco.batch import Batch

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.sim.airframe import GRAVITY, RACER, build_model
from cognitivedrone.sim.dynamics import BatchedFlight

TICKS = 40
REPEATS = 60
CASES = ((1, 1), (4, 1), (16, 1), (64, 1), (64, 2), (256, 2))
"""Worlds and threads."""


def median_ms(work: Callable[[], object]) -> float:
    """Of `REPEATS` calls, after a few that warm up."""
    times = []
    for k in range(REPEATS + 5):
        start = time.perf_counter()
        work()
        if k >= 5:
            times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    print("| worlds | threads | control step ms | times real time, all worlds | over bare physics |")
    print("|---|---|---|---|---|")
    for worlds, threads in CASES:
        flight = BatchedFlight(worlds, threads=threads)
        actions = np.random.default_rng(0).uniform(-1, 1, (worlds, 4)) * [1, 1, 0.1, 1]

        def step(flight: BatchedFlight = flight, actions: np.ndarray = actions) -> None:
            flight.command(actions)
            flight.advance(TICKS)

        bare = Batch(build_model(RACER, BatchedFlight.TICK_S), worlds, threads)
        bare.act = bare.ctrl = RACER.mass * GRAVITY / 4  # hovering clear of the floor, as ours
        ours, physics = median_ms(step), median_ms(partial(bare.step, nstep=TICKS))
        real_time = worlds * TICKS * BatchedFlight.TICK_S * 1e3 / ours
        print(f"| {worlds} | {threads} | {ours:.2f} | {real_time:,.0f} | {ours / physics:.1f} |", flush=True)
        times = {"step_ms": ours, "real_time": real_time, "over_physics": ours / physics}
        rows.append({"worlds": worlds, "threads": threads, **times})
        keep(options.out, "One 10 Hz control step of flight: 40 ticks of 2.5 ms", rows, seed=0)


if __name__ == "__main__":
    main()
