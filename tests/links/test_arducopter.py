"""The process: found, started as it should be, heard when it ends."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from arducopters import script

from cognitivedrone.errors import LinkError
from cognitivedrone.links.arducopter import BINARY_VARIABLE, ArduCopter, find_binary, port_is_free


def test_the_binary_is_the_one_named_or_that_of_the_environment(tmp_path, monkeypatch):
    first, second = script(tmp_path / "first", "exit 0"), script(tmp_path / "second", "exit 0")
    monkeypatch.setenv(BINARY_VARIABLE, str(first))
    assert find_binary(None, "give one") == first
    assert find_binary(second, "give one") == second
    monkeypatch.setenv(BINARY_VARIABLE, "")
    with pytest.raises(LinkError, match=r"needs an ArduCopter binary: give one; docs/ardupilot\.md"):
        find_binary(None, "give one")
    (tmp_path / "text").write_text("not a program")
    with pytest.raises(LinkError, match="text is not a program that can be run: give one"):
        find_binary(tmp_path / "text", "give one")


def test_it_is_started_with_its_parameters_in_its_folder(tmp_path):
    (tmp_path / "run").mkdir()
    theirs = tmp_path / "theirs.parm"
    theirs.write_text("A 1\n")
    binary = script(tmp_path / "arducopter", 'echo "$@"; exec sleep 60')
    options = {"instance": 3, "defaults": [theirs], "parameters": "B 2\n", "speed": 50.0}
    with ArduCopter(binary, tmp_path / "run", **options) as running:
        assert running.url == "tcp:127.0.0.1:5790"
        said = running.connect(lambda _: heard(running))
    assert said.split()[:6] == ["--model", "JSON:127.0.0.1", "--instance", "3", "--speedup", "50"]
    first, ours = (Path(name) for name in said.split()[7].split(","))
    assert first == theirs
    assert ours.read_text().splitlines()[-2:] == ["AHRS_EKF_TYPE 3", "B 2"]


def heard(running: ArduCopter) -> str:
    """What it has printed; not yet there is a reason to try again."""
    said = running.output.read_text()
    if not said:
        raise LinkError("nothing yet")
    return said


def test_what_ends_at_once_is_told_with_its_last_words(tmp_path):
    binary = script(tmp_path / "arducopter", "echo starting; echo no such board >&2; exit 4")

    def refuse(url: str) -> None:
        raise LinkError(f"cannot connect to {url}")

    with ArduCopter(binary, tmp_path) as ended, pytest.raises(LinkError, match="ended with 4, its last words: no such"):
        ended.connect(refuse)


def test_what_cannot_be_started_is_told(tmp_path):
    binary = tmp_path / "arducopter"
    binary.write_bytes(b"\x7fELF is not all")
    binary.chmod(0o755)
    with pytest.raises(LinkError, match=r"cannot run .*arducopter: "):
        ArduCopter(binary, tmp_path)
    with pytest.raises(LinkError, match=r"no parameter file .*missing\.parm"):
        ArduCopter(binary, tmp_path, defaults=[tmp_path / "missing.parm"])


def test_a_port_in_use_is_seen():
    with socket.socket() as other:
        for instance in range(100, 200):
            if port_is_free(instance):
                other.bind(("127.0.0.1", 5760 + 10 * instance))
                other.listen()
                assert not port_is_free(instance)
                return
    raise AssertionError("every port is taken")
