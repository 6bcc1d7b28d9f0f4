"""The command `serve`: what it prints and needs, how many connections there may be, and what becomes of them."""

import ast
import contextlib
import gc
import http.client
import logging
import re
import socket
import subprocess
import sys
from urllib.parse import urlsplit

import pytest
from policy_clients import Client, observation
from served_pilots import TOKEN, served

from cognitivedrone import errors
from cognitivedrone.cli import main
from cognitivedrone.policies import make_policy
from cognitivedrone.serving import server
from cognitivedrone.serving.access import token_of
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import Address, announced, logging_to_stderr, serving


def has_ipv6() -> bool:
    """Whether this machine has a loopback of IPv6; containers often have none."""
    try:
        with socket.create_server(("::1", 0), family=socket.AF_INET6):
            return True
    except OSError:
        return False


def test_it_serves_until_it_is_stopped_and_says_how_to_call_it(tiny_model_file):
    command = [sys.executable, "-m", "cognitivedrone", "serve", "--policy", f"small:{tiny_model_file}", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        first, *more = (process.stdout.readline() for _ in range(5))
        address = first.partition("ws://")[2].split()[0]
        assert first.startswith("serving small:")
        with Client(address) as client:
            assert client.ask(observation())["actions"].shape == (2, 4)
            assert "Traceback" not in client.ask({})
        process.terminate()
        _, log = process.communicate(timeout=60)
    assert process.returncode == 130
    assert any(f"--policy remote:ws://{address}" in line for line in more)
    assert "missing_field" in log
    assert "Traceback" not in log


def test_it_tells_other_machines_where_they_find_it():
    plan = ServePlan.of(policy="small", reasoner="small", host="0.0.0.0")  # noqa: S104
    lines = announced(plan, Address(plan.host, 8000, needs_token=True))
    assert "bench --policy remote:ws://ADDRESS-OF-THIS-MACHINE:8000 --reasoner remote:ws://ADDRESS" in lines
    assert "COGNITIVEDRONE_SERVER_TOKEN" in lines
    assert str(Address("::1", 80)) == "[::1]:80"


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
@pytest.mark.parametrize("host", ["::1", "[::1]"])
def test_an_address_of_ipv6_is_announced_as_clients_need_it(host):
    with serving(ServePlan.of(policy="hover", host=host, port=0)) as address:
        lines = announced(ServePlan.of(policy="hover", host=host), address)
        policy = make_policy(f"remote:ws://{address}")
        policy.check()
        policy.close()
    (argument,) = re.findall(r"WebsocketClientPolicy\((.*)\)", lines)
    host, port = ast.literal_eval(argument)
    uri = urlsplit(f"ws://{host}:{port}")  # as openpi's client makes it
    assert (uri.hostname, uri.port) == ("::1", address.port)
    assert all(urlsplit(found).hostname == "::1" for found in re.findall(r"(?:ws|http)://\S+", lines))


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "0:0:0:0:0:0:0:0", ""])  # noqa: S104
def test_an_address_that_means_all_is_not_announced_as_one_to_connect_to(host):
    lines = announced(ServePlan.of(policy="hover", host=host), Address(host, 8000)).splitlines()
    assert all("ADDRESS-OF-THIS-MACHINE" in line for line in lines[1:])


def test_the_log_is_as_it_was_afterwards(capsys):
    logger = logging.getLogger("cognitivedrone.serving")
    before = logger.level, logger.propagate, list(logger.handlers)
    with logging_to_stderr():
        logger.getChild("app").info("hello")
    assert capsys.readouterr().err.endswith("INFO hello\n")
    assert (logger.level, logger.propagate, list(logger.handlers)) == before


def test_without_the_extra_it_says_so_in_one_sentence(monkeypatch, capsys):
    real = errors.importlib.import_module

    def absent(name, *more):
        if name == "uvicorn":
            raise ModuleNotFoundError(name=name)
        return real(name, *more)

    monkeypatch.setattr(errors.importlib, "import_module", absent)
    with pytest.raises(SystemExit, match=r"^2$"):
        main(["serve"])
    assert "serve" in capsys.readouterr().err


@pytest.mark.parametrize("option", [["--port", "70000"], ["--host", "192.0.2.1"], ["--policy", "oracle"]])
def test_what_it_cannot_do_ends_in_one_sentence(option, capsys, monkeypatch):
    monkeypatch.delenv("COGNITIVEDRONE_SERVER_TOKEN", raising=False)
    with pytest.raises(SystemExit, match=r"^2$"):
        main(["serve", *option])
    output = capsys.readouterr().err
    assert output.startswith("cognitivedrone: ")
    assert output.count("\n") == 1


def test_pings_are_answered():
    with served() as address, Client(address) as client:
        assert client.socket.ping(b"still there?").wait(60)


def test_a_connection_too_many_is_answered_so(monkeypatch):
    monkeypatch.setattr(server, "MOST_WAITING", 1)
    with served(clients=1) as address, contextlib.ExitStack() as stack:
        for _ in range(2):
            stack.enter_context(socket.create_connection((address.host, address.port), 60))
        with contextlib.closing(http.client.HTTPConnection(address.host, address.port, timeout=60)) as asked:
            asked.request("GET", "/healthz")
            assert asked.getresponse().status == 503


def test_a_server_that_stops_leaves_no_connection_open():
    """Neither one that was answered, nor one that never finished its request."""
    with contextlib.ExitStack() as stack:
        with serving(ServePlan(port=0)) as address:
            made = [stack.enter_context(socket.create_connection((address.host, address.port), 60)) for _ in range(5)]
            made[0].sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
            assert made[0].recv(4096).startswith(b"HTTP/1.1 200")
            made[1].sendall(b"GET /hea")
        for one in made:
            with contextlib.suppress(ConnectionResetError):
                while one.recv(4096):
                    pass


def test_a_connection_that_is_being_accepted_when_the_server_stops_is_closed():
    """An open socket would warn where it is collected, which fails the test that runs at that time."""
    with contextlib.ExitStack() as stack:
        for _ in range(10):
            with serving(ServePlan(port=0)) as address:
                for _ in range(20):
                    stack.enter_context(socket.create_connection((address.host, address.port), 60))
    gc.collect()


def test_a_token_that_everybody_can_read_gets_a_warning(tmp_path):
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    assert token_of("127.0.0.1", token) == TOKEN
    token.chmod(0o644)
    with pytest.warns(UserWarning, match=r"can be read by every user of this machine; .*chmod 600"):
        assert token_of("127.0.0.1", token) == TOKEN
