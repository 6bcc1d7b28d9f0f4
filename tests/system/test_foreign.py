"""The commands of the README as on macOS and Windows, as far as Linux can show it: see `support/foreign.py`."""

import importlib.util
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mypy", reason="its types say what a system lacks")
import foreign

SCRIPT = Path(__file__).parents[1] / "support/foreign_script.py"
COLLECT = "collect --recipe debug --episodes 1 --workers 1 --out set"
EVERYWHERE = [
    "bench --policy oracle --episodes 2 --workers 2 --clips 0 --out bench",
    COLLECT,
    "view --out view.png",
    "fly --policy hover --reasoner none --episode 0 --time-limit 1 --out fly",
    "evaluate",
    "make_vec",
    *(["serve"] if importlib.util.find_spec("msgpack") else []),
]
ENDINGS = {line: 1 if line.startswith("fly") else 0 for line in EVERYWHERE}
"""`hover` misses the gate, which `fly` says by its exit code."""
TRAIN = "train --recipe debug --steps 1 --out trained"
REFUSED = [
    "fly --link mavlink:udp:127.0.0.1:9 --camera clip.mp4 Forward",
    "bench --link sitl --out sitl",
    "bench --executor ray --out ray",
    "collect --recipe debug --executor ray --out ray-set",
]
"""On Windows: with a sentence, before anything starts."""


def run(system, folder, lines):
    """How each of the lines ended, and all that was written to standard error."""
    site, home, temporary = folder / "site", folder / "home", folder / "tmp"
    for made in (site, home, temporary):
        made.mkdir()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    environment = dict(os.environ) if system == "linux" else foreign.environment(system, site)
    # On Windows an open file keeps a folder; here, other processes would sweep it from the common place.
    environment["TMPDIR"] = str(temporary)
    done = subprocess.run(
        [sys.executable, SCRIPT, str(port), *lines], cwd=home, env=environment, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, encoding="utf-8",
    )  # fmt: skip
    ended = {line: code for line, code, _ in map(json.loads, done.stdout.splitlines())}
    print(done.stdout, done.stderr)
    return ended, done.stderr, home


@pytest.fixture(scope="module", params=foreign.SYSTEMS)
def foreign_run(request, tmp_path_factory):
    return run(request.param, tmp_path_factory.mktemp(request.param), EVERYWHERE)


@pytest.fixture(scope="module")
def collected_here(tmp_path_factory):
    return run("linux", tmp_path_factory.mktemp("linux"), [COLLECT])[2] / "set"


def test_every_command_runs(foreign_run):
    ended, said, home = foreign_run
    assert ended == ENDINGS, said
    assert "Traceback" not in said
    assert json.loads((home / "bench/results.json").read_text(encoding="utf-8"))["platform"]["system"] != "Linux"


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_is_collected_is_equal_to_the_byte(foreign_run, collected_here):
    found, expected = files(foreign_run[2] / "set"), files(collected_here)
    assert found == expected


def test_what_windows_lacks_too_much_for_is_refused_with_the_way_out(tmp_path):
    ended, said, home = run("win32", tmp_path, REFUSED)
    assert ended == dict.fromkeys(REFUSED, 2)
    assert said.count("needs Linux or macOS; on Windows, run it in WSL2") == len(REFUSED), said
    assert list(home.iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs PyTorch")
@pytest.mark.parametrize("system", foreign.SYSTEMS)
def test_a_model_is_trained(tmp_path, system):
    ended, said, _ = run(system, tmp_path, [TRAIN])
    assert ended == {TRAIN: 0}, said
