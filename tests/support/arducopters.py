"""Binaries for tests that fly an ArduCopter: one that is played, and the real one where it is at hand."""

import os
import random
import socket
import sys
from pathlib import Path

import pytest

REAL = os.environ.get("ARDUCOPTER", "")
needs_arducopter = pytest.mark.skipif(not REAL, reason="set ARDUCOPTER to an ArduCopter binary that is built for SITL")


def played_arducopter(folder: Path) -> Path:
    """A program that is started, asks for physics and answers MAVLink as ArduCopter does."""
    return script(
        folder / "arducopter", f'exec "{sys.executable}" "{Path(__file__).parent / "fake_arducopter.py"}" "$@"'
    )


def free_instance() -> int:
    """An instance number whose ports nobody uses; drawn, so that tests beside this one take others."""
    numbers = list(range(40, 256))
    random.shuffle(numbers)
    for instance in numbers:
        with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            try:
                tcp.bind(("127.0.0.1", 5760 + 10 * instance))
                udp.bind(("127.0.0.1", 9002 + 10 * instance))
            except OSError:
                continue
            return instance
    raise AssertionError("every port is taken")


def script(path: Path, line: str) -> Path:
    """A shell script of one line."""
    path.write_text(f"#!/bin/sh\n{line}\n")
    path.chmod(0o755)
    return path
