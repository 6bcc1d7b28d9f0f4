"""Every command, run for real: in a hostile folder, with a fresh home, without a usable terminal."""

import importlib.util
import re
import shutil
import sys
from importlib import metadata
from pathlib import Path

import pytest
from every_command import COMMANDS, TRAIN, environment_of, run_all

from cognitivedrone.cli import TARGETS

BRIEF = [
    "--version",
    "bench --suite open-v1:smoke --policy oracle --workers 1 --episodes 1 --clips 0 --out a",
    "reason --suite open-v1:smoke --reasoner small --episodes 1 --out reason",
    "fly --link mavlink:udp:127.0.0.1:9 'Fly through the red gate'",
    "sim --mavlink --links tcpin:127.0.0.1:PORT",
    "serve --policy hover --port PORT",
    "collect --recipe debug --episodes 1 --workers 1 --out set",
]
"""Of each kind of process that a command starts."""
MAVLINK, SERVE = (importlib.util.find_spec(name) is not None for name in ("pymavlink", "uvicorn"))
TORCH = importlib.util.find_spec("torch") is not None


def test_every_command_is_among_them():
    words = [" ".join(line.split()[:2]) for line in [*COMMANDS, TRAIN]]
    assert all(any(word == name or word.startswith(f"{name} ") for word in words) for name in TARGETS)


def poison(folder: Path, mark: Path) -> None:
    """Modules in a folder, of every name that Python or an installed package has, that leave a mark when they run."""
    names = {*sys.stdlib_module_names, *metadata.packages_distributions(), "sitecustomize", "usercustomize"}
    for name in filter(str.isidentifier, names):
        (folder / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write({name!r} + ' ')\nraise SystemExit(77)\n")


@pytest.mark.parametrize("lines", [BRIEF, pytest.param(COMMANDS, marks=pytest.mark.slow)], ids=["brief", "every"])
def test_a_command_runs_nothing_of_its_folder_and_tells_nobody(tmp_path, lines):
    folder, home, mark = (tmp_path / name for name in ("folder", "home", "mark"))
    folder.mkdir()
    home.mkdir()
    poison(folder, mark)
    lines = [*lines, TRAIN] if TORCH and lines is COMMANDS else lines
    trace = tmp_path / "trace"
    tracer = shutil.which("strace")
    before = (tracer, "-f", "-A", "--seccomp-bpf", "-e", "trace=connect", "-o", str(trace)) if tracer else ()
    environment = environment_of(home, LC_ALL="C", **PLACES["ascii"][0])
    ended = run_all(folder, environment, lines=lines, before=before)
    assert not mark.exists(), f"executed from the working directory: {mark.read_text()}"
    assert [one for one in ended if not one.clean] == []
    assert [one.line for one in ended if one.code == 0 and one.line.startswith("bench -")] != []
    left = {str(path.relative_to(home)) for path in home.rglob("*") if path.is_file()}
    assert {name for name in left if not name.startswith(CACHES)} == set()
    if tracer:
        addresses = re.findall(r'sin6?_port=htons\((\d+)\).*?inet_(?:addr\(|pton\(\w+, )"([^"]+)"', trace.read_text())
        assert {(port, host) for port, host in addresses if not host.startswith(("127.", "::1"))} == set()


CACHES = (".cache/mesa_shader_cache", ".cache/matplotlib", ".config/matplotlib")
"""What the graphics driver and the drawing of curves keep for their next start."""

PLACES = {
    "latin-1": ({"LC_ALL": "C", "PYTHONIOENCODING": "latin-1"}, ""),
    "ascii": ({"PYTHONIOENCODING": "ascii", "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "60"}, ""),
    "without streams": ({}, "<&- >&- 2>&-"),
}


def test_a_command_ends_without_a_traceback_where_it_cannot_say_anything(tmp_path):
    folder, home = tmp_path / "folder", tmp_path / "home"
    folder.mkdir()
    home.mkdir()
    variables, redirect = PLACES["without streams"]
    ended = run_all(folder, environment_of(home, **variables), lines=["nonsense", BRIEF[1]], redirect=redirect)
    assert [one for one in ended if not one.clean] == []
    assert [one.code for one in ended] == [2, 0]


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_every_command_ends_without_a_traceback(tmp_path, place):
    folder, home = tmp_path / "folder", tmp_path / "home"
    folder.mkdir()
    home.mkdir()
    variables, redirect = PLACES[place]
    ended = run_all(folder, environment_of(home, **variables), lines=COMMANDS, redirect=redirect)
    assert [one for one in ended if not one.clean] == []
    succeeded = {one.line for one in ended if one.code == 0}
    assert {line for line in COMMANDS if line.startswith(("list", "view", "merge", "bench -", "data show"))} <= {
        *succeeded, "bench --nonsense 1", COMMANDS[10]
    }  # fmt: skip
