"""Attacks over the network: clients that hold, flood and guess, and servers that are silent, endless and false.

Run: python benchmarks/network_attacks.py [--only WORDS] [--out results/network_attacks.json]

Every attack is on loopback, and bounded in count and time. An attack on a server holds if a client with the token
still flies; one on a client holds if it ends in one sentence. Prints one line per attack; exits with 1 if one falls.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import hashlib
import json
import os
import socket
import struct
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fuzz_server import Failed, Peer
from hostile_messages import HANDSHAKE, frame
from served import memory_mb, server_process

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.policies import make_policy
from cognitivedrone.remote import connection
from cognitivedrone.remote.codec import pack
from cognitivedrone.remote.messages import TOKEN_VARIABLE
from cognitivedrone.text.printable import unprintable
from cognitivedrone.types import EpisodeContext, Observation

TOKEN = "the-token-of-the-attacked-0123456789"  # noqa: S105
IDLE = 300
"""Idle connections of an attack; a server keeps fewer."""
SESSIONS = 2000
MOST_SENT = 64 << 20
MOST_GROWTH_MB = 100
LONGEST = 2000
"""A sentence has fewer characters."""
PATIENCE_S = 40.0
"""A client must fly, and an attack on a client must end, by then."""

HEALTH = b"GET /healthz HTTP/1.1\r\nHost: x\r\n"
UPGRADE = HANDSHAKE.encode().rstrip() + b"\r\n"
INSTRUCTION = "Fly through the red gate"
SEEN = Observation(np.zeros((256, 256, 3), np.uint8), INSTRUCTION, np.zeros(3, np.float32), 1.0, 0.0, 0.0)


class NetworkAttack(NamedTuple):
    """One attack."""

    name: str
    held: Callable[[], bool]

    @property
    def kind(self) -> str:
        """The kind of the attack: all are of one."""
        return "network"

    def run(self, _folder: Path) -> str:
        """Why it fell; an empty text if it held."""
        return "" if self.held() else "the client does not fly, or the attack does not end in one sentence"


def attacks() -> list[NetworkAttack]:
    """All attacks: name, and a function that returns whether the package held."""
    return [
        *(NetworkAttack(f"idle: {name}", held) for name, held in _idle().items()),
        *(NetworkAttack(f"flood: {name}", held) for name, held in _floods().items()),
        *(NetworkAttack(f"token: {name}", held) for name, held in _tokens().items()),
        NetworkAttack("sessions: another server's session", lambda: _refused({"session": "0" * 16})),
        NetworkAttack("sessions: two models on two servers", _two_servers),
        NetworkAttack(f"sessions: {SESSIONS} one after the other", _many_sessions),
        *(NetworkAttack(f"server: {name}", held) for name, held in _servers().items()),
    ]


@contextlib.contextmanager
def _server(*options: str) -> Iterator[tuple[int, int]]:
    """A server with a token, in a process of its own: port and process id."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "token")
        file.write_text(TOKEN)
        words = ("--policy", "hover", "--clients", "8", "--token-file", str(file))
        with server_process(*words, *options) as (port, process):
            yield port, process.pid


@contextlib.contextmanager
def _with_token() -> Iterator[None]:
    before = os.environ.get(TOKEN_VARIABLE)
    os.environ[TOKEN_VARIABLE] = TOKEN
    try:
        yield
    finally:
        os.environ.pop(TOKEN_VARIABLE)
        if before is not None:
            os.environ[TOKEN_VARIABLE] = before


def _act(address: str, **options: object) -> np.ndarray[Any, Any]:
    """One command of the policy at an address."""
    given = {"patience": PATIENCE_S, "warm_up": 0} | options
    policy = make_policy(f"remote:{address}" + "".join(f",{name}={value}" for name, value in given.items()))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            policy.check()
            policy.reset(EpisodeContext(INSTRUCTION))
            return np.asarray(policy.act(SEEN))
    finally:
        policy.close()


def _flies(port: int) -> bool:
    with _with_token():
        try:
            return bool(_act(f"ws://127.0.0.1:{port}").shape == (1, 4))
        except CognitiveDroneError:
            return False


def _idle() -> Mapping[str, Callable[[], bool]]:
    """Connections that ask for nothing, or never finish asking."""
    answered = HEALTH + b"\r\n"
    kinds = {
        "silent": (b"", b""),
        "one byte": (b"G", b""),
        "half a request": (HEALTH, b""),
        "half a header": (b"GET / HTTP/1.1\r\nX: " + b"x" * 5000, b""),
        "half a second request": (answered, b"G"),
        "half a body of a request that was answered": (HEALTH + b"Content-Length: 9\r\n\r\n", b"x"),
        "half a chunk of one": (HEALTH + b"Transfer-Encoding: chunked\r\n\r\n", b"5\r\nx"),
        "an upgrade with a header over 8 kB": (UPGRADE + b"X: " + b"x" * 9000 + b"\r\n\r\n", b""),
        "an upgrade with a length": (UPGRADE + b"Content-Length: 5\r\n\r\n", b""),
        "an upgrade with chunks": (UPGRADE + b"Transfer-Encoding: chunked\r\n\r\n", b""),
        "an upgrade with 200 headers": (UPGRADE + b"X: x\r\n" * 200 + b"\r\n", b""),
        "half an upgrade": (UPGRADE, b""),
        "an upgrade without the token": (UPGRADE + b"\r\n", b""),
        "a posted body that does not come": (b"POST /act HTTP/1.1\r\nHost: x\r\nContent-Length: 99\r\n\r\n", b""),
    }
    return {name: partial(_holds, first, then) for name, (first, then) in kinds.items()}


def _holds(first: bytes, then: bytes) -> bool:
    """Whether a client flies while so many connections are idle."""
    with _server() as (port, _), contextlib.ExitStack() as stack:
        for _ in range(IDLE):
            with contextlib.suppress(OSError):
                made = stack.enter_context(socket.create_connection(("127.0.0.1", port), PATIENCE_S))
                made.sendall(first)
                if then:
                    made.recv(1 << 12)
                    made.sendall(then)
        return _flies(port)


def _floods() -> Mapping[str, Callable[[], bool]]:
    ping = struct.pack("!BBI", 0x89, 0x80 | 125, 0) + bytes(125)
    return {
        "pings of a client that never reads": lambda: _flooded(ping * 1000, upgrade=True),
        "empty messages of a client that never reads": lambda: _flooded(frame(b"") * 1000, upgrade=True),
        "requests of a client that never reads": lambda: _flooded((HEALTH + b"\r\n") * 1000, upgrade=False),
        "a header without end": lambda: _flooded(b"x" * (1 << 16), upgrade=False, first=b"GET / HTTP/1.1\r\nX: "),
    }


def _flooded(piece: bytes, *, upgrade: bool, first: bytes = b"") -> bool:
    """Whether a client flies meanwhile, and the server's memory stays what it was."""
    with _server() as (port, pid), socket.socket() as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        made.settimeout(5)
        made.connect(("127.0.0.1", port))
        key = f"Authorization: Api-Key {TOKEN}\r\n".encode()
        made.sendall(UPGRADE + key + b"\r\n" if upgrade else first)
        before = memory_mb(pid)
        with contextlib.suppress(OSError):  # it cuts us off, or reads no more
            for _ in range(MOST_SENT // len(piece)):
                made.sendall(piece)
        return _flies(port) and memory_mb(pid) - before < MOST_GROWTH_MB


def _tokens() -> Mapping[str, Callable[[], bool]]:
    """Headers that are not the token's."""
    wrong = {
        "none": "",
        "a beginning": f"Authorization: Api-Key {TOKEN[:-1]}\r\n",
        "more than it": f"Authorization: Api-Key {TOKEN}x\r\n",
        "another scheme": f"Authorization: Basic {TOKEN}\r\n",
        "without a scheme": f"Authorization: {TOKEN}\r\n",
        "in the address": "X-Token: " + TOKEN + "\r\n",
        "not ASCII": "Authorization: Api-Key \xe9\r\n",
        "of a web page": f"Authorization: Api-Key {TOKEN}\r\nOrigin: http://a.page\r\n",
    }
    return {name: partial(_unauthorized, header) for name, header in wrong.items()}


def _unauthorized(header: str) -> bool:
    with _server() as (port, _):
        peer = Peer(port)
        peer.send(UPGRADE + header.encode("latin-1") + b"\r\n")
        answer = peer.rest()
        peer.close()
        return b" 401 " in answer and TOKEN.encode() not in answer and _flies(port)


def _refused(changed: dict[str, object]) -> bool:
    """Whether a message with these fields ends its session."""
    with server_process("--policy", "hover") as (port, _):
        peer = Peer(port)
        peer.handshake()
        seen = {"observation/image": SEEN.image, "observation/state": np.zeros(5), "prompt": INSTRUCTION}
        peer.send(frame(pack(seen | changed)))
        answer = peer.frame()
        peer.close()
        return answer is not None and b"unknown_session" in answer[1]


def _two_servers() -> bool:
    """A session of one server means nothing on another, and both answer as their own policy does."""
    with server_process("--policy", "hover") as (one, _), server_process("--policy", "random") as (other, _):
        first, second = (_act(f"ws://127.0.0.1:{port}") for port in (one, other))
        return not np.array_equal(first, second) and np.array_equal(first, _act(f"ws://127.0.0.1:{one}"))


def _many_sessions() -> bool:
    """Sessions one after the other, each with an id of its own; the server's memory stays what it was."""
    ids = set()
    with server_process("--policy", "hover") as (port, process):
        for number in range(SESSIONS):
            peer = Peer(port)
            peer.send(HANDSHAKE.encode())
            while b"\r\n\r\n" not in peer._got and (piece := peer._receive()):
                peer._got += piece
            peer._got = peer._got.partition(b"\r\n\r\n")[2]
            metadata = peer.frame()
            peer.close()
            if metadata is None:
                raise Failed("no metadata")
            ids.add(metadata[1].partition(b"session")[2][:17])
            if number == SESSIONS // 10:
                before = memory_mb(process.pid)
        grown = memory_mb(process.pid) - before
        descriptors = len(list(Path(f"/proc/{process.pid}/fd").iterdir()))
    return len(ids) == SESSIONS and grown < MOST_GROWTH_MB / 5 and descriptors < MOST_GROWTH_MB


def _servers() -> Mapping[str, Callable[[], bool]]:
    """What a false server sends: before the handshake, as metadata, and as the answer to an observation."""
    deep: Any = []
    for _ in range(2000):
        deep = [deep]
    array = {b"__ndarray__": True, b"dtype": "<f4", b"shape": [1 << 30, 4], b"data": b""}
    told = {"error": {"code": "policy_error", "message": "\ud800\x1b[31m\u202e" * 50}}
    before = {
        "never answers": b"",
        "another protocol": b"SSH-2.0-x\r\n",
        "a page": b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nhi",
        "a redirect": b"HTTP/1.1 302 Found\r\nLocation: ws://127.0.0.1:9/\r\nContent-Length: 0\r\n\r\n",
        "a header without end": b"HTTP/1.1 101 Switching Protocols\r\nX: " + b"x" * (8 << 20),
    }
    metadata: dict[str, list[bytes | str]] = {
        "no metadata": [],
        "metadata of 40 MB": [pack({"x": bytes(40 << 20)})],
        "metadata that are text": ["\x1b[31m" + "x" * 100_000],
        "metadata that are a list": [pack([1, 2])],
        "metadata that are noise": [b"\xc1" * 1000],
        "another version": [pack({"cognitivedrone": {"protocol": "\x1b[31m" * 9}})],
    }
    answers: dict[str, bytes | str] = {
        "an answer of 40 MB": pack({"actions": bytes(40 << 20)}),
        "an answer of an untrue size": pack({"actions": array}),
        "a deep answer": b"\x91" * 100_000,
        "an answer without actions": pack({}),
        "an error that no file takes": json.dumps(told),
        "an error without end": "x" * (1 << 20),
        "a policy's error without end": json.dumps({"error": {"code": "policy_error", "message": "x\n" * (1 << 19)}}),
        "actions that are no numbers": pack({"actions": np.zeros(3, bool)}),
    }
    found: dict[str, Callable[[], bool]] = {name: partial(_ends, sent, None) for name, sent in before.items()}
    found |= {name: partial(_ends, None, sent) for name, sent in metadata.items()}
    return found | {name: partial(_ends, None, [pack({}), sent]) for name, sent in answers.items()}


def _ends(raw: bytes | None, messages: Sequence[Any] | None) -> bool:
    """Whether a flight with such a server ends by then, in one sentence that any file takes."""
    began, connect_s, greeting_s = time.monotonic(), connection.CONNECT_S, connection.GREETING_S
    connection.CONNECT_S, connection.GREETING_S = 1.0, 2.0
    try:
        with _false_server(raw, messages) as address:
            _act(address, patience=2)
    except CognitiveDroneError as error:
        said = str(error)
        said.encode()
        return time.monotonic() - began < PATIENCE_S and len(said) < LONGEST and not unprintable(said)
    finally:
        connection.CONNECT_S, connection.GREETING_S = connect_s, greeting_s
    return False


@contextlib.contextmanager
def _false_server(raw: bytes | None, messages: Sequence[bytes | str] | None) -> Iterator[str]:
    """A server below the libraries: it sends `raw` whatever comes, or shakes hands and sends the messages in turn."""
    stopping = threading.Event()

    def speak(made: socket.socket) -> None:
        with contextlib.suppress(OSError), made:
            head = made.recv(1 << 16)
            if raw is not None:
                made.sendall(raw)
            else:
                made.sendall(_accepted(head))
                for number, message in enumerate(messages or ()):
                    if number:
                        made.recv(1 << 16)
                    data = message.encode() if isinstance(message, str) else message
                    made.sendall(frame(data, 1 if isinstance(message, str) else 2, masked=False))
            stopping.wait(PATIENCE_S)

    def accept() -> None:
        with contextlib.suppress(OSError):
            while True:
                threading.Thread(target=speak, args=(server.accept()[0],), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=accept, daemon=True).start()
        try:
            yield f"ws://127.0.0.1:{server.getsockname()[1]}"
        finally:
            stopping.set()
            server.shutdown(socket.SHUT_RDWR)


def _accepted(head: bytes) -> bytes:
    key = head.partition(b"Sec-WebSocket-Key: ")[2].partition(b"\r\n")[0]
    accept = base64.b64encode(hashlib.sha1(key + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest())  # noqa: S324
    upgraded = b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    return upgraded + b"Sec-WebSocket-Accept: " + accept + b"\r\n\r\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", help="attacks whose name contains these words")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    arguments = parser.parse_args()
    chosen = [attack for attack in attacks() if arguments.only in attack.name]
    results = []
    for attack in chosen:
        results.append(attack.held())
        print(f"{'held' if results[-1] else 'FELL':5} {attack.name}", flush=True)
    print(f"{sum(results)} of {len(results)} held")
    row = {"attacks": len(results), "held": sum(results)}
    keep(arguments.out, "Attacks over the network, and what held", [row])
    sys.exit(0 if all(results) else 1)


if __name__ == "__main__":
    main()
