"""A policy server in a process of its own, for benchmarks."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def server_process(*options: str) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """Run `cognitivedrone serve` with these options; yields its port. Its log goes to the file SERVER_LOG, if set."""
    command = [sys.executable, "-m", "cognitivedrone", "serve", "--port", "0", *options]
    with Path(os.environ.get("SERVER_LOG", os.devnull)).open("w") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            first = process.stdout.readline() if process.stdout else ""
            yield int(first.split(" (")[0].rpartition(":")[2]), process
        finally:
            process.terminate()
            process.wait(60)
            if process.stdout:
                process.stdout.close()


def memory_mb(pid: int) -> float:
    """Resident memory of a process."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) * 1024 / 1e6


def cpu_s(pid: int) -> float:
    """Processor time that a process has used, in user and system mode."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
