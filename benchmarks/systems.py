"""The README's commands on other systems, as a new user, and the built wheel on other Pythons.

Run: python benchmarks/systems.py [--root FOLDER ...] [--wheel PYTHON ...] [--out results/systems.json]

A root is the folder of a whole system, such as `debootstrap --variant=minbase --include=git,make,python3-venv,
libegl1,libgl1-mesa-dri,libopengl0 trixie FOLDER MIRROR` makes it. There an ordinary user runs `make bench` in a new
clone, by chroot, so that needs root's rights. Name resolution, certificates and pip's variables are this machine's.
`--wheel` runs `make test-wheel` in a clone of its own. What is not committed is not cloned.

Exit code 1 where a command fails.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.benchmark.scores.results import RESULTS_FILE, read_results

PROJECT = Path(__file__).resolve().parents[1]
USER = 1000
HOME = Path("home/newcomer")
SHARED = ("etc/resolv.conf", "etc/ssl/certs/ca-certificates.crt")
"""Files that a system needs of this machine to reach a package index."""
PATH = "/usr/local/bin:/usr/bin:/bin"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--root", type=Path, nargs="+", default=[], help="folders of whole systems")
    parser.add_argument("--wheel", nargs="+", default=[], metavar="PYTHON", help="interpreters of this machine")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    rows = []
    for root in options.root:
        rows.append(bench_in(root))
        print(rows[-1], flush=True)
    for python in options.wheel:
        rows.append(wheel_on(python))
        print(rows[-1], flush=True)
    keep(options.out, "The README's commands on other systems, and the wheel on other Pythons", rows)
    if any(row["result"].startswith("failed") for row in rows):
        sys.exit(1)


def bench_in(root: Path) -> dict[str, Any]:
    """`make bench` of a new user of the system in this folder."""
    home = root / HOME
    shutil.rmtree(home, ignore_errors=True)
    for name in SHARED:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(Path("/") / name, root / name)
    clone = home / "cognitivedrone"
    subprocess.run(["git", "clone", "--quiet", PROJECT, clone], check=True)
    subprocess.run(["chown", "-R", f"{USER}:{USER}", home], check=True)
    with devices(root):
        version = run_in(root, "python3 --version").stdout.strip()
        began = time.monotonic()
        done = run_in(root, f"cd /{HOME}/cognitivedrone && make bench")
        took_s = time.monotonic() - began
    row = {"system": system_of(root), "python": version.removeprefix("Python "), "what": "`make bench`, a new user"}
    if done.returncode:
        return {**row, "result": f"failed: {last_line(done.stdout + done.stderr)}", "wall_s": took_s}
    results = read_results(clone / "results" / "smoke")
    if not (clone / "results" / "smoke" / RESULTS_FILE).with_name("report.html").is_file():
        return {**row, "result": "failed: no report", "wall_s": took_s}
    passed = results.summary("through").overall
    return {**row, "result": f"{passed.passed} of {passed.n} passed", "wall_s": round(took_s)}


def run_in(root: Path, command: str) -> subprocess.CompletedProcess[str]:
    """Run a shell command as the new user of another system."""
    shared = {name: value for name, value in os.environ.items() if name.startswith(("PIP_", "SSL_"))}
    words: list[str | Path] = ["/usr/sbin/chroot", f"--userspec={USER}:{USER}", root, "/bin/sh", "-c", command]
    environment = {"HOME": f"/{HOME}", "PATH": PATH, "LANG": "C.UTF-8", **shared}
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=False)


@contextmanager
def devices(root: Path) -> Iterator[None]:
    """Processes and devices of this machine in another system's folder."""
    mounted: list[Path] = []
    try:
        for name in ("proc", "dev"):
            subprocess.run(["mount", "--rbind", "--make-rslave", f"/{name}", root / name], check=True)
            mounted.append(root / name)
        yield
    finally:
        for each in reversed(mounted):
            subprocess.run(["umount", "--recursive", "--lazy", each], check=False)


def system_of(root: Path) -> str:
    """A system's own name."""
    lines = (root / "etc" / "os-release").read_text(encoding="utf-8").splitlines()
    facts = dict(line.split("=", 1) for line in lines if "=" in line)
    return facts.get("PRETTY_NAME", "unknown").strip('"').replace("GNU/Linux ", "")


def wheel_on(python: str) -> dict[str, Any]:
    """`make test-wheel` on an interpreter of this machine."""
    version = subprocess.run([python, "--version"], capture_output=True, text=True, check=True).stdout.strip()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["git", "clone", "--quiet", PROJECT, f"{folder}/clone"], check=True)
        began = time.monotonic()
        words = ["make", "test-wheel", f"PYTHON={python}"]
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}  # the wheel's own
        done = subprocess.run(
            words, cwd=f"{folder}/clone", env=environment, capture_output=True, text=True, check=False
        )
        took_s = time.monotonic() - began
    counts = re.findall(r"^(\d.* passed.*) in [\d.]+s", done.stdout.replace("=", "").replace(" \n", "\n"), re.MULTILINE)
    result = counts[-1].strip() if counts and not done.returncode else f"failed: {last_line(done.stdout + done.stderr)}"
    row = {"system": system_of(Path("/")), "python": version.removeprefix("Python "), "what": "`make test-wheel`"}
    return {**row, "result": result, "wall_s": round(took_s)}


def last_line(text: str) -> str:
    """Of what a command printed."""
    return text.strip().rpartition("\n")[2][:200]


if __name__ == "__main__":
    main()
