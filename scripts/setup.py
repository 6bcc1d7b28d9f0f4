"""Make the project's own environment in .venv and install the package into it. Standard library only.

Usage: python3 scripts/setup.py [EXTRA ...]

Every dependency comes in the version that constraints.txt names, so that a package that is released tonight changes
nothing here tomorrow. An installation that was killed is begun anew.

The same on Linux, macOS and Windows (`python scripts/setup.py`); `scripts/bench.py` flies the smoke suite after it.

Works where Debian's python3 comes without `venv`, and looks for an OpenGL library for off-screen rendering and, for
the tests, for libsdformat. System packages are installed by root alone: asked for at a terminal, said beforehand
elsewhere. Everybody else is shown the line to type.

The extra `dev` brings PyTorch and what is tested with it, unless that means CUDA's gigabytes for a machine without a
GPU; with TORCH=1 in the environment always.
"""

from __future__ import annotations

import ctypes.util
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
WINDOWS = sys.platform == "win32"
PYTHON = VENV / ("Scripts/python.exe" if WINDOWS else "bin/python")
LOCK = "constraints.txt"
GL_PACKAGES = ["libegl1", "libgl1-mesa-dri", "libopengl0"]
SDFORMAT = "libsdformat12-12"
TORCH = "torch==2.13.0"  # as in the extra dev-torch
NEWER = {"darwin": " Get one from python.org or with: brew install python", "win32": " Get one from python.org."}
ON_AN_APPLE = "on an Apple processor, take a Python that is built for arm64, else a machine with Linux"
NO_MUJOCO = {
    ("darwin", "x86_64"): f"Intel Macs; {ON_AN_APPLE}",
    ("win32", "arm64"): "Windows on ARM; take Python's 64-bit version for x86, or WSL2",
}
WITHOUT_TORCH = """\
PyTorch is left out: what pip would install here is the build with CUDA's libraries, about 3 GB to download, and this
machine has no NVIDIA GPU. The tests that need it are skipped. To have it all the same: make test TORCH=1
(with the CPU build, a tenth of that, where pip is given its index: docs/install.md)."""


def run(*command: object) -> bool:
    return subprocess.run([str(part) for part in command], check=False).returncode == 0


def apt_install(packages: list[str], purpose: str, without: str) -> bool:
    """Install Debian packages as root, with consent or after saying so; show anybody else the line to type."""
    line = f"apt-get install -y --no-install-recommends {' '.join(packages)}"
    root = shutil.which("apt-get") is not None and os.geteuid() == 0
    if root and sys.stdin.isatty():
        root = input(f"For {purpose}, system-wide: {line}\nInstall now? [Y/n] ").strip().lower() in ("", "y", "yes")
    if root:
        print(f"Installing system-wide, for {purpose}: {line}", flush=True)
        env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        quiet = {"stdout": subprocess.DEVNULL, "env": env, "check": False}
        subprocess.run(["apt-get", "update"], **quiet)
        if subprocess.run(line.split(), **quiet).returncode == 0:
            return True
    print(
        f"Not installed: system packages for {purpose}. Without them {without}.\n"
        f"On Debian and Ubuntu, type:\n\n    sudo {line}\n",
        file=sys.stderr,
        flush=True,
    )
    return False


def make_venv_with_pip() -> bool:
    return subprocess.run([sys.executable, "-m", "venv", VENV], check=False, capture_output=True).returncode == 0


def begun() -> Path:
    """The mark of an installation that has not ended."""
    return VENV / "installing"


def make_venv() -> None:
    if not begun().exists() and PYTHON.exists() and run(PYTHON, "-c", "import pip"):
        return
    shutil.rmtree(VENV, ignore_errors=True)
    if make_venv_with_pip():
        return
    shutil.rmtree(VENV, ignore_errors=True)
    packages = [f"python{sys.version_info.major}.{sys.version_info.minor}-venv"]
    if ctypes.util.find_library("EGL") is None:  # all that will be needed, in one line
        packages += GL_PACKAGES
    without = "no environment can be made (with uv one can: uv venv --seed .venv)"
    if not (apt_install(packages, "the Python environment and pictures", without) and make_venv_with_pip()):
        sys.exit(2)


def stamp_of(extras: list[str]) -> str:
    text = (ROOT / "pyproject.toml").read_text() + (ROOT / LOCK).read_text() + ",".join(extras) + sys.version
    return hashlib.sha256(text.encode()).hexdigest()


def installed(extras: list[str]) -> bool:
    """Whether they are there, by themselves or as parts of `dev`."""
    whole = [["dev"], ["dev", "dev-torch"]] if set(extras) <= {"docs"} else []
    return any(stamped(each) for each in (extras, *whole))


def stamped(extras: list[str]) -> bool:
    stamp = VENV / ("installed-" + ("-".join(extras) or "base"))
    return stamp.exists() and stamp.read_text() == stamp_of(extras)


def announce(extras: list[str]) -> None:
    """Say what will happen before the first silent step; nothing where all is installed already."""
    if installed(extras) or ("dev" in extras and installed(sorted([*extras, "dev-torch"]))):
        return
    named = f"cognitivedrone[{','.join(extras)}]" if extras else "cognitivedrone"
    more = ", longer if PyTorch comes too" if "dev" in extras else ""
    print(f"Installing {named} and its dependencies into {VENV}: this takes a minute or two{more}.", flush=True)


def install(extras: list[str]) -> None:
    if installed(extras):
        return
    target = f".[{','.join(extras)}]" if extras else "."
    # By variables, which reach what the package itself is built with, too: newer pips want the second for that.
    locked = {**os.environ, "PIP_CONSTRAINT": LOCK, "PIP_BUILD_CONSTRAINT": LOCK}
    options = ["--quiet", "--disable-pip-version-check", "--no-compile"]  # which pip does on one core
    command = [str(PYTHON), "-m", "pip", "install", *options, "-e", target]
    begun().touch()
    done = subprocess.run(command, cwd=ROOT, env=locked, check=False)
    begun().unlink()
    if done.returncode != 0:
        sys.exit("The installation failed; the lines above say why. It can be run again once that is mended.")
    if sys.dont_write_bytecode:  # each of the hundreds of processes of the tests would compile all that it imports
        run(PYTHON, "-m", "compileall", "-qq", "-j", "0", VENV, ROOT / "src")
    (VENV / ("installed-" + ("-".join(extras) or "base"))).write_text(stamp_of(extras))


def brings_cuda() -> bool:
    """Whether the PyTorch that pip would install here depends on CUDA's libraries."""
    ask = [PYTHON, "-m", "pip", "install", "--quiet", "--dry-run", "--no-deps", "--report", "-", TORCH]
    done = subprocess.run(ask, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        return False  # the installation will say what is wrong
    report = json.loads(done.stdout)["install"]
    return any(
        need.startswith(("nvidia-", "cuda-")) for found in report for need in found["metadata"].get("requires_dist", [])
    )


def with_torch(extras: list[str]) -> list[str]:
    """What `dev` means on this machine: with the extra `dev-torch`, or without it, and said."""
    full = sorted([*extras, "dev-torch"])
    if installed(full) or os.environ.get("TORCH") == "1" or shutil.which("nvidia-smi") or not brings_cuda():
        return full
    print(WITHOUT_TORCH, flush=True)
    return extras


def ensure_opengl() -> None:
    """Try to render; where that fails, install what is missing. The answer is kept until the environment changes."""
    stamp = VENV / "renders"
    if stamp.exists():
        return
    probe = [str(PYTHON), "-c", "from cognitivedrone.sim.drawing.gl import backend; backend()"]
    without = "no picture can be rendered, so only policies that look at none can be scored (oracle, hover)"
    for attempt in range(2):
        done = subprocess.run(probe, check=False, capture_output=True)
        if done.returncode == 0:
            stamp.touch()
            return
        if not sys.platform.startswith("linux"):
            said = done.stderr.decode(errors="replace").strip().splitlines()
            print(f"Without it {without}: {said[-1] if said else 'OpenGL does not start'}", file=sys.stderr, flush=True)
            return
        if attempt or not apt_install(GL_PACKAGES, "off-screen rendering", without):
            return  # what needs no pictures works all the same; what does says what is missing


def ensure_sdformat() -> None:
    """The parser that checks exported Gazebo worlds in the tests; without it those are skipped."""
    if any(ctypes.util.find_library(f"sdformat{version}") for version in range(12, 17)) or not shutil.which("apt-get"):
        return
    shown = subprocess.run(["apt-cache", "show", SDFORMAT], check=False, capture_output=True)
    if shown.returncode == 0:  # Debian 12 alone has it
        apt_install([SDFORMAT], "the tests of exported Gazebo worlds", "those tests are skipped")


def main() -> None:
    if sys.version_info < (3, 11):  # noqa: UP036 - the reader's Python may be any
        sys.exit(f"Python 3.11 or newer is needed; this is {sys.version.split()[0]}.{NEWER.get(sys.platform, '')}")
    if trouble := NO_MUJOCO.get((sys.platform, platform.machine().lower())):
        sys.exit(f"MuJoCo has no wheels for {trouble}.")
    extras = sorted(sys.argv[1:])
    if any(extra.startswith("-") for extra in extras):
        sys.exit(__doc__)
    announce(extras)
    make_venv()
    install(with_torch(extras) if "dev" in extras else extras)
    ensure_opengl()
    if "dev" in extras:
        ensure_sdformat()


if __name__ == "__main__":
    main()
