"""Speed, memory and size of a small model on one core: decisions of the policy, and the reasoner's answers beside it.

Run: python benchmarks/inference.py [model.onnx] [--out results/inference.json]

Prints the time to load it, its size, and the memory of this process with it (proportional set size: Python and its
libraries, and the policy); and of flights of `open-v1:test` that it flies, median and 99th percentile of the time of a
decision at every frame and of the packaged reasoner's answer at every fifth, which the policy has seen just before.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from contextlib import suppress
from pathlib import Path

import gymnasium
import numpy as np

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.errors import ReasonerError
from cognitivedrone.policies.small import Small
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, REASONER_HZ, EpisodeContext, Observation

FLIGHTS = 12
TEXT = "Fly through the gate with the number equal to 3 * 3"


def memory_mb() -> float:
    """Proportional set size of this process."""
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1024 / 1e6


def noise() -> Observation:
    """A frame without gates, that loads what is loaded late."""
    frame = np.random.default_rng(0).integers(0, 256, (IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
    return Observation(frame, TEXT, np.zeros(3, np.float32), 0.8, 0.0, 0.0)


def timed(policy: Small, reasoner: SmallReasoner) -> tuple[list[float], list[float]]:
    """Seconds of decisions and of answers in flight; the policy flies by the raw instruction."""
    decisions, answers = [], []
    env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v1:test")
    for flight in range(FLIGHTS):
        seen, _ = env.reset(seed=flight)
        policy.reset(EpisodeContext(seen["instruction"]))
        reasoner.reset(EpisodeContext(seen["instruction"]))
        ended, step = False, 0
        while not ended:
            height, yaw_rate = float(seen["height"][0]), float(seen["yaw_rate"][0])
            observation = Observation(
                seen["image"], seen["instruction"], seen["velocity"], height, yaw_rate, time=step / CONTROL_HZ
            )
            begin = time.perf_counter()
            chunk = policy.act(observation)
            decisions.append(time.perf_counter() - begin)
            if step % round(CONTROL_HZ / REASONER_HZ) == 0:
                begin = time.perf_counter()
                with suppress(ReasonerError):
                    reasoner.refine(observation.image, observation.instruction)
                answers.append(time.perf_counter() - begin)
            seen, _, terminated, truncated, _ = env.step(np.asarray(chunk)[0])
            ended, step = terminated or truncated, step + 1
    env.close()
    return decisions, answers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("model", nargs="?")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    core = min(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    files = Small.file_of(options.model)
    before = memory_mb()
    begin = time.perf_counter()
    policy = Small(files[0])
    loading = time.perf_counter() - begin
    policy.reset(EpisodeContext(TEXT))
    policy.act(noise())
    memory = memory_mb()
    decisions, answers = timed(policy, SmallReasoner())
    print(f"{policy.model.description.name} ({files[0]}), {platform.machine()}, one core")
    print(f"loading        {loading * 1e3:7.1f} ms")
    row: dict[str, float] = {}
    for what, times in (("", decisions), ("answer_", answers)):
        median, slow = np.percentile(times, [50, 99]) * 1e3  # obstacles are looked for in every other frame
        mean = float(np.mean(times)) * 1e3
        row |= {f"{what}median_ms": median, f"{what}mean_ms": mean, f"{what}p99_ms": slow}
        print(f"{what or 'decision':10} {median:6.2f} ms median, {mean:.2f} mean, {slow:.2f} p99 of {len(times)}")
    print(f"memory         {memory:7.1f} MB, of which {before:.1f} MB before the model was loaded")
    size_mb = sum(file.stat().st_size for file in files) / 1e6
    print(f"files          {size_mb:7.2f} MB")
    row |= {"loading_s": loading, "memory_mb": memory, "file_mb": size_mb}
    keep(options.out, "Decisions of the small VLA on one core", [row], seed=0)


if __name__ == "__main__":
    main()
