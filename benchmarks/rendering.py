"""Frames a second, and what a change of stage costs: `python benchmarks/rendering.py`.

Prints medians over rounds, and ratios. One round renders every world once from a random pose in its start box.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate, Stage
from cognitivedrone.world.appearance import PLAIN, Appearance, varied_appearance
from cognitivedrone.world.geometry import START

WORLDS = 16


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    rounds = options.rounds
    rng = np.random.default_rng(0)
    print(f"renderer: {renderer_name()}; 256x256 RGB, {WORLDS} worlds, medians of {rounds} rounds")
    looks = {"plain": [PLAIN] * WORLDS, "varied": [varied_appearance(rng) for _ in range(WORLDS)]}
    single = 0.0
    rows: list[dict[str, Any]] = []
    for name, worlds in looks.items():
        rates = []
        for threads in (1, 2):
            rate = frame_rate(worlds, threads, rounds, rng)
            rates.append(rate)
            single = single or rate
            print(f"{name:7} {threads} thread(s): {rate:6.0f} frames/s, {rate / single:4.2f} x plain with one thread")
        row = {"appearance": name, "frames_per_s_1": rates[0], "frames_per_s_2": rates[1], "ratio": rates[1] / rates[0]}
        rows.append(row)
    for name, worlds in looks.items():
        change, first = stage_change(worlds, rounds, rng)
        print(f"{name:7} change of stage: {change:5.2f} ms, with the first frame {first:5.2f} ms")
    keep(options.out, "Rendering alone: 16 worlds, 256x256 RGB, medians over rounds", rows, seed=0)


def frame_rate(
    looks: list[Appearance],
    threads: int,
    rounds: int,
    rng: np.random.Generator,
) -> float:
    """Frames a second."""
    out = np.empty((WORLDS, 256, 256, 3), np.uint8)
    with Cameras(WORLDS, threads=threads) as cameras:
        for slot, appearance in enumerate(looks):
            cameras.set_stage(slot, random_stage(rng), pictures(rng), appearance=appearance)

        def render() -> None:
            positions = START + rng.uniform([-1, -1, -0.5], 1, (WORLDS, 3))
            cameras.first_person(positions, quaternion_from_yaw(rng.normal(0, 0.2, WORLDS)), out)

        return WORLDS / median_seconds(render, rounds)


def stage_change(looks: list[Appearance], rounds: int, rng: np.random.Generator) -> tuple[float, float]:
    """Milliseconds of `set_stage`, and of it with the first frame of the new stage."""
    with Cameras(1) as cameras:

        def change() -> None:
            cameras.set_stage(0, random_stage(rng), images, appearance=looks[rng.integers(WORLDS)])

        def change_and_look() -> None:
            change()
            cameras.first_person(START[None], np.array([[1.0, 0.0, 0.0, 0.0]]))

        images = pictures(rng)
        return 1e3 * median_seconds(change, rounds), 1e3 * median_seconds(change_and_look, rounds)


def random_stage(rng: np.random.Generator) -> Stage:
    colors = rng.permutation(np.array(COLORS))
    gates = [Gate(SIZES[rng.integers(2)], SHAPES[rng.integers(3)], color) for color in colors]
    return Stage(gates=(gates[0], gates[1], gates[2]), labels=("", "", ""))


def pictures(rng: np.random.Generator) -> list[np.ndarray]:
    """Two square pictures of the textures' size and one that has to be resized."""
    return [rng.integers(0, 256, (256, width, 3), dtype=np.uint8) for width in (256, 256, 200)]


def median_seconds(job: Callable[[], None], rounds: int) -> float:
    times = []
    for _ in range(rounds + 5):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return statistics.median(times[5:])


if __name__ == "__main__":
    main()
