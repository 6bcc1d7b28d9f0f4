"""Sends hostile messages to a policy server, and checks that each is answered with an error code or closed.

Run: python benchmarks/fuzz_server.py [--messages 10000] [--seed 0] [--out results/serving_hostile.json]

The messages are made from the wire grammar (`hostile_messages.py`), with something wrong at one level: the HTTP
request, websocket frames, msgpack, the observation's fields, REST's JSON. Meanwhile a witness keeps flying on a session
of its own: its answers must stay right. Prints how the messages ended; exits with 1 after a crash, a hang, a disturbed
witness or a leaked traceback.
"""

from __future__ import annotations

import argparse
import base64
import json
import random
import socket
import struct
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from hostile_messages import (
    BINARY,
    CLOSE,
    DTYPES,
    HANDSHAKE,
    IMAGE,
    OBSERVATION,
    SHAPES,
    TEXT,
    VALUES,
    frame,
    mutated,
    one_message,
)
from served import memory_mb, server_process

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.remote.codec import pack, unpack

ANSWER_S = 60.0
"""A server that has neither answered nor closed by then hangs."""
PING, PONG = 9, 10
_POST = b"POST /act HTTP/1.1\r\nHost: x\r\n"
_CHUNKS = (b"zz\r\n", b"ffffffffff\r\n{}", b"2\r\n{}\r\n")


class Failed(Exception):
    """The server did what it must not."""


class Peer:
    """A client below the libraries: it sends any bytes."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), ANSWER_S)
        self._got = b""

    def send(self, data: bytes) -> None:
        # It may close while we are still sending: what it says counts.
        with suppress(BrokenPipeError, ConnectionResetError):
            self._socket.sendall(data)

    def half_close(self) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)

    def read(self, count: int) -> bytes:
        """So many bytes, or fewer at the end."""
        while len(self._got) < count and (piece := self._receive()):
            self._got += piece
        found, self._got = self._got[:count], self._got[count:]
        return found

    def rest(self) -> bytes:
        """Everything until the server closes."""
        while piece := self._receive():
            self._got += piece
        return self._got

    def frame(self) -> tuple[int, bytes] | None:
        """The server's next message; none where it has closed."""
        while len(head := self.read(2)) == 2:
            length = head[1] & 127
            if length >= 126:
                length = int.from_bytes(self.read(2 if length == 126 else 8), "big")
            data = self.read(length)
            if head[0] & 15 == PING:
                self.send(frame(data, PONG))
            elif head[0] & 15 != PONG:
                return head[0] & 15, data
        return None

    def handshake(self) -> None:
        self.send(HANDSHAKE.encode())
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            byte = self.read(1)
            if not byte:
                raise Failed(f"no handshake: {head!r}")
            head += byte
        if b" 101 " not in head:
            raise Failed(f"no handshake: {head!r}")
        metadata = self.frame()
        if metadata is None or "cognitivedrone" not in unpack(metadata[1]):
            raise Failed(f"no metadata: {metadata!r:.200}")

    def close(self) -> None:
        self._socket.close()

    def _receive(self) -> bytes:
        try:
            return self._socket.recv(1 << 16)
        except ConnectionResetError:
            return b""
        except TimeoutError:
            raise Failed("the server neither answers nor closes") from None


def converse(port: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """Some malformed messages in whole frames, on one connection; each must be answered."""
    peer = Peer(port)
    peer.handshake()
    for _ in range(rng.randrange(1, 20)):
        kind, data = one_message(rng)
        opcode = rng.choice((BINARY, BINARY, BINARY, TEXT))
        peer.send(frame(data, opcode))
        answer = peer.frame()
        yield kind, outcome(answer)
        if answer is None or answer[0] == CLOSE or outcome(answer) in ("protocol_version", "unknown_session"):
            break
    peer.close()


def outcome(answer: tuple[int, bytes] | None) -> str:
    """How the server answered."""
    if answer is None:
        return "closed"
    opcode, data = answer
    if opcode == CLOSE:
        return f"closed {int.from_bytes(data[:2], 'big')}" if data else "closed"
    if opcode == BINARY:
        return "answered"  # what was wrong did not matter
    if b"Traceback" in data or b'File "' in data:
        raise Failed(f"a traceback leaks: {data!r:.300}")
    code = str(json.loads(data)["error"]["code"])
    if code == "internal":
        raise Failed(f"an error that the server did not expect: {data!r:.300}")
    return code


def framed(port: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """Malformed frames; then we stop sending, and the server must close."""
    good = pack(OBSERVATION)
    peer = Peer(port)
    peer.handshake()
    piece = rng.randrange(1, len(good))
    kind, data = rng.choice(
        [
            ("reserved opcode", frame(b"x", rng.choice((3, 4, 7, 11, 15)))),
            ("reserved bits", frame(b"x", rsv=rng.randrange(1, 8))),
            ("not masked", frame(b"x", masked=False)),
            ("cut frame", frame(good)[:piece]),
            ("huge length", frame(b"x", length=rng.choice((2**20 + 1, 2**31, 2**40, 2**63 - 1, 2**63, 2**64 - 1)))),
            ("large message", frame(bytes(1_100_000))),
            ("cut fragments", frame(good[:piece], fin=False)),
            ("never-ending fragments", frame(b"", fin=False) + frame(b"", 0, fin=False) * 5000),
            ("continuation of nothing", frame(b"x", 0)),
            ("message within a message", frame(good[:piece], fin=False) + frame(good)),
            ("long ping", frame(bytes(126), 9)),
            ("fragmented ping", frame(b"x", 9, fin=False)),
            ("many pings", frame(b"x", 9) * 500),
            ("invalid close", frame(rng.choice((b"x", struct.pack("!H", 999), b"\x03\xe8\xff")), CLOSE)),
            ("invalid text", frame(b"\xff\xfe", TEXT)),
            ("mutated frames", mutated(frame(good[:300]) + frame(b"x", 9), rng)),
            ("random bytes", rng.randbytes(rng.randrange(1, 500))),
            ("messages without waiting", frame(b"\xc0") * rng.randrange(2, 200)),
        ]
    )  # fmt: skip
    peer.send(data)
    peer.half_close()
    peer.rest()
    peer.close()
    yield f"frames: {kind}", "closed"


def spoken_http(port: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """Malformed requests."""
    kind, data = rng.choice(
        [
            ("mutated handshake", mutated(HANDSHAKE.encode(), rng)),
            ("half a handshake", HANDSHAKE.encode()[: rng.randrange(1, len(HANDSHAKE))]),
            ("long header", b"GET / HTTP/1.1\r\nX: " + b"x" * 100_000),
            ("many headers", b"GET / HTTP/1.1\r\n" + b"X: x\r\n" * 20_000),
            ("long path", b"GET /" + b"x" * 100_000 + b" HTTP/1.1\r\n\r\n"),
            ("other method", b"%s /act HTTP/1.1\r\nHost: x\r\n\r\n" % rng.choice((b"PUT", b"TRACE", b"CONNECT", b"X"))),
            ("lying length", _POST + b"Content-Length: %d\r\n\r\n{}" % rng.choice((5, 10**9, 10**30, -1))),
            ("bad chunks", _POST + b"Transfer-Encoding: chunked\r\n\r\n" + rng.choice(_CHUNKS)),
            ("random bytes", rng.randbytes(rng.randrange(1, 2000))),
            ("TLS", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + rng.randbytes(200)),
        ]
    )  # fmt: skip
    peer = Peer(port)
    peer.send(data)
    peer.half_close()
    answer = peer.rest()
    peer.close()
    yield (
        f"http: {kind}",
        f"status {answer[9:12].decode(errors='replace')}" if answer.startswith(b"HTTP/") else "closed",
    )


def posted(port: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """Malformed requests to /act."""
    image = {"__numpy__": base64.b64encode(IMAGE[:64, :64].tobytes()).decode(), "dtype": "|u1", "shape": [64, 64, 3]}
    request: dict[str, Any] = {"image": image, "instruction": "Fly", "unnorm_key": None, "state": image}
    name = rng.choice((*request, "encoded"))
    plain = [
        value for value in VALUES if isinstance(value, str | int | float | list | dict | None) and not _has_array(value)
    ]
    match rng.randrange(4):
        case 0:
            request.pop(name, None)
        case 1:
            request[name] = rng.choice(plain)
        case 2:
            request["image"] = image | {
                rng.choice(("__numpy__", "dtype", "shape")): rng.choice((*plain, *DTYPES[:6], *SHAPES[:6]))
            }
        case _:
            request = {"encoded": mutated(json.dumps(request).encode(), rng).decode("latin-1")}
    body = json.dumps(request).encode()
    if rng.random() < 0.5:
        body = mutated(body, rng)
    peer = Peer(port)
    peer.send(b"POST /act HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
    head, _, content = peer.rest().partition(b"\r\n\r\n")
    peer.close()
    if not head.startswith(b"HTTP/1.1 "):
        raise Failed(f"no answer to a request: {head!r:.100}")
    status = head[9:12].decode()
    yield "REST", "answered" if status == "200" else outcome((TEXT, content))


def _has_array(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(item, np.ndarray) for item in value)


KINDS: list[Callable[[int, random.Random], Iterator[tuple[str, str]]]] = [converse, framed, spoken_http, posted]


class Witness(threading.Thread):
    """A client that keeps flying: its answers must stay right."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self._peer = Peer(port)
        self._peer.handshake()
        self._stopping = threading.Event()
        self.took_s: list[float] = []
        self.error = ""

    def run(self) -> None:
        message = frame(
            pack({name: OBSERVATION[name] for name in ("observation/image", "observation/state", "prompt")})
        )
        expected: list[Any] | None = None
        try:
            while not self._stopping.wait(0.02):
                began = time.monotonic()
                self._peer.send(message)
                answer = self._peer.frame()
                self.took_s.append(time.monotonic() - began)
                if answer is None or answer[0] != BINARY:
                    raise Failed(f"the witness was answered {answer!r:.200}")
                actions = unpack(answer[1])["actions"].tolist()
                expected = expected or actions
                if actions != expected:
                    raise Failed(f"the witness was answered {actions}, expected {expected}")
        except Exception as error:
            self.error = f"{type(error).__name__}: {error}"

    def stop(self) -> None:
        self._stopping.set()
        self.join(2 * ANSWER_S)
        self._peer.close()


def fuzz(port: int, messages: int, seed: int) -> tuple[Counter[tuple[str, str]], Witness]:
    """Send at least so many messages; raises `Failed`."""
    rng = random.Random(seed)
    counts: Counter[tuple[str, str]] = Counter()
    witness = Witness(port)
    witness.start()
    while counts.total() < messages:
        kind = rng.choice(KINDS)
        try:
            for found in kind(port, rng):
                counts[found] += 1
        except Failed as failure:
            raise Failed(f"{kind.__name__}, message {counts.total()} of seed {seed}: {failure}") from None
        if witness.error:
            raise Failed(f"after {counts.total()} messages: {witness.error}")
    witness.stop()
    if witness.error or not witness.took_s:
        raise Failed(f"the witness did not fly: {witness.error}")
    return counts, witness


def summed(by_outcome: Counter[str]) -> dict[str, int]:
    """The outcomes in four sums."""
    sums = dict.fromkeys(("with_code", "closed", "with_status", "answered"), 0)
    for how, count in by_outcome.items():
        first = how.split()[0]
        sums[{"closed": "closed", "status": "with_status", "answered": "answered"}.get(first, "with_code")] += count
    return sums


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--policy", default="small")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    arguments = parser.parse_args()
    with server_process("--policy", arguments.policy) as (port, process):
        before = memory_mb(process.pid)
        began = time.monotonic()
        try:
            counts, witness = fuzz(port, arguments.messages, arguments.seed)
            if process.poll() is not None:
                raise Failed(f"the server ended with {process.returncode}")
        except Failed as failure:
            sys.exit(f"failed: {failure}")
        took_s, after = time.monotonic() - began, memory_mb(process.pid)
    by_outcome: Counter[str] = Counter()
    for (kind, how), count in sorted(counts.items()):
        by_outcome[how] += count
        print(f"{count:7d}  {kind:32} {how}")
    print(
        f"{counts.total()} messages in {took_s:.0f} s: "
        + ", ".join(f"{count} {how}" for how, count in by_outcome.most_common())
    )
    median, slow = np.percentile(witness.took_s, [50, 99]) * 1e3
    print(f"witness: {len(witness.took_s)} answers, all right, {median:.1f} ms median, {slow:.1f} ms p99")
    print(f"memory of the server: {before:.0f} MB before, {after:.0f} MB after")
    row = {
        "messages": counts.total(),
        **summed(by_outcome),
        "witness_answers": len(witness.took_s),
        "witness_ms": [round(float(median), 1), round(float(slow), 1)],
        "memory_mb": [round(before), round(after)],
    }
    keep(arguments.out, "Hostile messages to a policy server", [row], seed=arguments.seed)


if __name__ == "__main__":
    main()
