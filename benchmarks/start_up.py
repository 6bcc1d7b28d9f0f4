"""Time to import the package and to print help, in fresh processes.

Run: python benchmarks/start_up.py [--out results/start_up.json]
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from cognitivedrone.benchmark.measurements import OUT_HELP, keep

RUNS = 11


HELP = ("", "bench", "fly", "collect", "train", "list")


def seconds(*arguments: str) -> float:
    times = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    out = parser.parse_args().out
    bare = seconds("-c", "pass")
    print(f"python alone                     {bare * 1e3:6.0f} ms")
    statements = ("import cognitivedrone", "import cognitivedrone.envs.gym", "import cognitivedrone.cli")
    rows = [shown(statement, seconds("-c", statement), bare) for statement in statements]
    for command in HELP:
        words = [*command.split(), "--help"]
        rows.append(shown(f"cognitivedrone {' '.join(words)}", seconds("-m", "cognitivedrone", *words), bare))
    keep(out, "Time to import the package and to print help, in fresh processes", rows)


def shown(what: str, took: float, bare: float) -> dict[str, Any]:
    """A row, printed."""
    print(f"{what:32s} {took * 1e3:6.0f} ms   {took / bare:4.1f} x python alone")
    return {"what": what, "ms": 1e3 * took, "ratio": took / bare}


if __name__ == "__main__":
    main()
