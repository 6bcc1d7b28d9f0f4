"""Flights as another harness tells them beside those of `cognitivedrone bench`, and the commands of both."""

from __future__ import annotations

import os
import platform
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cognitivedrone.benchmark.scores.results import read_results

ROOT = Path(__file__).resolve().parents[1]
SUITE = "open-v1:smoke"
SERVE = ("cognitivedrone", "serve", "--port", "{port}")
START_S = 300
"""A server that does not listen after so many seconds has failed."""
_PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
ENVIRONMENT = {**os.environ, "PATH": _PATH, "HF_HUB_OFFLINE": "1", "WANDB_MODE": "disabled"}
"""The programs of this Python's environment come first, and nothing is downloaded."""


@dataclass(frozen=True)
class Flight:
    """What both sides tell of an episode."""

    episode: int
    stages: tuple[tuple[str, float, float], ...]
    """Of every stage: outcome, time in s, path length in m."""

    @property
    def passed(self) -> bool:
        """Whether all stages are passed; not without any, which is an episode that the harness gave up."""
        return bool(self.stages) and all(outcome == "passed" for outcome, _, _ in self.stages)


def flight(episode: int, stages: Iterable[Mapping[str, Any]]) -> Flight:
    """A flight from the results of its stages, as plain values."""
    return Flight(episode, tuple((stage["outcome"], stage["time_s"], stage["path_m"]) for stage in stages))


def compared(theirs: Iterable[Flight], ours: Iterable[Flight]) -> dict[str, Any]:
    """How many flights there are, how many are equal to the last bit, and how many of theirs passed.

    One that only one side has is not equal.
    """
    there, here = ({each.episode: each for each in flights} for flights in (theirs, ours))
    return {
        "flights": len(there | here),
        "equal": sum(there.get(episode) == one for episode, one in here.items()),
        "passed": sum(each.passed for each in there.values()),
    }


def ends(flights: Iterable[Flight]) -> str:
    """How the stages ended that were not passed, such as "missed 2, collision 1"."""
    tally = Counter(outcome for each in flights for outcome, _, _ in each.stages if outcome != "passed")
    return ", ".join(f"{outcome.replace('_', ' ')} {count}" for outcome, count in tally.most_common())


def bench(folder: Path, *options: str) -> list[Flight]:
    """The flights of `cognitivedrone bench` with these options; its results go to `folder`."""
    run("cognitivedrone", "bench", "--suite", SUITE, "--clips", "0", "--out", str(folder), *options)
    return [flight(each.episode, map(asdict, each.stages)) for each in read_results(folder).episodes]


def run(*command: str) -> str:
    """What a command prints; ends this program if it fails."""
    print("$", *command, flush=True)
    done = subprocess.run(
        command, cwd=ROOT, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"{done.stdout[-4000:]}\n{command[0]} failed with status {done.returncode}; see above")
    return done.stdout


@contextmanager
def listening(log: Path, *command: str) -> Iterator[str]:
    """Run a server, with `{port}` in its command replaced by a free one; yields HOST:PORT once it listens there."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    given = [word.replace("{port}", str(port)) for word in command]
    print("$", *given, "&", flush=True)
    with log.open("w") as file:
        process = subprocess.Popen(given, cwd=ROOT, env=ENVIRONMENT, stdout=file, stderr=subprocess.STDOUT)
        try:
            _wait_for(process, port, log)
            yield f"127.0.0.1:{port}"
        finally:
            process.terminate()
            process.wait(60)


def _wait_for(process: subprocess.Popen[bytes], port: int, log: Path) -> None:
    end = time.monotonic() + START_S
    while time.monotonic() < end and process.poll() is None:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.2)
    sys.exit(f"{log.read_text()[-4000:]}\nthe server does not listen; see above")


def versions_of(*packages: str) -> str:
    """These packages with their versions, and Python's."""
    return ", ".join([*(f"{name} {version(name)}" for name in packages), f"Python {platform.python_version()}"])
