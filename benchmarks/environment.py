"""Speed of the environments: control steps with full dynamics and 256x256 frames, and the time of a task change.

Run: python benchmarks/environment.py

Prints medians over repetitions, and their ratio to 38 control steps/s: what gym-pybullet-drones is reported to reach
with frames of this size on two cores (a figure from outside, not measured by this script).
"""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from cognitivedrone.sim.gl import renderer_name

REFERENCE_STEPS_S = 38
REPETITIONS = 7
STEPS = 30
ACTION = np.array([0.4, 0.0, 0.0, 0.1], np.float32)


def median_seconds(work: Callable[[], object], repetitions: int = REPETITIONS) -> float:
    times = []
    for _ in range(repetitions):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def flown_steps(env, action: NDArray[np.float32]) -> float:
    """Steps a second of an environment that has been reset, after some to warm up; it is closed then."""

    def fly() -> None:
        for _ in range(STEPS):
            env.step(action)

    fly()
    seconds = median_seconds(fly)
    env.close()
    return STEPS / seconds


def vector_steps(worlds: int) -> float:
    """Control steps a second of `worlds` worlds together."""
    env = gymnasium.make_vec("cognitivedrone.envs:CognitiveDrone-v1", num_envs=worlds, copy=False)
    env.reset(seed=0)
    return worlds * flown_steps(env, np.tile(ACTION, (worlds, 1)))


def single_steps() -> float:
    env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    return flown_steps(env, ACTION)


def reset_seconds() -> float:
    """Task change: from reset to the first frame."""
    env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", disable_env_checker=True).unwrapped
    seconds = [median_seconds(lambda seed=seed: env.reset(seed=seed), 1) for seed in range(60)]
    env.close()
    return statistics.median(seconds)


def main() -> None:
    print(f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores, {renderer_name()}")
    one = single_steps()
    print(f"one world               {one:8.0f} control steps/s   {one / REFERENCE_STEPS_S:6.1f} x gym-pybullet-drones")
    for worlds in (4, 16):
        many = vector_steps(worlds)
        ratios = f"{many / REFERENCE_STEPS_S:6.1f} x, {many / one:.1f} x one world"
        print(f"vector of {worlds:2d} worlds     {many:8.0f} control steps/s   {ratios}")
    print(f"task change             {reset_seconds() * 1e3:8.1f} ms from reset to first frame (median of 60 tasks)")


if __name__ == "__main__":
    main()
