"""Seconds from a clone to the score of one's own policy, by the README's commands, on each Python that is named.

The last column is the time of all cores together, which other programs on the machine do not lengthen much.

Usage: python benchmarks/first_score.py python3.11 python3.12 python3.13 [--out results/first_score.json]

pip's cache is used as it is: run it twice, the second time is with a warm cache. What is not committed is not cloned.
"""

from __future__ import annotations

import argparse
import itertools
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from cognitivedrone.benchmark.measurements import OUT_HELP, keep

ROOT = Path(__file__).resolve().parents[1]
BENCH = "cognitivedrone bench --policy own_policy:Straight --suite open-v1:smoke --out results/straight"


def cpu_time() -> float:
    """Of the commands that have ended, seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pythons", nargs="*", default=[sys.executable])
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print(f"{'':<16}{'clone':>8}{'install':>10}{'bench':>8}{'in all':>9}{'CPU':>8}   s; load {os.getloadavg()[0]:.1f}")
    for python in options.pythons:
        with tempfile.TemporaryDirectory() as name:
            checkout = Path(name) / "cognitivedrone"
            environment = {**os.environ, "PYTHONPATH": "examples"}
            marks, before = [time.monotonic()], cpu_time()
            commands: tuple[list[str | Path], ...] = (
                ["git", "clone", "--quiet", ROOT, checkout],
                [python, "scripts/setup.py"],
                [checkout / ".venv" / "bin" / "cognitivedrone", *BENCH.split()[1:]],
            )
            for command in commands:
                cwd = checkout if checkout.exists() else ROOT
                subprocess.run(command, cwd=cwd, env=environment, check=True, stdout=subprocess.DEVNULL)
                marks.append(time.monotonic())
        took = [end - begin for begin, end in itertools.pairwise(marks)]
        cpu = cpu_time() - before
        version = subprocess.run([python, "--version"], capture_output=True, text=True, check=True).stdout.strip()
        print(f"{version:<16}{took[0]:8.1f}{took[1]:10.1f}{took[2]:8.1f}{sum(took):9.1f}{cpu:8.1f}", flush=True)
        seconds = dict(zip(("clone_s", "install_s", "bench_s"), took, strict=True))
        rows.append({"python": version.removeprefix("Python "), **seconds, "total_s": sum(took), "cpu_s": cpu})
    keep(options.out, "Seconds from a clone to the score of one's own policy", rows)


if __name__ == "__main__":
    main()
