"""Frames a second by number of OpenGL contexts: 16 worlds, 256x256. A card draws for one of them at a time.

Run: python benchmarks/rendering_contexts.py [--processes 1 2 4 8] [--out results/rendering_contexts.json]

Prints medians over rounds, and their ratio to one context; then as many contexts as the cameras choose by themselves.
With --processes, frames a second of so many processes together, each with one context, as workers of `bench` draw.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from threading import BrokenBarrierError
from typing import Any

import numpy as np
from rendering import WORLDS, frame_rate

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.errors import RenderError
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.sim.drawing.renderers import contexts_for, why
from cognitivedrone.system.processes import end_with_parent
from cognitivedrone.world.appearance import PLAIN
from cognitivedrone.world.assets import MAX_SLOTS

WHAT = "Frames a second by number of OpenGL contexts, and of processes: 16 worlds each, 256x256"
PATIENCE_S = 90.0
"""A process waits no longer for the others; a card may take a minute to fail."""


def together(processes: int, rounds: int) -> list[float]:
    """Frames a second of each of several processes that draw at the same time; 0 for one that cannot."""
    spawn = multiprocessing.get_context("spawn")
    gate, rates = spawn.Barrier(processes), spawn.SimpleQueue()
    made = [spawn.Process(target=draw, args=(gate, rates, rounds)) for _ in range(processes)]
    for process in made:
        process.start()
    for process in made:
        process.join()
    found = []
    while not rates.empty():
        found.append(rates.get())
    return found + [0.0] * (processes - len(found))


def draw(gate: Any, rates: Any, rounds: int) -> None:
    """Draw in a process of its own, as soon as all are ready or one of them has failed."""
    end_with_parent()

    def ready() -> None:
        with suppress(BrokenBarrierError):
            gate.wait(PATIENCE_S)

    try:
        rates.put(frame_rate([PLAIN] * WORLDS, 1, rounds, np.random.default_rng(0), contexts=1, ready=ready))
    except RenderError as error:
        print(error, flush=True)
        gate.abort()


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--most", type=int, default=WORLDS, help="contexts")
    parser.add_argument("--processes", type=int, nargs="+", default=[], help="numbers of processes")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args(arguments)
    renderer, rng = renderer_name(), np.random.default_rng(0)
    chosen = contexts_for(renderer, WORLDS, min(WORLDS, len(os.sched_getaffinity(0))), MAX_SLOTS)
    print(f"{renderer} ({why(renderer)}); 256x256 RGB, {WORLDS} worlds, medians of {options.rounds} rounds")
    rows: list[dict[str, Any]] = []
    for number in (n for n in (1, 2, 4, 8, 16) if n <= options.most):
        rate = frame_rate([PLAIN] * WORLDS, number, options.rounds, rng, contexts=number)
        rows.append({"contexts": number, "frames_per_s": rate, "renderer": renderer})
        mark = ", chosen" if number == chosen else ""
        print(f"{number:2} contexts {rate:7.0f} frames/s, {rate / rows[0]['frames_per_s']:.2f} x one{mark}", flush=True)
        keep(options.out, WHAT, rows, seed=0)
    for number in options.processes:
        drawn = together(number, options.rounds)
        lost = drawn.count(0.0)
        rows.append({"processes": number, "frames_per_s": sum(drawn), "lost": lost, "renderer": renderer})
        mark = f", {lost} of them drew nothing" if lost else ""
        print(f"{number:2} processes {sum(drawn):6.0f} frames/s{mark}", flush=True)
        keep(options.out, WHAT, rows, seed=0)


if __name__ == "__main__":
    main()
