"""`runs/smoke.sh`: every step of `runs/reproduce.sh` in tiny sizes, from nothing to the paper's table.

It trains nine models and flies with them, which takes minutes: `make test-smoke` runs it, `make test` leaves it out.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cognitivedrone.benchmark.measurements import read_measurement
from cognitivedrone.files import digest_of_file

ROOT = Path(__file__).resolve().parents[2]
PILOTS = (
    "colour_seeker", "colour_seeker_oracle", "hover", "oracle", "r1", "race", "random", "recorded_12", "small",
    "small_oracle", "stream",
)  # fmt: skip
MEASURED = ("audit_r1", "dynamics", "openvla_memory", "reasoner_alone", "step_responses")

pytestmark = pytest.mark.skipif(os.environ.get("SMOKE") != "1", reason="takes minutes: make test-smoke")


def smoke(out: Path) -> str:
    """What it prints."""
    binaries = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{binaries}:{os.environ['PATH']}", "PYTHON": sys.executable}
    command = [ROOT / "runs" / "smoke.sh", out]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def test_the_whole_story_runs_and_runs_again(tmp_path: Path) -> None:
    smoke(tmp_path)
    results = tmp_path / "results"
    made = {path.stem for path in results.glob("*.json")}
    assert made >= {*MEASURED}
    for name in MEASURED:
        assert read_measurement(results / f"{name}.json").rows
    # The runs are of three tasks: no whole suites, so nothing that a table of the docs could show.
    assert not made & {*PILOTS}
    flown = {path.parents[1].name for path in (tmp_path / "scores").glob("*/*/results.json")}
    assert flown == {*PILOTS}

    table = (tmp_path / "paper.md").read_text()
    for system in ("RaceVLA", "CognitiveDrone", "CognitiveDrone-R1"):
        assert re.search(rf"^\| {system}\b", table, flags=re.MULTILINE)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    recipes = {entry["recipe"] for entry in manifest["files"].values()}
    assert recipes == {
        "reader", "debug-selector", "debug-language", "small", "flight", "places", "race", "debug-obstacles",
    }  # fmt: skip
    for name, entry in manifest["files"].items():
        assert entry["sha256"] == digest_of_file(tmp_path / name)

    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.onnx")}
    before |= {path: path.stat().st_mtime_ns for path in tmp_path.glob("scores/*/*/episodes.jsonl")}
    smoke(tmp_path)
    assert {path: path.stat().st_mtime_ns for path in before} == before
