"""Time to import the package, in fresh processes.

Run: python benchmarks/start_up.py
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

RUNS = 11


def seconds(statement: str) -> float:
    times = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-c", statement], check=True)
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def main() -> None:
    bare = seconds("pass")
    print(f"python alone                     {bare * 1e3:6.0f} ms")
    for statement in ("import cognitivedrone", "import cognitivedrone.envs.gym", "import cognitivedrone.cli"):
        took = seconds(statement)
        print(f"{statement:32s} {took * 1e3:6.0f} ms   {took / bare:4.1f} x python alone")


if __name__ == "__main__":
    main()
