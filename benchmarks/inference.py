"""Speed, memory and size of a small model: whole decisions of the policy, on one core.

Run: python benchmarks/inference.py [model.onnx] [--out results/inference.json]

Prints the time to load it, median and 99th percentile of the time of a decision, their ratio to the 100 ms between two
commands, the memory (proportional set size) of this process, which holds nothing but the policy, and the file's size.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.policies.small import Small
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, EpisodeContext, Observation

DECISIONS = 500
WARM_UP = 20
TEXT = "Fly through the gate with the number equal to 3 * 3"


def memory_mb() -> float:
    """Proportional set size of this process."""
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1024 / 1e6


def observations(count: int) -> list[Observation]:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (count, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
    return [Observation(frame, TEXT, np.zeros(3, np.float32), 0.8, 0.0, 0.0) for frame in frames]


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
    seen = observations(8)
    times = []
    for step in range(WARM_UP + DECISIONS):
        observation = replace(seen[step % len(seen)], time=step / CONTROL_HZ)
        begin = time.perf_counter()
        policy.act(observation)
        times.append(time.perf_counter() - begin)
    median, slow = np.percentile(times[WARM_UP:], [50, 99]) * 1e3  # obstacles are looked for in every other frame
    mean = np.mean(times[WARM_UP:]) * 1e3
    period = 1e3 / CONTROL_HZ
    print(f"{policy.model.description.name} ({files[0]}), {platform.machine()}, one core")
    print(f"loading        {loading * 1e3:7.1f} ms")
    print(f"decision       {median:7.2f} ms median   {period / median:6.1f} x faster than the {period:.0f} ms it has")
    print(f"               {slow:7.2f} ms p99      {period / slow:6.1f} x")
    print(f"               {mean:7.2f} ms mean     {period / mean:6.1f} x")
    memory = memory_mb()
    print(f"memory         {memory:7.1f} MB, of which {before:.1f} MB before the model was loaded")
    size_mb = sum(file.stat().st_size for file in files) / 1e6
    print(f"files          {size_mb:7.2f} MB")
    times_ms = {"median_ms": float(median), "mean_ms": float(mean), "p99_ms": float(slow)}
    row = {**times_ms, "loading_s": loading, "memory_mb": memory, "file_mb": size_mb}
    keep(options.out, "Decisions of the small VLA on one core", [row], seed=0)


if __name__ == "__main__":
    main()
