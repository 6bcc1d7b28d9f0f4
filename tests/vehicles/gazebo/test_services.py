"""The process that calls services: a true one, with a gz-transport that is written here."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from cognitivedrone.errors import GazeboError
from cognitivedrone.vehicles.gazebo.bindings import MODULES, ServiceProcess

TRANSPORT = """
import os
print("gz-transport prints this")
class Node:
    def request(self, service, request, asks, answers, timeout):
        if service == "/end":
            os._exit(3)
        if service == "/silent":
            return False, answers()
        return True, answers(f"{service} {asks.__name__} {request.data} {timeout}")
"""
MESSAGE = """
class {name}:
    def __init__(self, data=""):
        self.data = data
    def ParseFromString(self, data):
        self.data = data.decode()
    def SerializeToString(self):
        return self.data.encode()
"""


@pytest.fixture
def services(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ServiceProcess]:
    """A process with bindings of Harmonic."""
    package = tmp_path / "gz"
    (package / "msgs10").mkdir(parents=True)
    (package / "transport13.py").write_text(TRANSPORT)
    for name, module in MODULES.items():
        (package / "msgs10" / f"{module}.py").write_text(MESSAGE.format(name=name))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    process = ServiceProcess("harmonic")
    yield process
    process.close()


def test_a_call_goes_through_and_the_reply_comes_back(services):
    assert services.request("/echo", b"hello", "Pose", "Boolean", 250) == b"/echo Pose hello 250"
    assert services.request("/silent", b"", "Empty", "Boolean", 250) is None
    assert services.request("/echo", b"again", "Entity", "Boolean", 9) == b"/echo Entity again 9"


def test_a_process_that_ended_is_reported(services):
    with pytest.raises(GazeboError, match="the process that calls Gazebo's services ended"):
        services.request("/end", b"", "Empty", "Boolean", 250)


def test_it_ends_with_us_and_not_by_ctrl_c(services):
    process = services._process
    assert os.getpgid(process.pid) != os.getpgid(0)
    services.close()
    assert process.returncode == 0
