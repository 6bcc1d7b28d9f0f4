"""Speed, memory and size of a small model: whole decisions of the policy, on one core.

Run: python benchmarks/inference.py [model.onnx]

Prints the time to load it, median and 99th percentile of the time of a decision, their ratio to the 100 ms between two
commands, the memory (proportional set size) of this process, which holds nothing but the policy, and the file's size.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from pathlib import Path

import numpy as np

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
    core = min(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    file = Small.file_of(sys.argv[1] if len(sys.argv) > 1 else None)
    before = memory_mb()
    begin = time.perf_counter()
    policy = Small(str(file))
    loading = time.perf_counter() - begin
    policy.reset(EpisodeContext(TEXT))
    seen = observations(8)
    times = []
    for step in range(WARM_UP + DECISIONS):
        begin = time.perf_counter()
        policy.act(seen[step % len(seen)])
        times.append(time.perf_counter() - begin)
    median, slow = np.percentile(times[WARM_UP:], [50, 99]) * 1e3
    period = 1e3 / CONTROL_HZ
    print(f"{policy.model.description.name} ({file}), {platform.machine()}, one core")
    print(f"loading        {loading * 1e3:7.1f} ms")
    print(f"decision       {median:7.2f} ms median   {period / median:6.1f} x faster than the {period:.0f} ms it has")
    print(f"               {slow:7.2f} ms p99      {period / slow:6.1f} x")
    print(f"memory         {memory_mb():7.1f} MB, of which {before:.1f} MB before the model was loaded")
    print(f"file           {file.stat().st_size / 1e6:7.2f} MB")


if __name__ == "__main__":
    main()
