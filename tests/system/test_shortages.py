"""Errors that come of a limit of the shell name it."""

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from cognitivedrone.cli import main
from cognitivedrone.errors import RunError
from cognitivedrone.files import writing
from cognitivedrone.system.shortages import tight_limit, way_out_of

WITH_LIMIT = 'ulimit "$1" "$2"; shift 2; exec "$@"'


@pytest.fixture
def limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every limit is 500 files, kilobytes or processes."""
    units = {resource.RLIMIT_AS: 1024}
    monkeypatch.setattr(resource, "getrlimit", lambda number: (500 * units.get(number, 1),) * 2)


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (OSError(errno.EMFILE, "Too many open files"), "500 open files (ulimit -n)"),
        ("it failed: [Errno 24] nothing more", "500 open files (ulimit -n)"),
        (MemoryError(), "500 KB of memory (ulimit -v)"),
        ("x.so: failed to map segment from shared object", "500 KB of memory (ulimit -v)"),
        (RuntimeError("can't start new thread"), "500 processes and threads (ulimit -u)"),
        (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), "500 processes and threads (ulimit -u)"),
    ],
)
@pytest.mark.usefixtures("limited")
def test_what_is_short_is_named_with_the_limit(error: object, says: str) -> None:
    assert way_out_of(error) == f"raise the limit of this shell, which is {says}"


def test_without_a_limit_the_machine_itself_has_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert way_out_of(MemoryError()) == "end other programs: this machine has no more"
    assert tight_limit() == ""
    assert way_out_of(OSError(errno.ENOSPC, "No space left on device")) == ""


def test_a_file_that_cannot_be_written_for_want_of_another_thing_than_room(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"Too many open files; raise the limit of this shell"):  # noqa: SIM117
        with writing(tmp_path, RunError):
            raise OSError(errno.EMFILE, "Too many open files")
    with pytest.raises(RunError, match="No space left on device; make room there"):  # noqa: SIM117
        with writing(tmp_path, RunError):
            raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("raised", [OSError(errno.EMFILE, "Too many open files"), MemoryError()])
def test_a_command_says_it_in_one_sentence(raised: Exception, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    def command() -> None:
        raise raised

    monkeypatch.setattr("cognitivedrone.cli.load", lambda _: command)
    with pytest.raises(SystemExit) as end:
        main(["list"])
    said = capsys.readouterr().err
    assert end.value.code == 2
    assert way_out_of(raised) in " ".join(said.split())
    assert "free space" not in said


@pytest.mark.parametrize(("option", "limit"), [("-n", 8), ("-v", 400_000)])
def test_opengl_under_a_limit_is_not_to_be_installed(option: str, limit: int) -> None:
    program = "from cognitivedrone.sim.drawing.gl import *\ntry: backend()\nexcept RenderError as e: print(e)"
    done = subprocess.run(
        ["/bin/sh", "-c", WITH_LIMIT, "sh", option, str(limit), sys.executable, "-c", program],
        env=os.environ | {"COGNITIVEDRONE_GL": "", "MUJOCO_GL": ""}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert f"(ulimit {option})" in done.stdout
    assert "install" not in done.stdout
