"""The client's connection: servers that are cold, busy, silent, too talkative, or behind a proxy."""

import contextlib
import functools
import gc
import socket
import threading
import warnings

import numpy as np
import pytest
import websockets.asyncio.client
from policy_clients import openpi_server
from websockets.utils import accept_key

from cognitivedrone.cli import main
from cognitivedrone.errors import PluginError, ReasonerError, ServerError
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.remote import connection
from cognitivedrone.remote.faults import proxy_hint
from cognitivedrone.types import EpisodeContext, Observation

BEGIN = EpisodeContext("Fly through the red gate")
SEEN = Observation(np.zeros((256, 256, 3), np.uint8), BEGIN.instruction, np.zeros(3, np.float32), 1.0, 0.0, 0.0)
STILL = {"actions": np.zeros((1, 4))}


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """Nothing waits for long between two attempts."""
    monkeypatch.setattr(connection, "_FIRST_WAIT_S", 0.01)
    monkeypatch.setattr(connection, "_LONGEST_WAIT_S", 0.05)


@contextlib.contextmanager
def flown(address, **options):
    policy = make_policy(f"remote:ws://{address}" + "".join(f",{name}={value}" for name, value in options.items()))
    try:
        yield policy
    finally:
        policy.close()


def pause(seconds):
    """Block the calling thread, which is the server's event loop."""
    threading.Event().wait(seconds)


def test_a_server_whose_event_loop_is_blocked_loses_no_connection(monkeypatch):
    """The keepalive of the websocket is made a hundred times as impatient; a server that works answers no ping."""
    hasty = functools.partial(websockets.asyncio.client.connect, ping_interval=0.05, ping_timeout=0.05)
    monkeypatch.setattr(websockets.asyncio.client, "connect", hasty)
    asked = []

    def infer(message):
        asked.append(message["prompt"])
        pause(0.6)
        return STILL

    with openpi_server(infer) as address, flown(address, warm_up=0) as policy, warnings.catch_warnings():
        warnings.simplefilter("error")
        policy.check()
        policy.reset(BEGIN)
        assert policy.act(SEEN).shape == (1, 4)
        assert policy.connection.count == len(asked) == 1


def test_a_cold_server_is_asked_once_before_the_first_flight(monkeypatch):
    monkeypatch.setattr(connection, "QUIET_S", 0.05)
    asked = []

    def infer(message):
        asked.append(message["prompt"])
        if len(asked) == 1:
            pause(0.3)
        return STILL

    with openpi_server(infer) as address, flown(address) as policy:
        with pytest.warns(RuntimeWarning) as expected:
            policy.check()
        assert len(asked) == 1
        assert [str(one.message).partition(" ")[2] for one in expected] == [
            f"policy server at ws://{address} works on its first answer; waiting for it, at most 600 s",
            f"policy server at ws://{address} gave its first answer after 0 s",
        ]
        policy.check()
        policy.reset(BEGIN)
        assert policy.act(SEEN).shape == (1, 4)
        assert len(asked) == 2


def test_a_server_that_never_answers_is_no_server(monkeypatch):
    go = threading.Event()

    def infer(_):
        go.wait(60)
        return STILL

    with openpi_server(infer) as address, flown(address, warm_up=0.2) as policy:
        with (
            pytest.warns(RuntimeWarning, match="works on its first answer; waiting for it, at most 0.2 s"),
            pytest.raises(ServerError, match=r"gave no first answer in 0.2 s; allow more with warm_up=SECONDS"),
        ):
            policy.check()
        go.set()


def test_an_error_as_first_answer_is_said_and_the_flight_decides():
    def infer(message):
        if not message["observation/image"].any():
            return STILL
        raise KeyError("observation/wrist_image")

    with openpi_server(infer) as address, flown(address) as policy:
        with pytest.warns(RuntimeWarning, match=r"gave an error as its first answer: .*'observation/wrist_image'"):
            policy.check()
        policy.reset(BEGIN)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it may have noticed that the server closed the connection
            assert policy.act(SEEN).shape == (1, 4)


@contextlib.contextmanager
def listening(answer=None):
    """A program that accepts connections, answers whatever comes with what `answer` makes of it, and then is silent."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        kept = []

        def accept():
            with contextlib.suppress(OSError):
                while True:
                    kept.append(server.accept()[0])
                    if answer:
                        kept[-1].sendall(answer(kept[-1].recv(1 << 16)))

        threading.Thread(target=accept, daemon=True).start()
        host, port = server.getsockname()
        try:
            yield f"{host}:{port}"
        finally:
            server.shutdown(socket.SHUT_RDWR)
            for one in kept:
                one.close()


def test_a_server_that_sends_no_metadata_is_given_up_in_one_sentence(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(connection, "CONNECT_S", 0.1)
    monkeypatch.setattr(connection, "GREETING_S", 0.3)
    with listening() as address:
        words = ["bench", "--policy", f"remote:ws://{address}", "--suite", "open-v1:smoke", "--workers", "0"]
        with pytest.raises(SystemExit) as ended:
            main([*words, "--out", str(tmp_path / "out")])
    expected = capsys.readouterr().err
    assert ended.value.code == 2
    assert f"the policy server at ws://{address} does not answer (no metadata came within 0.3 s)" in expected
    assert "Traceback" not in expected
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("status", [b"200 OK", b"404 Not Found", b"400 Bad Request"])
def test_another_kind_of_server_is_refused_at_once(status):
    answer = b"HTTP/1.1 " + status + b"\r\nContent-Length: 2\r\nConnection: close\r\n\r\nhi"
    expected = rf"is no policy server: it answers {status[:3].decode()}"
    with listening(lambda _: answer) as address, flown(address) as policy, pytest.raises(ServerError, match=expected):
        policy.check()


def test_an_answer_of_40_mb_is_refused_and_not_asked_for_again():
    asked = []

    def infer(message):
        asked.append(1)
        return {"actions": bytes(40 << 20)}

    with openpi_server(infer) as address, flown(address, warm_up=0) as policy:
        policy.check()
        policy.reset(BEGIN)
        with pytest.raises(ServerError, match="a message has over 16 MB"):
            policy.act(SEEN)
        assert asked == [1]


PROXIES = ("ws_proxy", "wss_proxy", "socks_proxy", "http_proxy", "https_proxy", "all_proxy", "no_proxy")


@pytest.fixture
def no_proxies(monkeypatch):
    for name in PROXIES:
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)
    return monkeypatch


@pytest.mark.parametrize(
    ("variable", "url", "named"),
    [
        ("https_proxy", "ws://gpu.example:8000", True),
        ("HTTPS_PROXY", "wss://gpu.example", True),
        ("http_proxy", "ws://gpu.example:8000", True),
        ("http_proxy", "wss://gpu.example", False),
        ("HTTP_PROXY", "http://gpu.example:8000/v1", True),
        ("https_proxy", "http://gpu.example:8000/v1", False),
        ("all_proxy", "https://gpu.example/v1", True),
        ("no_proxy", "ws://gpu.example:8000", False),
    ],
)
def test_the_proxy_of_a_url_is_named_by_its_variable(no_proxies, variable, url, named):
    no_proxies.setenv(variable, "http://me:secret@127.0.0.1:9")
    hint = proxy_hint(url)
    assert (f"the environment variable {variable} names" in hint) is named
    assert "secret" not in hint
    no_proxies.setenv("no_proxy", "gpu.example")
    assert proxy_hint(url) == ""


def test_a_remote_address_that_fails_names_the_proxy(no_proxies):
    no_proxies.setattr(connection, "CONNECT_S", 0.2)
    no_proxies.setenv("https_proxy", "http://me:secret@127.0.0.1:9")
    no_proxies.setenv("http_proxy", "http://me:secret@127.0.0.1:9")
    with flown("gpu.example:8000") as policy, pytest.raises(ServerError) as caught:
        policy.check()
    expected = str(caught.value)
    assert "through the proxy that the environment variable https_proxy names" in expected
    assert "set no_proxy=gpu.example" in expected
    assert "secret" not in expected
    reasoner = make_reasoner("vlm:http://gpu.example:8000/v1,model=x")
    with pytest.raises(ServerError, match="the environment variable http_proxy names"):
        reasoner.check()
    reasoner.close()
    here = make_reasoner("vlm:http://127.0.0.1:9/v1,model=x")
    with pytest.raises(ServerError) as caught, contextlib.closing(here):
        here.check()
    assert "proxy" not in str(caught.value)


@pytest.mark.parametrize("option", ["patience=0", "patience=inf", "warm_up=-1", "warm_up=nan"])
def test_times_that_will_not_do_are_named(option):
    with pytest.raises(PluginError, match=option.partition("=")[0]):
        make_policy(f"remote:ws://h:1,{option}")


def test_a_reason_of_the_servers_is_shown_without_what_no_file_takes():
    assert connection._reason(ValueError("a\ud800b\x1b")) == "a\\ud800b\\x1b"
    assert ReasonerError("http", connection._reason(ValueError())).args == ("ValueError",)


def test_a_redirect_is_not_followed_and_the_token_stays_here(monkeypatch):
    monkeypatch.setenv("COGNITIVEDRONE_SERVER_TOKEN", "the-servers-token-0123456789")
    asked = []

    def infer(message):
        asked.append(message)
        return STILL

    with openpi_server(infer) as elsewhere:
        answer = f"HTTP/1.1 302 Found\r\nLocation: ws://{elsewhere}/\r\nContent-Length: 0\r\n\r\n".encode()
        expected = "answers 302; redirects are not followed, give the new address"
        with (
            listening(lambda _: answer) as address,
            flown(address) as policy,
            pytest.raises(ServerError, match=expected),
        ):
            policy.check()
    assert asked == []


def test_a_connection_that_is_closed_while_it_closes_leaves_no_socket_open():
    """The server sent no metadata but a list, and does not answer the farewell, for which the client waits a second."""

    def shake_hands(head):
        key = head.partition(b"Sec-WebSocket-Key: ")[2].partition(b"\r\n")[0].decode()
        upgraded = b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        return upgraded + f"Sec-WebSocket-Accept: {accept_key(key)}\r\n\r\n".encode() + b"\x82\x03\x92\x01\x02"

    with listening(shake_hands) as address:
        made = connection.Connection(f"ws://{address}")
        with pytest.raises(ServerError):
            made.open(0.3)
        (thread,) = [one for one in threading.enumerate() if one.name == "policy server"]
        made.close()
        thread.join(60)
        del made
        gc.collect()  # a socket that is open would warn here
