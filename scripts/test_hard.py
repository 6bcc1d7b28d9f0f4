"""Whether the tests depend on anything but the code: on load, order, or what a killed program left behind.

Usage: .venv/bin/python scripts/test_hard.py [--seed N] [--only WORD]... [TESTS ...]

Runs TESTS (by default all) three times in a row, once with two busy processes beside them, once in random order, and
once right after a training and a server were killed with -9. Have nothing else heavy on the machine. A run that fails
stops no other one; the table at the end has them all. Exits with 1 if any failed. `--only busy --only killed` takes the
runs whose name has one of these words.
"""

from __future__ import annotations

import argparse
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUSY = 2
STARTED_S = 300.0
"""For the training and the server to be in the middle of their work, on a machine that is busy."""


@dataclass(frozen=True)
class Run:
    """One run of the tests, and what it is run in."""

    name: str
    options: tuple[str, ...] = ()
    around: Callable[[], AbstractContextManager[None]] = nullcontext


@contextmanager
def busy() -> Iterator[None]:
    """Processes that take all of a core each."""
    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


@contextmanager
def after_a_kill() -> Iterator[None]:
    """A training and a server, killed in the middle of their work; what they leave behind stays there."""
    with tempfile.TemporaryDirectory(prefix="cognitivedrone-killed-") as name:
        out = Path(name) / "training"
        port = free_port()
        program = [sys.executable, "-m", "cognitivedrone"]
        training = [*program, "train", "--recipe", "debug", "--steps", "1000000", "--out", str(out)]
        server = [*program, "serve", "--policy", "small", "--port", str(port)]
        began = [subprocess.Popen(command, stdin=subprocess.DEVNULL) for command in (training, server)]
        try:
            wait_for((out / "metrics.jsonl").is_file, began[0], "the training")
            wait_for(lambda: answers(port), began[1], "the server")
        finally:
            for process in began:
                process.send_signal(signal.SIGKILL)
                process.wait()
        yield


def wait_for(holds: Callable[[], bool], process: subprocess.Popen[bytes], what: str) -> None:
    """Exits where the process ends before it holds."""
    limit = time.monotonic() + STARTED_S
    while not holds():
        if process.poll() is not None or time.monotonic() > limit:
            sys.exit(f"{what} did not come into the middle of its work: exit status {process.returncode}")
        time.sleep(0.2)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1).close()
    except OSError:
        return False
    return True


def runs(seed: int) -> list[Run]:
    return [
        *(Run(f"alone, {time} time") for time in ("first", "second", "third")),
        Run(f"{BUSY} busy processes beside it", around=busy),
        Run(f"in random order, --shuffle {seed}", ("--shuffle", str(seed))),
        Run("after a training and a server were killed", around=after_a_kill),
    ]


def chosen(every: list[Run], words: list[str]) -> list[Run]:
    """The runs whose name has one of the words; all without words. Exits if a word is in no name."""
    for word in words:
        if not any(word in run.name for run in every):
            sys.exit(f"no run has '{word}' in its name; the runs are:\n  " + "\n  ".join(run.name for run in every))
    return [run for run in every if not words or any(word in run.name for word in words)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of the random order; a new one every time")
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="runs that have it in their name")
    parser.add_argument("tests", nargs="*")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # an exception here ends pytest as well
    pytest = [sys.executable, "-m", "pytest", "-n", "3", "--dist", "worksteal", *options.tests]
    done: list[tuple[str, int, float]] = []
    for run in chosen(runs(options.seed), options.only):
        print(f"\n=== {run.name}", flush=True)
        with run.around():
            began = time.monotonic()
            status = subprocess.run([*pytest, *run.options], cwd=ROOT, stdin=subprocess.DEVNULL, check=False).returncode
            done.append((run.name, status, time.monotonic() - began))
    print()
    for name, status, seconds in done:
        print(f"{name:45} {seconds:6.0f} s  {'passed' if status == 0 else f'FAILED ({status})'}")
    return int(any(status for _, status, _ in done))


if __name__ == "__main__":
    sys.exit(main())
