"""Speed of the environments: control steps with full dynamics and 256x256 frames, and the time of a task change.

Run: python benchmarks/environment.py [--out results/environment.json]

Prints medians over repetitions, and their ratio to gym-pybullet-drones (github.com/learnsyslab/gym-pybullet-drones).
The file is written after every repetition.
Where that can be imported it flies in the same repetitions, turn by turn; else the ratio is to a figure that was
measured before, named with its date. It flies as is fastest for it: one drone, rotor speeds instead of
velocities, and a frame of the same size at every control step.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.tasks import Suite, train_task
from cognitivedrone.tasks.families.clutter import cluttered
from cognitivedrone.tasks.format import task_to_json
from cognitivedrone.tasks.suites import digest_of
from cognitivedrone.types import IMAGE_SIZE, Track

WHAT = "Control steps of the environments, with full dynamics and 256x256 frames"
PEER = "gym-pybullet-drones"
PEER_STEPS_S = 44.0
PEER_MEASURED = "2026-11-22, 2 cores of an AMD EPYC"
"""When and where `PEER_STEPS_S` was measured."""
UNIT = "control steps/s"
ID = "cognitivedrone.envs:CognitiveDrone-v1"
REPETITIONS = 7
STEPS = 30
RESETS = 60
ACTION = np.array([0.4, 0.0, 0.0, 0.1], np.float32)


def single() -> Callable[[], object]:
    env = gymnasium.make(ID, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    return lambda: env.step(ACTION)


def vector(worlds: int, **options: Any) -> Callable[[], object]:
    env = gymnasium.make_vec(ID, num_envs=worlds, copy=False, **options)
    env.reset(seed=0)
    actions = np.tile(ACTION, (worlds, 1))
    return lambda: env.step(actions)


def crowded(count: int) -> Suite:
    """Tasks with six frames, of which three are gates, and ten other obstacles."""
    tracks: list[Track] = []
    for index in itertools.count():
        task = cluttered(np.random.default_rng(index), train_task(index, 0), "frame", 13)
        if sum(each.kind == "frame" for each in task.obstacles) == 3:
            tracks.append((task,))
        if len(tracks) == count:
            return Suite("crowded", digest_of([[task_to_json(task)] for (task,) in tracks]), tracks)
    raise AssertionError


def peer() -> Callable[[], object]:
    """One drone of gym-pybullet-drones: 24 control steps a second of its time, each of 10 ticks and with a frame."""
    from gym_pybullet_drones.envs import HoverAviary
    from gym_pybullet_drones.utils.enums import ActionType, ObservationType

    env = HoverAviary(pyb_freq=240, ctrl_freq=24, obs=ObservationType.RGB, act=ActionType.RPM)
    # It draws 64x48, whatever it is asked for.
    env.IMG_RES = np.array([IMAGE_SIZE, IMAGE_SIZE])
    env.rgb = np.zeros((1, IMAGE_SIZE, IMAGE_SIZE, 4))
    env.dep, env.seg = np.ones(env.rgb.shape[:3]), np.zeros(env.rgb.shape[:3])
    env.reset(seed=0)
    hover = np.zeros((1, 4), np.float32)
    drawn = env.step(hover)[0]
    if drawn.shape != env.rgb.shape or not np.ptp(drawn[..., :3]):
        raise RuntimeError(f"{PEER} drew no frame of {IMAGE_SIZE}x{IMAGE_SIZE}: {drawn.shape}")
    return lambda: env.step(hover)


def timed(step: Callable[[], object]) -> float:
    begin = time.perf_counter()
    for _ in range(STEPS):
        step()
    return time.perf_counter() - begin


def steps_per_second(contenders: dict[str, Callable[[], object]]) -> Iterator[dict[str, float]]:
    """Median control steps a second of each so far, after every repetition.

    They take turns, so that a busy machine is busy for all of them.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for repetition in range(REPETITIONS + 1):
        for name, step in contenders.items():
            took = timed(step)
            if repetition:  # the first warms up
                seconds[name].append(took)
        if repetition:
            yield {name: STEPS / statistics.median(took) for name, took in seconds.items()}


def rows_of(worlds: dict[str, int], calls: dict[str, float]) -> list[dict[str, Any]]:
    """The rows of the file, the peer's last: from numbers of worlds, and calls a second."""
    today = datetime.now(UTC).date().isoformat()
    rate, when = calls.get(PEER, PEER_STEPS_S), today if PEER in calls else PEER_MEASURED.partition(",")[0]
    rows: list[dict[str, Any]] = []
    for name, count in worlds.items():
        steps = count * calls[name]
        rows.append({"what": name, "unit": UNIT, "steps_per_s": steps, "ratio": steps / rate, "date": today})
    return [*rows, {"what": f"{PEER}, one drone", "unit": UNIT, "steps_per_s": rate, "ratio": 1, "date": when}]


def reset_seconds() -> float:
    """Task change: from reset to the first frame."""
    env = gymnasium.make(ID, disable_env_checker=True).unwrapped
    times = []
    for seed in range(RESETS):
        begin = time.perf_counter()
        env.reset(seed=seed)
        times.append(time.perf_counter() - begin)
    env.close()
    return statistics.median(times)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args(arguments)
    out = options.out
    cores = len(os.sched_getaffinity(0))
    print(f"{platform.machine()}, {cores} cores, {renderer_name()}, {os.getloadavg()[0]:.1f} processes running already")
    contenders = {"one world": single(), "vector of 4": vector(4), "vector of 16": vector(16)}
    contenders["vector of 16, obstacles"] = vector(16, suite="open-v3:clutter")
    contenders["vector of 16, six frames, ten obstacles"] = vector(16, suite=crowded(16))
    worlds = dict(zip(contenders, (1, 4, 16, 16, 16), strict=True))
    together = importlib.util.find_spec("gym_pybullet_drones") is not None
    if together:
        contenders[PEER] = peer()
    rows: list[dict[str, Any]] = []
    for calls in steps_per_second(contenders):
        rows = rows_of(worlds, calls)
        keep(out, WHAT, rows, seed=0)
    rate, single_world = rows[-1]["steps_per_s"], rows[0]["steps_per_s"]
    for row in rows[:-1]:
        ratios = f"{row['ratio']:6.1f} x {PEER}   {row['steps_per_s'] / single_world:5.1f} x one world"
        print(f"{row['what']:40} {row['steps_per_s']:8.0f} {UNIT}   {ratios}")
    source = "flown here, turn by turn" if together else f"not installed here; measured {PEER_MEASURED}"
    print(f"{PEER:40} {rate:8.0f} {UNIT}   {source}")
    change_ms = 1e3 * reset_seconds()
    print(f"{'task change':40} {change_ms:8.1f} ms from reset to first frame (median of {RESETS} tasks)")
    rows.append({"what": "task change", "ms": change_ms})
    keep(out, WHAT, rows, seed=0)


if __name__ == "__main__":
    main()
