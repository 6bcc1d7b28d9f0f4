"""Hostile messages for a policy server, made from the wire grammar: valid ones with something wrong in them."""

from __future__ import annotations

import math
import random
import struct
from typing import Any

import msgpack
import numpy as np

from cognitivedrone.remote.codec import pack

HANDSHAKE = (
    "GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
TEXT, BINARY, CLOSE = 1, 2, 8
IMAGE = np.zeros((256, 256, 3), np.uint8)
OBSERVATION = {
    "observation/image": IMAGE,
    "observation/state": np.array([0.0, 0.0, 0.0, 1.0, 0.0]),
    "prompt": "Fly through the red gate",
    "time": 0.0,
    "reset": [{"prompt": "Fly", "stage": 0, "seed": 0}],
    "ask": "pilot",
    "protocol": 1,
}
VALUES: list[Any] = [
    None, True, False, 0, 1, -1, 2**63, -(2**63), 2**64 - 1, 0.0, -0.0, math.nan, math.inf, -math.inf, 1e308,
    "", "x", "x" * 70_000, "\x00", "é", "../../etc/passwd", b"", b"\xff",
    [], [[]], [None] * 4000, {}, {"": {}}, {"prompt": {}}, [[[[[[]]]]]], [np.zeros(3)] * 20,
    np.zeros((0,)), np.zeros((256, 256, 4), np.uint8), np.zeros((256, 256), np.uint8),
    np.zeros((1, 256, 256, 3), np.uint8), np.zeros((256, 256, 3), np.float16),
    np.full(5, np.nan), np.full(5, np.inf), np.full(5, 1e308), np.zeros(4), np.zeros((5, 1)), np.zeros(5, np.int8),
    np.zeros(5, bool), np.zeros(100_000), np.array(3.0), np.float32(1), np.bool_(True),
]  # fmt: skip
DTYPES = [
    "|O",
    "O",
    "<U8",
    "|S4",
    ">f4",
    "<c16",
    "<M8[s]",
    "V8",
    "<f4,<f4",
    "f",
    "",
    "(3,)f4",
    3,
    None,
    [],
    b"<f4",
    "<f8",
]
SHAPES = [
    [],
    [-1],
    [2**31],
    [2**63],
    [0],
    [0] * 9,
    [1.5],
    ["3"],
    None,
    3,
    [256, 256],
    [True],
    [2**20, 2**20, 2**20],
    {},
]


def frame(
    data: bytes, opcode: int = BINARY, *, fin: bool = True, masked: bool = True, length: int | None = None, rsv: int = 0
) -> bytes:
    """A client's frame, with any length told."""
    told = len(data) if length is None else length
    bit = 128 if masked else 0
    if told < 126:
        size = bytes([bit | told])
    elif told < 1 << 16:
        size = bytes([bit | 126]) + struct.pack("!H", told)
    else:
        size = bytes([bit | 127]) + struct.pack("!Q", told)
    return bytes([128 * fin | rsv << 4 | opcode]) + size + (b"\0\0\0\0" if masked else b"") + data


def mutated(data: bytes, rng: random.Random) -> bytes:
    """The bytes with some flipped, cut, repeated or inserted."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 5, 20))):
        # The structure is at the beginning and the end; in between are pixels.
        place = rng.choice(
            (
                rng.randrange(len(out) + 1),
                rng.randrange(min(100, len(out)) + 1),
                len(out) - rng.randrange(min(200, len(out)) + 1),
            )
        )
        match rng.randrange(5):
            case 0 if place < len(out):
                out[place] ^= 1 << rng.randrange(8)
            case 1:
                del out[place:]
            case 2:
                out[place:place] = rng.randbytes(rng.randrange(1, 9))
            case 3:
                out[place : place + 4] = rng.choice(
                    (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xc1\xdf\xdd\xdb", b"\x80\x00\x00\x00")
                )
            case 4:
                del out[place : place + rng.randrange(1, 9)]
    return bytes(out)


def raw_value(rng: random.Random, depth: int = 0) -> Any:
    """Any msgpack value."""
    match rng.randrange(7 if depth < 4 else 5):
        case 0 | 1 | 2:
            value = rng.choice(VALUES)
            return value if not isinstance(value, np.ndarray | np.generic) else hostile_array(rng)
        case 3:
            return msgpack.ExtType(rng.randrange(128), rng.randbytes(rng.randrange(9)))
        case 4:
            return hostile_array(rng)
        case 5:
            return [raw_value(rng, depth + 1) for _ in range(rng.randrange(4))]
        case _:
            return {
                rng.choice(("prompt", "reset", "x", b"__ndarray__", b"data")): raw_value(rng, depth + 1)
                for _ in range(3)
            }


def hostile_array(rng: random.Random) -> dict[bytes, Any]:
    table: dict[bytes, Any] = {b"__ndarray__": True, b"data": bytes(12), b"dtype": "<f4", b"shape": [3]}
    match rng.randrange(5):
        case 0:
            table[b"dtype"] = rng.choice(DTYPES)
        case 1:
            table[b"shape"] = rng.choice(SHAPES)
        case 2:
            table[b"data"] = rng.choice((None, "text", 3, [], b"", rng.randbytes(11)))
        case 3:
            del table[rng.choice((b"data", b"dtype", b"shape"))]
        case _:
            return {
                b"__npgeneric__": True,
                b"data": rng.choice((1, "x", None, 1e400, 2**64 - 1)),
                b"dtype": rng.choice(DTYPES),
            }
    return table


def fields(rng: random.Random) -> bytes:
    """An observation with something wrong in its fields."""
    message: dict[Any, Any] = dict(OBSERVATION)
    for _ in range(rng.choice((1, 1, 2, 4))):
        name = rng.choice((*OBSERVATION, "session", "unknown"))
        match rng.randrange(4):
            case 0:
                message.pop(name, None)
            case 1:
                message[name] = rng.choice(VALUES)
            case 2:
                message[name] = hostile_array(rng)
            case _:
                message["reset"] = [
                    {rng.choice(("prompt", "stage", "seed")): rng.choice(VALUES)} for _ in range(rng.randrange(3))
                ]
    return packed(message)


def packed(value: Any) -> bytes:
    """Any value, valid or not, as msgpack."""
    data: bytes = msgpack.packb(value, default=lambda array: msgpack.unpackb(pack(array), strict_map_key=False))
    return data


def one_message(rng: random.Random) -> tuple[str, bytes]:
    match rng.randrange(4):
        case 0:
            return "fields", fields(rng)
        case 1:
            return "msgpack value", packed(raw_value(rng))
        case 2:
            return "msgpack mutated", mutated(pack(OBSERVATION), rng)
        case _:
            return "random bytes", rng.randbytes(rng.choice((0, 1, 2, 10, 1000)))
