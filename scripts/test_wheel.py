"""Try the built wheel in a fresh environment: the smoke suite, then the fast tests. Standard library only.

Usage: PYTHON scripts/test_wheel.py [--lowest | --newest] [--sdist]

The environment is of the Python that runs this script, is in a temporary folder, and has the light extras: tests of
PyTorch and Ray are skipped. Every dependency comes in the newest version that pyproject.toml allows, and any warning is
an error, also one that is raised inside of another package. With --lowest what pyproject.toml names comes in the lowest
version that it allows, as uv finds it. With --newest all tools of a developer are installed, PyTorch too, and the tests
are those that the other runs leave out. With --sdist the source archive is built first; wheel and tests come out of it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BIN = "Scripts" if sys.platform == "win32" else "bin"
EXTRAS = ["mavlink", "ros", "test", "vlm"]  # those that bring no PyTorch and no Ray
FAST_TESTS = ["benchmark", "contract", "data", "envs", "control", "labels", "models", "policies", "reasoners", "sim"]
FAST_TESTS += ["tasks", "world", "cli/test_cli.py", "project/test_imports.py"]
FAST_TESTS += ["test_errors.py", "test_frames.py"]
WHERE = "import pathlib, cognitivedrone; print(pathlib.Path(cognitivedrone.__file__).parent)"


def step(what: str, *command: object, cwd: Path = ROOT) -> None:
    """Run a command and say how long it took; end with its exit status where it fails."""
    print(f"== {what}", flush=True)
    began = time.monotonic()
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    status = subprocess.run([str(part) for part in command], cwd=cwd, env=environment, check=False).returncode
    if status != 0:
        sys.exit(f"{what} failed with exit status {status}: {' '.join(map(str, command))}")
    print(f"== {what}: {time.monotonic() - began:.0f} s", flush=True)


def pinned_to_lowest(pip: list[object], folder: Path) -> list[object]:
    """Arguments of pip for the lowest version of every direct dependency."""
    uv = shutil.which("uv") or folder / "venv" / BIN / "uv"
    if not Path(uv).exists():
        step("uv", *pip, "install", "--quiet", "uv")
    python = folder / "venv" / BIN / "python"
    compiling = [uv, "pip", "compile", "--quiet", "--resolution", "lowest-direct"]
    compiling += [f"--extra={extra}" for extra in EXTRAS]
    step("lowest versions", *compiling, "--python", python, "-o", folder / "lowest.txt", ROOT / "pyproject.toml")
    return ["--requirement", folder / "lowest.txt"]


def unpacked(pip: list[object], folder: Path) -> Path:
    """The source archive, built and unpacked: the folder of its pyproject.toml."""
    step("build", *pip, "install", "--quiet", "build")
    archives = folder / "archives"
    step("source archive", pip[0], "-m", "build", "--sdist", "--outdir", archives, ROOT)
    (archive,) = archives.glob("cognitivedrone-*.tar.gz")
    with tarfile.open(archive) as opened:
        opened.extractall(archives, filter="data")
    return archives / archive.name.removesuffix(".tar.gz")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    versions = parser.add_mutually_exclusive_group()
    versions.add_argument("--lowest", action="store_true", help="the lowest allowed version of each dependency")
    versions.add_argument("--newest", action="store_true", help="all tools, and the tests that need them")
    parser.add_argument("--sdist", action="store_true", help="from the source archive")
    options = parser.parse_args()
    lowest = options.lowest
    with tempfile.TemporaryDirectory(prefix="cognitivedrone-wheel-") as name:
        folder = Path(name)
        binaries = folder / "venv" / BIN
        pip: list[object] = [binaries / "python", "-m", "pip", "--disable-pip-version-check"]
        print(f"Python {sys.version.split()[0]}, {'lowest' if lowest else 'newest'} versions", flush=True)
        step("environment", sys.executable, "-m", "venv", folder / "venv")
        root = unpacked(pip, folder) if options.sdist else ROOT
        step("wheel", *pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, root)
        pins = pinned_to_lowest(pip, folder) if lowest else []
        (wheel,) = folder.glob("cognitivedrone-*.whl")
        extras = ["dev", "dev-torch"] if options.newest else EXTRAS
        step("installation", *pip, "install", "--quiet", f"{wheel}[{','.join(extras)}]", *pins)
        imported = subprocess.run([binaries / "python", "-c", WHERE], cwd=folder, capture_output=True, text=True)
        if not imported.stdout.startswith(str(folder / "venv")):
            sys.exit(f"the installed package is not what is imported: {imported.stdout}{imported.stderr}")
        step("versions", *pip, "freeze")
        step("smoke suite", binaries / "cognitivedrone", "bench", "--suite", "open-v1:smoke", "--out", folder / "smoke")
        pytest = [binaries / "python", "-m", "pytest", "-q", "-n", "2", "-p", "no:cacheprovider"]
        tests: list[object] = [root / "tests" / part for part in FAST_TESTS]
        if options.newest:
            step("the other tests", *pytest, "-W", "error", *(f"--ignore={part}" for part in tests), cwd=root)
        else:
            step("fast tests", *pytest, *([] if lowest else ["-W", "error"]), *tests, cwd=root)


if __name__ == "__main__":
    main()
