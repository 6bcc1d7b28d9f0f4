"""A sample of what benchmarks/faults.py tries in full: kills at file operations, and damaged files."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "faults.py"


@pytest.mark.parametrize(
    ("section", "share", "tried"),
    [
        ("collect-kills", 0.003, 2),
        ("damaged-stores", 0.05, 15),
        pytest.param("bench-kills", 0.04, 3, marks=pytest.mark.slow),
    ],
)
def test_a_sample_of_faults_is_survived(section: str, share: float, tried: int) -> None:
    # In a process of its own, which has no thread and may be forked.
    command = [sys.executable, str(SCRIPT), section, "--share", str(share)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    *_, row = [line for line in done.stdout.splitlines() if line.startswith("|")]
    _, _, count, found, mended, stray, _ = (cell.strip() for cell in row.split("|"))
    assert int(count) >= tried
    assert found in ("", f"{count} of {count}")
    assert mended == f"{count} of {count}"
    assert stray == "0"
