"""A sample of what benchmarks/faults.py tries in full: kills at file operations, and damaged files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "faults.py"


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """In a process of its own, which has no thread and may be forked."""
    return subprocess.run([sys.executable, SCRIPT, *arguments], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("section", "share", "tried"),
    [
        ("collect-kills", 0.003, 2),
        ("damaged-stores", 0.05, 15),
        pytest.param("collect-kills", 0.01, 9, marks=pytest.mark.slow),
        pytest.param("bench-kills", 0.04, 3, marks=pytest.mark.slow),
        pytest.param("damaged-stores", 0.15, 50, marks=pytest.mark.slow),
    ],
)
def test_a_sample_of_faults_is_survived(section: str, share: float, tried: int) -> None:
    done = run(section, "--share", str(share))
    assert done.returncode == 0, done.stdout + done.stderr
    *_, row = [line for line in done.stdout.splitlines() if line.startswith("|")]
    _, _, count, found, mended, stray, _ = (cell.strip() for cell in row.split("|"))
    assert int(count) >= tried
    assert found in ("", f"{count} of {count}")
    assert mended == f"{count} of {count}"
    assert stray == "0"


def test_an_unknown_section_is_reported_with_those_there_are() -> None:
    done = run("colect-kills")
    assert done.returncode == 2
    assert "collect-kills, bench-kills, random-kills, damaged-stores" in done.stderr
