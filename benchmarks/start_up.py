"""Time to import the package and to print help, in fresh processes.

Run: python benchmarks/start_up.py
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

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
    bare = seconds("-c", "pass")
    print(f"python alone                     {bare * 1e3:6.0f} ms")
    statements = ("import cognitivedrone", "import cognitivedrone.envs.gym", "import cognitivedrone.cli")
    for statement in statements:
        told(statement, seconds("-c", statement), bare)
    for command in HELP:
        words = [*command.split(), "--help"]
        told(f"cognitivedrone {' '.join(words)}", seconds("-m", "cognitivedrone", *words), bare)


def told(what: str, took: float, bare: float) -> None:
    print(f"{what:32s} {took * 1e3:6.0f} ms   {took / bare:4.1f} x python alone")


if __name__ == "__main__":
    main()
