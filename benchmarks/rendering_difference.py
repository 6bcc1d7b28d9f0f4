"""Whether a graphics card's pictures are those of the processor: pixels, and how flights of a suite end.

Run: python benchmarks/rendering_difference.py [--episodes 30] [--out results/rendering_difference.json]

The same frames are drawn in two processes, with COGNITIVEDRONE_RENDERER=cpu and gpu, and the packaged policy flies the
smoke suite in each. Prints the largest difference of a pixel, how many differ at all, and how many flights end
otherwise. Where one of the two is not there, its own sentence says so.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rendering import WORLDS, pictures, random_stage

from cognitivedrone import evaluate
from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.sim.drawing.renderers import CHOICE, REMEMBERED
from cognitivedrone.world.appearance import PLAIN, varied_appearance
from cognitivedrone.world.geometry import START

WHAT = "A graphics card's pictures beside the processor's: 256x256 pixels of plain and varied rooms, and flights"
PATIENCE_S = 300.0


def drawn(rounds: int) -> np.ndarray:
    """The same frames (n, 256, 256, 3) wherever they are drawn."""
    rng = np.random.default_rng(0)
    frames = []
    with Cameras(WORLDS) as cameras:
        for slot in range(WORLDS):
            look = varied_appearance(rng) if slot % 2 else PLAIN
            cameras.set_stage(slot, random_stage(rng), pictures(rng), appearance=look)
        for _ in range(rounds):
            positions = START + rng.uniform([-1, -1, -0.5], 1, (WORLDS, 3))
            frames.append(cameras.first_person(positions, quaternion_from_yaw(rng.normal(0, 0.2, WORLDS))))
    return np.concatenate(frames)


def child(path: Path, rounds: int, episodes: int) -> None:
    """Draw and fly in this process, and leave what came of it in a file."""
    frames = drawn(rounds)
    ends = []
    if episodes:
        done = evaluate("small", "open-v1:smoke", episodes=episodes, progress=False).results
        ends = [stage.outcome for episode in done.episodes for stage in episode.stages]
    np.savez(path, frames=frames, ends=np.array(ends), renderer=np.array(renderer_name()))


def drawn_by(choice: str, folder: Path, rounds: int, episodes: int) -> dict[str, Any] | str:
    """What a process with this choice of a renderer leaves, or what it says."""
    path = folder / f"{choice}.npz"
    variables = {name: value for name, value in os.environ.items() if name != REMEMBERED} | {CHOICE: choice}
    command = [sys.executable, __file__, "--draw", str(path), "--rounds", str(rounds), "--episodes", str(episodes)]
    made = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    if made.returncode:
        return " ".join((made.stderr.strip() or made.stdout.strip()).rpartition("\n")[2].split())[:200]
    with np.load(path) as found:
        return {name: found[name] for name in found.files}


def difference(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Figures of two processes' frames and flights."""
    pixels = np.abs(one["frames"].astype(np.int16) - other["frames"].astype(np.int16))
    return {
        "renderers": [str(one["renderer"]), str(other["renderer"])],
        "frames": len(pixels),
        "largest": int(pixels.max()),
        "differ": float(pixels.any(axis=-1).mean()),
        "flights": len(one["ends"]),
        "otherwise": int((one["ends"] != other["ends"]).sum()),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=8, help=f"of {WORLDS} frames")
    parser.add_argument("--episodes", type=int, default=30, help="of open-v1:smoke")
    parser.add_argument("--choices", nargs=2, default=("cpu", "gpu"), help="what draws")
    parser.add_argument("--draw", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args(arguments)
    if options.draw is not None:
        try:
            child(options.draw, options.rounds, options.episodes)
        except CognitiveDroneError as error:
            sys.exit(str(error))
        return
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for choice in options.choices:
            made = drawn_by(choice, Path(folder), options.rounds, options.episodes)
            if isinstance(made, str):
                print(f"not measured: {made}")
                return
            found.append(made)
    row = difference(*found)
    print(f"{' and '.join(row['renderers'])}: a pixel differs by {row['largest']} of 255 at most,", end=" ")
    print(f"{row['differ']:.2%} of them do; {row['otherwise']} of {row['flights']} flights end otherwise")
    keep(options.out, WHAT, [row], seed=0)


if __name__ == "__main__":
    main()
