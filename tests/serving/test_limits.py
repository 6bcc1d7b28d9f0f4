"""Connections: how many there may be, and what becomes of them when the server stops."""

import contextlib
import gc
import http.client
import socket

import pytest
from policy_clients import Client
from served_pilots import TOKEN, served

from cognitivedrone.serving import server
from cognitivedrone.serving.access import token_of
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import serving


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
