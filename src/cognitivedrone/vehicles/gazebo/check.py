"""Whether an SDF file is sound: asked of libsdformat, Gazebo's own parser, where there is one.

The library itself, in a process of its own, which Debian and Ubuntu have without Gazebo (`apt-get install
libsdformat12-12` on Debian 12); else `gz sdf --check` or `ign sdf --check`.
"""

from __future__ import annotations

import ctypes.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cognitivedrone.errors import GazeboError

COMMANDS = ("gz", "ign")
LIBRARIES = tuple(f"sdformat{major}" for major in range(16, 11, -1))
"""From Jetty's to Debian 12's. Each exports the `cmdCheck` that the command line calls."""
PACKAGE = "libsdformat12-12"
_CALL = "import ctypes, sys; sys.exit(ctypes.CDLL(sys.argv[1]).cmdCheck(sys.argv[2].encode()) != 0)"
_UNKNOWN = "not defined in SDF"
_LIMIT_S = 60.0


@dataclass(frozen=True, slots=True)
class Checker:
    """A way to ask libsdformat."""

    name: str
    command: tuple[str, ...]
    """The file is its last argument."""


def find_checker() -> Checker | None:
    """The first that there is on this machine; none where there is none."""
    for library in LIBRARIES:
        found = ctypes.util.find_library(library)
        if found is not None:
            return Checker(found, (sys.executable, "-I", "-S", "-c", _CALL, found))
    for name in COMMANDS:
        found = shutil.which(name)
        if found is not None and _ran((found, "sdf", "--versions"), os.devnull).returncode == 0:
            return Checker(f"{name} sdf", (found, "sdf", "--check"))
    return None


def check(files: Sequence[Path]) -> str:
    """Have every file checked; the name of the checker.

    Raises `GazeboError` with what is wrong with the first that does not pass, or where there is no checker.
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
    """What the parser holds against a file; empty where it passes.

    It goes on without elements that it does not know, and tells of them only in the log that it writes into the home
    folder: here they are mistakes, too.
    """
    with tempfile.TemporaryDirectory() as home:
        done = _ran((*checker.command, str(file)), home)
        logs = [path.read_text(encoding="utf-8", errors="replace") for path in Path(home).rglob("*.log")]
    said = done.stderr.strip()
    if done.returncode and not said:
        said = done.stdout.strip() or f"exit code {done.returncode}"
    unknown = [line for log in logs for line in log.splitlines() if _UNKNOWN in line]
    return " ".join((said or "\n".join(dict.fromkeys(unknown))).split())


def _ran(command: Sequence[str], home: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(  # noqa: S603 - the command is one of ours, the file a single argument
            command, check=False, capture_output=True, text=True, timeout=_LIMIT_S, env={**os.environ, "HOME": home}
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise GazeboError(f"cannot run {command[0]}: {error}; is libsdformat whole?") from None
