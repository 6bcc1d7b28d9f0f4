"""Frames a second by number of OpenGL contexts: 16 worlds, 256x256. A card draws for one of them at a time.

Run: python benchmarks/rendering_contexts.py [--out results/rendering_contexts.json]

Prints medians over rounds, and their ratio to one context; then as many contexts as the cameras choose by themselves.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np
from rendering import WORLDS, frame_rate

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.sim.drawing.renderers import contexts_for, why
from cognitivedrone.world.appearance import PLAIN
from cognitivedrone.world.assets import MAX_SLOTS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--most", type=int, default=WORLDS, help="contexts")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    renderer, rng = renderer_name(), np.random.default_rng(0)
    chosen = contexts_for(renderer, WORLDS, min(WORLDS, len(os.sched_getaffinity(0))), MAX_SLOTS)
    print(f"{renderer} ({why(renderer)}); 256x256 RGB, {WORLDS} worlds, medians of {options.rounds} rounds")
    rows: list[dict[str, Any]] = []
    for number in (n for n in (1, 2, 4, 8, 16) if n <= options.most):
        rate = frame_rate([PLAIN] * WORLDS, number, options.rounds, rng, contexts=number)
        rows.append({"contexts": number, "frames_per_s": rate, "renderer": renderer})
        mark = ", chosen" if number == chosen else ""
        print(f"{number:2} contexts {rate:7.0f} frames/s, {rate / rows[0]['frames_per_s']:.2f} x one{mark}", flush=True)
        keep(options.out, "Frames a second by number of OpenGL contexts: 16 worlds, 256x256", rows, seed=0)


if __name__ == "__main__":
    main()
