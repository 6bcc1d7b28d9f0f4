"""Checks SDF files with libsdformat, Gazebo's own parser.

It uses the library itself, in a separate process; Debian and Ubuntu package it without Gazebo (`apt-get install
libsdformat12-12` on Debian 12). Otherwise it uses `gz sdf --check` or `ign sdf --check`.
"""

from __future__ import annotations

import ctypes.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cognitivedrone.errors import GazeboError
from cognitivedrone.files.temporary import TemporaryFolder

COMMANDS = ("gz", "ign")
LIBRARIES = tuple(f"sdformat{major}" for major in range(16, 11, -1))
"""Library versions, from Jetty's to Debian 12's. Each exports `cmdCheck`, which the command line calls."""
PACKAGE = "libsdformat12-12"
_CALL = "import ctypes, sys; sys.exit(ctypes.CDLL(sys.argv[1]).cmdCheck(sys.argv[2].encode()) != 0)"
_UNKNOWN = "not defined in SDF"
_LIMIT_S = 60.0


@dataclass(frozen=True, slots=True)
class Checker:
    """A way to run libsdformat."""

    name: str
    command: tuple[str, ...]
    """Command line, without the file, which is the last argument."""


def find_checker() -> Checker | None:
    """The first checker available on this machine; none if there is none."""
    for library in LIBRARIES:
        found = ctypes.util.find_library(library)
        if found is not None:
            return Checker(found, (sys.executable, "-I", "-S", "-c", _CALL, found))
    for name in COMMANDS:
        found = shutil.which(name)
        if found is not None and _ran((found, "sdf", "--versions"), Path(os.devnull)).returncode == 0:
            return Checker(f"{name} sdf", (found, "sdf", "--check"))
    return None


def check(files: Sequence[Path]) -> str:
    """Check every file; returns the name of the checker.

    Raises `GazeboError` with the problem of the first file that does not pass, or if there is no checker.
    """
    checker = find_checker()
    if checker is None:
        raise GazeboError(f"libsdformat is not on this machine; install Gazebo, or: apt-get install {PACKAGE}")
    for file in files:
        if not file.is_file():
            raise GazeboError(f"there is no SDF file {file}; make one with: cognitivedrone gazebo export")
        problem = _problem(checker, file)
        if problem:
            raise GazeboError(f"{file} does not pass {checker.name}: {problem}")
    return checker.name


def _problem(checker: Checker, file: Path) -> str:
    """The parser's complaint about a file; empty if it passes.

    The parser skips unknown elements and mentions them only in the log that it writes into the home folder; here they
    are errors, too.
    """
    with TemporaryFolder("home") as home:
        done = _ran((*checker.command, str(file)), home)
        logs = [path.read_text(encoding="utf-8", errors="replace") for path in home.rglob("*.log")]
    output = done.stderr.strip()
    if done.returncode and not output:
        output = done.stdout.strip() or f"exit code {done.returncode}"
    unknown = [line for log in logs for line in log.splitlines() if _UNKNOWN in line]
    return " ".join((output or "\n".join(dict.fromkeys(unknown))).split())


def _ran(command: Sequence[str], home: Path) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(  # noqa: S603 - a fixed command, with the file as a single argument
            command,
            check=False,
            capture_output=True,
            text=True,
            timeout=_LIMIT_S,
            env={**os.environ, "HOME": str(home)},
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise GazeboError(f"cannot run {command[0]}: {error}; is libsdformat installed completely?") from None
