"""Times of whole commands beside former commits: every command by each commit in turn, in one run.

Run: python benchmarks/ratios.py [--commits 29d203f 8ed423d] [--tasks 60] [--rounds 2] [--out results/ratios.json]

Needs the history of the repository. Commits are checked out beside it and run by this interpreter, each by its own
weights; nothing else should run. A ratio is the median time of this commit to that of the former one.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import tyro

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.terminal.progress import counted

ROOT = Path(__file__).parents[1]
STEPS = """
import gymnasium, numpy
env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v1:test")
env.reset(seed=0)
for step in range({steps}):
    if any(env.step(numpy.float32([0.5, 0, 0, 0]))[2:4]):
        env.reset()
"""


@dataclass(frozen=True)
class Config:
    """What is timed."""

    commits: tuple[str, ...] = ("29d203f", "8ed423d")
    """Former commits."""
    tasks: int = 60
    """Of open-v1:test, flown by two workers; as many flights are collected."""
    rounds: int = 2
    out: Annotated[Path | None, tyro.conf.arg(help=OUT_HELP)] = None


def commands(tasks: int) -> dict[str, list[str]]:
    """What is run, by what it is called; `OUT` is a new folder."""
    cli = ["-m", "cognitivedrone"]
    bench = [*cli, *f"bench --suite open-v1:test --episodes {tasks} --workers 2 --clips 0 --out OUT".split()]
    collect = [*cli, *f"collect --episodes {tasks} --episodes-per-shard 10 --workers 2 --out OUT".split()]
    return {
        f"{tasks} tasks by R1": [*bench, "--policy", "small", "--reasoner", "small"],
        f"{tasks} tasks by `small`": [*bench, "--policy", "small"],
        f"{tasks} tasks by `oracle`": [*bench, "--policy", "oracle"],
        f"`collect`, {tasks} flights": collect,
        f"{25 * tasks} steps of one environment": ["-c", STEPS.format(steps=25 * tasks)],
    }


def seconds(checkout: Path, arguments: Sequence[str]) -> float:
    """Wall time of a fresh process that imports the package from a checkout."""
    with tempfile.TemporaryDirectory() as folder:
        words = [f"{folder}/out" if word == "OUT" else word for word in arguments]
        begin = time.perf_counter()
        environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
        subprocess.run([sys.executable, "-P", *words], check=True, capture_output=True, env=environment, cwd=folder)
        return time.perf_counter() - begin


def main(config: Config) -> None:
    """Time, print and keep."""
    timed = commands(config.tasks)
    with tempfile.TemporaryDirectory() as folder:
        checkouts = {"now": ROOT, **{commit: Path(folder) / commit for commit in config.commits}}
        git("worktree", "prune")  # of a run that was killed
        for commit in config.commits:
            git("worktree", "add", "--detach", str(checkouts[commit]), commit)
        try:
            runs = list(product(range(config.rounds), timed, checkouts))
            times: dict[tuple[str, str], list[float]] = {}
            for _, what, commit in counted(runs, "runs", len(runs)):
                times.setdefault((what, commit), []).append(seconds(checkouts[commit], timed[what]))
        finally:
            for commit in config.commits:
                git("worktree", "remove", "--force", str(checkouts[commit]))
    median = {key: statistics.median(taken) for key, taken in times.items()}
    rows: list[dict[str, Any]] = []
    for what, commit in product(timed, config.commits):
        now, then = median[what, "now"], median[what, commit]
        rows.append({"what": what, "beside": commit, "now_s": now, "then_s": then, "ratio": now / then})
        print(f"{what:36} {now:6.1f} s, {commit} {then:6.1f} s: {now / then:.2f}")
    keep(config.out, "Times of whole commands beside former commits", rows, seed=0)


def git(*arguments: str) -> None:
    """In the repository."""
    subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
