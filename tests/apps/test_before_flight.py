"""What a person reads before a flight, in a real terminal, and what `fly` needs: looked at before anything is armed."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest
from app_fakes import camera
from peer import PARAMETERS_4_7, Peer, playing

COLUMNS = 80
BAD = {**PARAMETERS_4_7, "MAV_GCS_SYSID": 7.0, "ARMING_SKIPCHK": -1.0, "FS_GCS_ENABLE": 0.0}


def fly(peer: Peer, url: str, out: Path, *more: str) -> list[str]:
    link = f"mavlink:udpout:127.0.0.1:{peer.port}"
    return [
        *(sys.executable, "-m", "cognitivedrone", "fly", "go", "--link", link, "--camera", url, "--out", str(out)),
        *("--policy", "hover", "--reasoner", "none", *more),
    ]


def in_a_terminal(command: list[str], asked: bytes = b"", typed: bytes = b"") -> tuple[int, list[str]]:
    """Run a command in a terminal of 80 columns that is its own; its exit code, and the lines on the screen.

    Where `asked` has appeared, `typed` is typed.
    """
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, COLUMNS, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(
        ["setsid", "--ctty", "--wait", *command], stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    )
    os.close(theirs)
    printed = b""
    try:
        while data := os.read(ours, 4096):
            printed += data
            if asked and asked in printed:
                os.write(ours, typed)
                asked = b""
    except OSError:  # the last that had the terminal open has ended
        pass
    os.close(ours)
    return process.wait(60), printed.decode().replace("\r\n", "\n").splitlines()


def test_the_checklist_that_refuses_a_flight_is_a_table_in_a_terminal(tmp_path):
    with playing(version=(4, 7), parameters=dict(BAD)) as peer, camera() as url:
        code, lines = in_a_terminal(fly(peer, url, tmp_path / "f", "--i-understand-this-flies-a-real-drone"))
        assert peer.orders(176, 400, 22) == []
    assert code == 2
    assert max(map(len, lines)) <= COLUMNS
    assert "cognitivedrone: not fit to fly:" in lines
    assert "[bad ] MAV_GCS_SYSID    7                          255" in lines
    assert [line[7:].split()[0] for line in lines if line.startswith("[bad ]")] == [
        "MAV_GCS_SYSID",
        "FS_GCS_ENABLE",
        "ARMING_SKIPCHK",
    ]
    expected = " ".join(" ".join(lines).split())
    assert "; --set-parameters sets MAV_GCS_SYSID, FS_GCS_ENABLE, ARMING_SKIPCHK for the flight" in expected
    assert "\\x" not in expected
    assert "set_parameters" not in expected


def test_what_is_confirmed_is_the_same_table(tmp_path):
    with playing() as peer, camera() as url:
        command = fly(peer, url, tmp_path / "f", "--i-understand-this-flies-a-real-drone")
        code, lines = in_a_terminal(command, b"stop: ", b"\x04")  # ctrl-D
        assert peer.orders(176, 400, 22) == []
    assert code == 2
    assert max(map(len, lines)) <= COLUMNS
    assert "[ ok ] SYSID_MYGCS      255                        255" in lines
    assert any("type 'arm' to arm and take off, anything else to stop:" in line for line in lines)


@pytest.mark.parametrize(
    ("redirection", "message"),
    [("<&-", "standard input is closed"), ("0>/dev/null", "standard input can only be written")],
)
def test_a_keyboard_that_cannot_be_read_ends_the_flight_before_it_begins(tmp_path, redirection, message):
    with playing() as peer, camera() as url:
        command = ["sh", "-c", f'exec "$@" {redirection}', "sh", *fly(peer, url, tmp_path / "f")]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert ended.returncode == 2
        assert ended.stderr.startswith(
            f"cognitivedrone: {message}; fly reads instructions from it: run it in a terminal"
        )
        assert peer.orders(176, 400, 22) == []
    assert not (tmp_path / "f").exists()


def test_a_confirmation_that_is_no_text_is_none(tmp_path):
    with playing() as peer, camera() as url:
        command = fly(peer, url, tmp_path / "f", "--i-understand-this-flies-a-real-drone")
        environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}  # as a desktop's locale has it
        ended = subprocess.run(
            command, input=b"\xffarm\n", capture_output=True, timeout=60, check=False, env=environment
        )
        assert peer.orders(176, 400, 22) == []
    assert ended.returncode == 2
    assert b"not confirmed" in ended.stderr
    assert b"Traceback" not in ended.stderr


def test_a_background_job_of_a_terminal_is_not_flown():
    ask = "import sys; from cognitivedrone.apps.orders import readable; readable(sys.stdin); print('it may fly')"
    script = ["sh", "-c", 'set -m; "$@" & wait; "$@"', "sh", sys.executable, "-c", ask]
    _, lines = in_a_terminal(script)
    expected = "\n".join(lines)
    assert expected.count("RunError: standard input is a terminal that another job has") == 1
    assert expected.count("it may fly") == 1  # in the foreground
