"""The process: found, started as it should be, heard when it ends."""

import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from arducopters import script
from waiting import soon

from cognitivedrone.errors import LinkError
from cognitivedrone.sim.airframe import IRIS, RACER
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE, ArduCopter, find_binary, port_is_free, tuning


def test_the_binary_is_the_one_named_or_that_of_the_environment(tmp_path, monkeypatch):
    first, second = script(tmp_path / "first", "exit 0"), script(tmp_path / "second", "exit 0")
    monkeypatch.setenv(BINARY_VARIABLE, str(first))
    assert find_binary(None, "give one") == first
    assert find_binary(second, "give one") == second
    monkeypatch.setenv(BINARY_VARIABLE, "")
    with pytest.raises(LinkError, match=r"needs an ArduCopter binary: give one; docs/vehicles\.md"):
        find_binary(None, "give one")
    (tmp_path / "text").write_text("not a program")
    with pytest.raises(LinkError, match="text is not a program that can be run: give one"):
        find_binary(tmp_path / "text", "give one")


def test_it_is_started_with_its_parameters_in_its_folder(tmp_path):
    (tmp_path / "run").mkdir()
    theirs = tmp_path / "theirs.parm"
    theirs.write_text("A 1\n")
    binary = script(tmp_path / "arducopter", 'echo "$@"; exec sleep 60')
    options: dict[str, Any] = {"instance": 3, "defaults": [theirs], "parameters": "B 2\n", "speed": 50.0}
    with ArduCopter(binary, tmp_path / "run", **options) as running:
        assert running.url == "tcp:127.0.0.1:5790"
        reported = running.connect(lambda _: heard(running))
    assert reported.split()[:6] == ["--model", "JSON:127.0.0.1", "--instance", "3", "--speedup", "50"]
    first, ours = (Path(name) for name in reported.split()[7].split(","))
    assert first == theirs
    lines = ours.read_text().splitlines()
    assert "AHRS_EKF_TYPE 3" in lines
    assert lines[-1] == "B 2"


def heard(running: ArduCopter) -> str:
    """What it has printed; not yet there is a reason to try again."""
    reported = running.output.read_text()
    if not reported:
        raise LinkError("nothing yet")
    return reported


def refuse(url: str) -> None:
    raise LinkError(f"cannot connect to {url}")


def test_what_ends_at_once_is_reported_with_its_last_words(tmp_path):
    binary = script(tmp_path / "arducopter", "echo starting; echo no such board >&2; exit 4")
    with (
        ArduCopter(binary, tmp_path) as ended,
        pytest.raises(LinkError, match="ended with 4, its last line of output: no such"),
    ):
        ended.connect(refuse)


def test_what_cannot_be_started_is_reported(tmp_path):
    binary = tmp_path / "arducopter"
    binary.write_bytes(b"\x7fELF is not all")
    binary.chmod(0o755)
    with pytest.raises(LinkError, match=r"arducopter.*Exec format error"), ArduCopter(binary, tmp_path) as unfit:
        unfit.connect(refuse)
    with pytest.raises(LinkError, match=r"no parameter file .*missing\.parm"):
        ArduCopter(binary, tmp_path, defaults=[tmp_path / "missing.parm"])


def test_a_comma_in_a_path_does_not_name_further_parameter_files(tmp_path):
    file = tmp_path / "a,secret.parm"
    file.touch()
    with pytest.raises(LinkError, match=r"a,secret\.parm has a comma, at which ArduCopter parts names"):
        ArduCopter(tmp_path / "arducopter", tmp_path, defaults=[file])
    (tmp_path / "flight,1").mkdir()
    with pytest.raises(LinkError, match="flight,1 has a comma"):
        ArduCopter(tmp_path / "arducopter", tmp_path / "flight,1")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a program with the one that has started it")
def test_it_does_not_outlive_us(tmp_path):
    binary = script(tmp_path / "arducopter", "echo $$; exec sleep 60")
    killed = f"""
import os, pathlib, time
from cognitivedrone.vehicles.sitl.arducopter import ArduCopter
running = ArduCopter(pathlib.Path({str(binary)!r}), pathlib.Path({str(tmp_path)!r}))
while not running.output.read_text().strip():
    time.sleep(0.01)
os.kill(os.getpid(), 9)
"""
    assert subprocess.run([sys.executable, "-c", killed]).returncode == -9
    process = Path("/proc", (tmp_path / "arducopter.log").read_text().strip(), "stat")
    soon(lambda: not process.exists() or process.read_text().split()[2] == "Z")


def test_the_iris_has_arducopters_own_gains_and_others_as_much_as_they_answer_to():
    iris, racer = (dict(line.split() for line in tuning(each).splitlines()) for each in (IRIS, RACER))
    assert (iris["ATC_RAT_RLL_P"], iris["PSC_ACCZ_P"], iris["ATC_RAT_YAW_P"]) == ("0.135", "0.5", "1")
    # Where it hovered by its own account when its responses were recorded.
    assert float(iris["MOT_THST_HOVER"]) == pytest.approx(0.28, abs=0.005)
    assert float(racer["MOT_THST_HOVER"]) < 0.2
    quicker = (RACER.max_thrust * RACER.arm / RACER.inertia[0]) / (IRIS.max_thrust * IRIS.arm / IRIS.inertia[0])
    assert float(iris["ATC_RAT_RLL_P"]) / float(racer["ATC_RAT_RLL_P"]) == pytest.approx(quicker, rel=0.15)


def test_a_port_in_use_is_seen():
    with socket.socket() as other:
        for instance in range(100, 200):
            if port_is_free(instance):
                other.bind(("127.0.0.1", 5760 + 10 * instance))
                other.listen()
                assert not port_is_free(instance)
                return
    raise AssertionError("every port is taken")
