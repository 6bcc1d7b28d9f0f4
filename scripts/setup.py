"""Make the project's own environment in .venv and install the package into it. Standard library only.

Usage: python3 scripts/setup.py [EXTRA ...]

Works where Debian's python3 comes without `venv`, and looks for an OpenGL library for off-screen rendering and, for
the tests, for libsdformat: where there is none, it installs one as root, or prints the line to type.
"""

from __future__ import annotations

import ctypes.util
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
GL_PACKAGES = ["libegl1", "libgl1-mesa-dri", "libopengl0"]


def run(*command: object) -> bool:
    return subprocess.run([str(part) for part in command], check=False).returncode == 0


def apt_install(packages: list[str], purpose: str) -> bool:
    """Install Debian packages if this user can; otherwise say what to type."""
    line = f"apt-get install -y {' '.join(packages)}"
    if os.geteuid() == 0 and shutil.which("apt-get"):
        print(f"Installing {' '.join(packages)} for {purpose} ...", flush=True)
        env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        quiet = {"stdout": subprocess.DEVNULL, "env": env, "check": False}
        subprocess.run(["apt-get", "update"], **quiet)
        if subprocess.run(line.split(), **quiet).returncode == 0:
            return True
    print(
        f"{purpose[0].upper()}{purpose[1:]} needs system packages. Please type:\n\n    sudo {line}\n", file=sys.stderr
    )
    return False


def make_venv() -> None:
    if PYTHON.exists() and run(PYTHON, "-m", "pip", "--version", "-q"):
        return
    shutil.rmtree(VENV, ignore_errors=True)
    if subprocess.run([sys.executable, "-m", "venv", VENV], check=False, capture_output=True).returncode == 0:
        return
    shutil.rmtree(VENV, ignore_errors=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}-venv"
    if not (apt_install([version], "a Python environment") and run(sys.executable, "-m", "venv", VENV)):
        sys.exit(2)


def stamp_of(extras: list[str]) -> str:
    text = (ROOT / "pyproject.toml").read_text() + ",".join(extras) + sys.version
    return hashlib.sha256(text.encode()).hexdigest()


def install(extras: list[str]) -> None:
    stamp = VENV / ("installed-" + ("-".join(extras) or "base"))
    if stamp.exists() and stamp.read_text() == stamp_of(extras):
        return
    print("Installing cognitivedrone and its dependencies into .venv ...", flush=True)
    target = f"{ROOT}[{','.join(extras)}]" if extras else str(ROOT)
    if not run(PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-e", target):
        sys.exit("The installation failed; the lines above say why.")
    stamp.write_text(stamp_of(extras))


def ensure_opengl() -> None:
    """Try to render; where that fails, install what is missing. The answer is kept until the environment changes."""
    stamp = VENV / "renders"
    if stamp.exists():
        return
    probe = [str(PYTHON), "-c", "from cognitivedrone.sim.gl import backend; backend()"]
    for attempt in range(2):
        if subprocess.run(probe, check=False, capture_output=True).returncode == 0:
            stamp.touch()
            return
        if attempt or not apt_install(GL_PACKAGES, "off-screen rendering"):
            return  # what needs no pictures works all the same; what does says what is missing


def ensure_sdformat() -> None:
    """The parser that checks exported Gazebo worlds in the tests; without it those are skipped."""
    if not any(ctypes.util.find_library(f"sdformat{version}") for version in range(12, 17)):
        apt_install(["libsdformat12-12"], "checking Gazebo worlds")


def main() -> None:
    if sys.version_info < (3, 11):  # noqa: UP036 - the reader's Python may be any
        sys.exit(f"Python 3.11 or newer is needed; this is {sys.version.split()[0]}.")
    make_venv()
    install(sorted(sys.argv[1:]))
    ensure_opengl()
    if "dev" in sys.argv[1:]:
        ensure_sdformat()


if __name__ == "__main__":
    main()
