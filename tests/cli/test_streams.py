"""What a command prints reaches the reader, whatever the output can show; and nothing is reported to anybody."""

import os
import subprocess
import sys

import pytest

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
        ("latin-1", b"caf\xe9" + rb" \u2026 \ud800"),
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


@pytest.mark.parametrize("redirect", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
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
