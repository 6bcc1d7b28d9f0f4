"""What is printed reaches the reader as text, whatever the output can show; nothing is reported to anybody."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import ColorSystem, Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

import cognitivedrone
from cognitivedrone.benchmark.reports.catalogue import catalogue
from cognitivedrone.models.onnx_file import open_model
from cognitivedrone.models.small_file import KIND
from cognitivedrone.system.imports import SWITCHES, switch_off
from cognitivedrone.terminal import console


def run(code: str, redirect: str = "", **variables: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        ["/bin/sh", "-c", f'exec "$@" {redirect}', "sh", sys.executable, "-c", code],
        env={**os.environ, **variables}, capture_output=True, check=False,
    )  # fmt: skip


SAYS = """
import sys, cognitivedrone.cli as cli
cli.load = lambda name: lambda: print("caf\\u00e9 \\u2026 \\ud800")
cli.main(["list"])
"""


@pytest.mark.parametrize(
    ("encoding", "message"),
    [
        ("ascii", rb"caf\xe9 \u2026 \ud800"),
        ("utf-8", "café … ".encode() + rb"\ud800"),
        ("ascii:strict", rb"caf\xe9 \u2026 \ud800"),
    ],
)
def test_a_character_that_the_output_lacks_is_an_escape_sequence(encoding, message):
    done = run(SAYS, PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stdout, done.stderr) == (0, message + b"\n", b"")


def test_a_child_interpreter_prints_as_we_do():
    code = """
import subprocess, sys, cognitivedrone.cli as cli
cli.load = lambda name: lambda: subprocess.run([sys.executable, "-c", "print('caf\\\\u00e9')"], check=True)
cli.main(["list"])
"""
    assert run(code, PYTHONIOENCODING="ascii").stdout == rb"caf\xe9" + b"\n"


@pytest.mark.parametrize("redirect", [">&-", "<&- >&- 2>&-"])
def test_closed_streams_are_the_null_device(tmp_path, redirect):
    """No file that is opened later gets the number of a standard stream, into which children print."""
    code = f"""
import sys, cognitivedrone.cli as cli
def command():
    with open({str(tmp_path / "file")!r}, "w") as file:
        file.write(str(file.fileno()))
    print("said")
    print("said", file=sys.stderr)
    assert sys.stdin is None or sys.stdin.read() == ""
cli.load = lambda name: command
cli.main(["list"])
"""
    assert run(code, redirect).returncode == 0
    assert int((tmp_path / "file").read_text()) > 2


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_list_of_names_is_readable(capsys, width):
    console(width=width).print(catalogue())
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    assert any(line.startswith("  open-v1:test ") and "300 tasks, hash" in line for line in lines)
    about = lines[next(i for i, line in enumerate(lines) if "open-v1:unseen" in line) + 1]
    assert about.strip().startswith("held out: drawing style, fonts, faces, wordings")  # one line of 80, or most of it
    assert not any(line.strip().startswith((",", "[", "]")) for line in lines)  # no plug-in is broken in two
    assert len(lines) <= 142 * 80 // min(width, 80)


def test_libraries_are_told_not_to_report(monkeypatch, tiny_model_file):
    for name in SWITCHES:
        monkeypatch.delenv(name, raising=False)
    open_model(tiny_model_file, KIND, threads=1, optimise=False)
    assert os.environ["ORT_DISABLE_TELEMETRY"] == "1"


def test_what_the_user_has_set_counts(monkeypatch):
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "1")
    switch_off()
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "1"


EVIL = "[/f] [bold]x[/bold] :smile: \x1b]0;title \u202e \ud800"
SHOWN = r"[/f] [bold]x[/bold] :smile: \x1b]0;title \u202e \ud800"
SOURCES = Path(cognitivedrone.__file__).parent


@pytest.fixture
def screen() -> Console:
    made = console()
    made.file, made.width = io.StringIO(), 200
    return made


def table(text: str) -> Table:
    drawn = Table(text, title=text, caption=text)
    drawn.add_row(text)
    return drawn


@pytest.mark.parametrize(
    ("thing", "times"), [(EVIL, 1), (Text(EVIL), 1), (table(EVIL), 4), (Panel(Text(EVIL), title=Text(EVIL)), 2)]
)
def test_data_is_shown_as_it_is(screen: Console, thing: object, times: int) -> None:
    screen.print(thing)
    printed = screen.file.getvalue()
    # In a cell, an escape sequence may be cut where it is longer than what it stands for.
    assert printed.count(SHOWN[:12]) == times
    assert SHOWN in printed or times == 2
    printed.encode("utf-8")
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f]", printed)


def test_styles_of_the_program_stay(screen: Console) -> None:
    coloured = console()
    coloured.file, coloured._color_system, coloured._force_terminal = screen.file, ColorSystem.STANDARD, True
    coloured.print(Text("told\x1b[0m", style="bold"))
    assert screen.file.getvalue() == "\x1b[1mtold\\x1b[0m\x1b[0m\n"


def test_no_module_makes_a_console_of_its_own() -> None:
    made = [
        path.relative_to(SOURCES).as_posix()
        for path in SOURCES.rglob("*.py")
        if re.search(r"\bConsole\(", path.read_text(encoding="utf-8"))
    ]
    assert not made


def test_a_file_gets_plain_text_also_in_a_notebook(monkeypatch):
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    file = io.StringIO()
    console(file=file).print(Text("passed", style="bold"))
    assert file.getvalue() == "passed\n"
