"""Control steps a second of environments for learning to fly, which draw nothing: ours and two peers, turn by turn.

Run: SCIPY_ARRAY_API=1 python benchmarks/state_speed.py [--out results/state_speed.json]

A control step is 0.1 s of flight for all: 40 ticks of ours, with the autopilot's loops, gates and collisions; 50 of
crazyflow (github.com/learnsyslab/crazyflow), its fitted model `so_rpy` under attitudes; 24 of gym-pybullet-drones
(github.com/learnsyslab/gym-pybullet-drones) under rotor speeds, which has one world. A peer that is not installed is
left out; crazyflow needs that variable. The file is written after every repetition.
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path

import gymnasium
import numpy as np
from environment import ID, UNIT, steps_per_second

from cognitivedrone.benchmark.measurements import OUT_HELP, keep

WHAT = "Control steps of environments that give a state and draw nothing"
WORLDS = 64
HZ = 10
THRUST_N = 0.35
"""About what holds crazyflow's drone."""
Step = Callable[[], object]


def ours(worlds: int) -> Step:
    env = gymnasium.make_vec(ID, num_envs=worlds, copy=False, observe="state", reward="progress")
    env.reset(seed=0)
    actions = np.tile(np.array([0.4, 0.0, 0.0, 0.1], np.float32), (worlds, 1))
    return lambda: env.step(actions)


def crazyflow(worlds: int) -> Step:
    env = gymnasium.make_vec("crazyflow.envs:DroneReachPos-v0", num_envs=worlds, freq=HZ, device="cpu")
    env.reset(seed=0)
    actions = np.tile(np.array([0.0, 0.0, 0.0, THRUST_N], np.float32), (worlds, 1))
    return lambda: np.asarray(env.step(actions)[0]["pos"])  # JAX has computed it then


def pybullet(_: int) -> Step:
    from gym_pybullet_drones.envs import HoverAviary
    from gym_pybullet_drones.utils.enums import ActionType, ObservationType

    env = HoverAviary(pyb_freq=240, ctrl_freq=HZ, obs=ObservationType.KIN, act=ActionType.RPM)
    env.reset(seed=0)
    actions = np.zeros((1, 4), np.float32)
    return lambda: env.step(actions)


CONTENDERS = (
    ("ours", "cognitivedrone", ours, 1),
    ("ours", "cognitivedrone", ours, WORLDS),
    ("crazyflow", "crazyflow", crazyflow, 1),
    ("crazyflow", "crazyflow", crazyflow, WORLDS),
    ("gym-pybullet-drones", "gym_pybullet_drones", pybullet, 1),
)
"""Name, module, what makes it, and number of worlds."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    out = parser.parse_args(arguments).out
    here = [each for each in CONTENDERS if importlib.util.find_spec(each[1])]
    steps = {f"{name}, {worlds}": make(worlds) for name, _, make, worlds in here}
    rows = []
    for calls in steps_per_second(steps):
        first = calls[next(iter(steps))]
        rows = [
            {"what": name, "worlds": worlds, "unit": UNIT, "steps_per_s": rate, "ratio": rate / first}
            for name, _, _, worlds in here
            for rate in [worlds * calls[f"{name}, {worlds}"]]
        ]
        keep(out, WHAT, rows, seed=0)
    for row in rows:
        print("{what:20} {worlds:4} worlds {steps_per_s:9.0f} {unit}   {ratio:6.2f} x one world of ours".format(**row))


if __name__ == "__main__":
    main()
