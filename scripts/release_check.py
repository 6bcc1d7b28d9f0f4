"""What .ci/run leaves out, before a release and every night. Standard library only.

Usage: python3 scripts/release_check.py [WORD ...]

Runs in the checkout that it is in; `make release-check` gives it a clean clone. With WORDs, only the steps whose name
has one of them, and the environment that they run in. A step that fails stops no other one; the table at the end has
them all. Exits with 1 if any failed.
"""

from __future__ import annotations

import glob
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import test_arm64

ROOT = Path(__file__).resolve().parent.parent
VERSIONS = ["3.11", "3.12", "3.13", "3.14"]


@dataclass(frozen=True)
class Step:
    """A command of the check; `missing` says why it cannot be tried on this machine."""

    name: str
    command: list[str]
    missing: str = ""


def interpreter(version: str) -> str | None:
    """A Python of that version that starts: on the path, or in pyenv, whose shims of other versions do not."""
    root = os.environ.get("PYENV_ROOT") or str(Path.home() / ".pyenv")
    for found in [f"python{version}", *sorted(glob.glob(f"{root}/versions/{version}.*/bin/python"))]:  # noqa: PTH207
        program = shutil.which(found)
        if program and subprocess.run([program, "-c", ""], check=False, capture_output=True).returncode == 0:
            return program
    return None


def image() -> Step:
    docker = shutil.which("docker")
    reachable = docker and subprocess.run([docker, "info"], check=False, capture_output=True).returncode == 0
    bench = "docker run --rm cognitivedrone-check bench --suite open-v1:smoke"
    command = f"docker build --tag cognitivedrone-check . && {bench}"
    return Step("image", ["sh", "-c", command], "" if reachable else "no Docker engine runs here")


def arm64() -> Step:
    return Step("ARM64 in emulation", [sys.executable, "scripts/test_arm64.py"], test_arm64.missing())


def steps() -> list[Step]:
    """The steps, what is most likely to fail first."""
    own = f"{sys.version_info.major}.{sys.version_info.minor}"
    found = {version: interpreter(version) for version in VERSIONS if version != own}
    others = [
        Step(
            f"wheel out of the source archive, Python {version}",
            ["make", "test-sdist", f"PYTHON={program}"],
            "" if program else "this Python is not on this machine",
        )
        for version, program in found.items()
    ]
    return [
        Step("environment from the lock file", [sys.executable, "scripts/setup.py", "dev"]),
        Step("slow tests", ["make", "test-slow"]),
        Step("reproduction in small", ["make", "test-smoke"]),
        *others,
        Step("lowest versions", ["make", "test-lowest"]),
        Step("newest versions", ["make", "test-newest"]),
        image(),
        arm64(),
    ]


def chosen(words: list[str]) -> list[Step]:
    """The environment, and the steps whose name has one of the words; all without words. Exits if no name has one."""
    every = steps()
    for word in words:
        if not any(word.lower() in step.name.lower() for step in every):
            names = "".join(f"\n  {step.name}" for step in every)
            sys.exit(f"no step has '{word}' in its name; the steps are:{names}")
    return [
        step
        for number, step in enumerate(every)
        if not words or number == 0 or any(word.lower() in step.name.lower() for word in words)
    ]


def run(step: Step) -> tuple[str, float]:
    """What came of it, and the seconds it took."""
    if step.missing:
        return f"not tried: {step.missing}", 0.0
    print(f"\n=== {step.name}: {' '.join(step.command)}", flush=True)
    began = time.monotonic()
    environment = os.environ | {"TORCH": "1"}
    status = subprocess.run(step.command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, check=False).returncode
    return "passed" if status == 0 else f"FAILED ({status})", time.monotonic() - began


def main() -> int:
    done = [(step.name, *run(step)) for step in chosen(sys.argv[1:])]
    print()
    for name, result, seconds in done:
        print(f"{name:45} {seconds:6.0f} s  {result}")
    print(f"{'in all':45} {sum(seconds for *_, seconds in done):6.0f} s")
    return int(any(result.startswith("FAILED") for _, result, _ in done))


if __name__ == "__main__":
    sys.exit(main())
