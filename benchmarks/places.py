"""What photographed places cost beside varied rooms: `python benchmarks/places.py [--out results/places.json]`.

Control steps of a vector environment of 16 worlds, with full dynamics and 256x256 frames, then the same frames alone,
with and without lens and camera. Contenders take turns, so that a busy machine is busy for all of them. Prints medians
over turns, and ratios to varied.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from environment import ACTION, ID
from rendering import WORLDS, pictures, random_stage

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.world.appearance import PLAIN, Appearance, photo_appearance, varied_appearance
from cognitivedrone.world.geometry import START
from cognitivedrone.world.places import names

TURNS = 9
CALLS = 12
"""Of a contender in one turn."""
YAW_RATE = 0.6
"""Standard deviation of yaw rates in the frames alone, rad/s."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    parser.add_argument("--turns", type=int, default=TURNS)
    options = parser.parse_args(arguments)
    cores = len(os.sched_getaffinity(0))
    print(f"{platform.machine()}, {cores} cores, {renderer_name()}, {os.getloadavg()[0]:.1f} processes running already")
    rows: list[dict[str, Any]] = []
    steps = {look: env_steps(look) for look in ("plain", "varied", "photo")}
    rows += told("control steps/s, vector of 16", per_second(steps, options.turns))
    frames = {look: frames_of(drawn) for look, drawn in looks().items()}
    rows += told("frames/s alone", per_second(frames, options.turns))
    for slots in (1, WORLDS):
        seconds = statistics.median(opening(slots) for _ in range(3))
        print(f"cameras of {slots:2} worlds: {1e3 * seconds:6.0f} ms until they are there")
        rows.append({"what": f"cameras of {slots} worlds", "ms": 1e3 * seconds})
    keep(options.out, "What photographed places cost beside varied rooms", rows, seed=0)


def env_steps(look: str) -> Callable[[], object]:
    env = gymnasium.make_vec(ID, num_envs=WORLDS, copy=False, appearance=look)
    env.reset(seed=0)
    actions = np.tile(ACTION, (WORLDS, 1))
    return lambda: env.step(actions)


def looks() -> dict[str, list[Appearance]]:
    """Appearances of the frames alone; what is without a lens has neither it nor blur, but the camera of varied."""
    rng = np.random.default_rng(0)
    photo = [photo_appearance(rng, names("training")) for _ in range(WORLDS)]
    bare = [replace(each, distortion=0.0, vignetting=0.0, exposure_s=0.0) for each in photo]
    perfect = [replace(each, gain=1.0, gamma=1.0, noise=0.0) for each in bare]
    varied = [varied_appearance(rng) for _ in range(WORLDS)]
    return {
        "plain": [PLAIN] * WORLDS,
        "varied": varied,
        "photo": photo,
        "photo without a lens": bare,
        "photo, perfect camera": perfect,
    }


def frames_of(drawn: list[Appearance]) -> Callable[[], object]:
    rng = np.random.default_rng(1)
    cameras = Cameras(WORLDS)
    for slot, appearance in enumerate(drawn):
        cameras.set_stage(slot, random_stage(rng), pictures(rng), appearance=appearance)
    out = np.empty((WORLDS, 256, 256, 3), np.uint8)

    def draw() -> object:
        positions = START + rng.uniform([-1, -1, -0.5], 1, (WORLDS, 3))
        quaternions = quaternion_from_yaw(rng.normal(0, 0.2, WORLDS))
        return cameras.first_person(positions, quaternions, out, yaw_rates=rng.normal(0, YAW_RATE, WORLDS))

    return draw


def per_second(contenders: dict[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """Median worlds a second of each contender; its calls are for all worlds."""
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(turns + 1):
        for name, call in contenders.items():
            begin = time.perf_counter()
            for _ in range(CALLS):
                call()
            if turn:  # the first warms up
                seconds[name].append(time.perf_counter() - begin)
    return {name: WORLDS * CALLS / statistics.median(took) for name, took in seconds.items()}


def told(what: str, rates: dict[str, float]) -> list[dict[str, Any]]:
    for name, rate in rates.items():
        print(f"{what}: {name:22} {rate:7.0f}   {rate / rates['varied']:5.2f} x varied")
    return [
        {"what": what, "look": name, "per_s": rate, "ratio": rate / rates["varied"]} for name, rate in rates.items()
    ]


def opening(slots: int) -> float:
    begin = time.perf_counter()
    with Cameras(slots):
        return time.perf_counter() - begin


if __name__ == "__main__":
    main()
