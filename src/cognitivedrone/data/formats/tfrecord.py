"""TFRecord files of `tf.train.Example`, written and read without TensorFlow.

A record is framed as length (uint64), masked CRC-32C of the length, payload, masked CRC-32C of the payload, all little
endian (https://www.tensorflow.org/tutorials/load_data/tfrecord). The payload is an `Example` message in the protocol
buffer wire format (https://protobuf.dev/programming-guides/encoding): a map from a name to one list of bytes, float32
or int64.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, TypeAlias

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import DataError

Feature: TypeAlias = Sequence[bytes] | NDArray[np.float32] | NDArray[np.int64]
"""A list of byte strings, or a flat array of float32 or int64."""

HEAD_BYTES = 12
"""Size of the framing before a payload."""
FRAME_BYTES = 16
"""Total size of the framing of a payload."""

_DELIMITED = 2
_BYTES_LIST, _FLOAT_LIST, _INT64_LIST = 1, 2, 3


def write_record(file: BinaryIO, payload: bytes) -> int:
    """Append one framed record; returns the bytes written."""
    length = struct.pack("<Q", len(payload))
    file.write(length + _masked_crc(length))
    file.write(payload)
    file.write(_masked_crc(payload))
    return len(payload) + FRAME_BYTES


def read_records(path: Path) -> Iterator[bytes]:
    """The payloads of a file in order; `DataError` names the file and the truncated or altered record."""
    try:
        with path.open("rb") as file:
            size, number = path.stat().st_size, 0
            while head := file.read(HEAD_BYTES):
                if len(head) < HEAD_BYTES or _masked_crc(head[:8]) != head[8:]:
                    raise DataError(f"{path}: record {number} has a broken head; copy or export the file again")
                (length,) = struct.unpack("<Q", head[:8])
                if file.tell() + length + 4 > size:
                    raise DataError(f"{path}: cut off within record {number}; copy or export the file again")
                payload, check = file.read(length), file.read(4)
                if _masked_crc(payload) != check:
                    raise DataError(f"{path}: record {number} fails its checksum; copy or export the file again")
                yield payload
                number += 1
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None


def encode_example(features: Mapping[str, Feature]) -> bytes:
    """A serialised `tf.train.Example`; names in order, so that equal content gives equal bytes."""
    entries = []
    for name in sorted(features):
        entry = _field(1, name.encode()) + _field(2, _encode_feature(features[name]))
        entries.append(_field(1, entry))
    return _field(1, b"".join(entries))


def decode_example(payload: bytes) -> dict[str, Feature]:
    """The inverse of `encode_example`; raises `ValueError` if the bytes are not an `Example`."""
    features: dict[str, Feature] = {}
    for _, feature_map in _fields(payload):
        for _, entry in _fields(feature_map):
            parts = dict(_fields(entry))
            features[parts[1].decode()] = _decode_feature(parts.get(2, b""))
    return features


def _masked_crc(data: bytes) -> bytes:
    crc = google_crc32c.value(data)
    return struct.pack("<I", (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF)


def _encode_feature(values: Feature) -> bytes:
    if not isinstance(values, np.ndarray):
        return _field(_BYTES_LIST, b"".join(_field(1, value) for value in values))
    if values.dtype == np.float32:
        return _field(_FLOAT_LIST, _field(1, values.astype("<f4").tobytes()))
    if values.dtype == np.int64:
        packed = b"".join(_varint(int(value) & 0xFFFFFFFFFFFFFFFF) for value in values)
        return _field(_INT64_LIST, _field(1, packed))
    raise TypeError(f"an Example holds bytes, float32 or int64, not {values.dtype}")


def _decode_feature(data: bytes) -> Feature:
    """Reads packed lists, the form that all current writers use."""
    for kind, content in _fields(data):
        values = [value for _, value in _fields(content)]
        if kind == _BYTES_LIST:
            return values
        packed = b"".join(values)
        if kind == _FLOAT_LIST:
            return np.frombuffer(packed, "<f4").astype(np.float32)
        return np.array(_varints(packed), np.uint64).astype(np.int64)
    return []


def _field(number: int, content: bytes) -> bytes:
    """A length-delimited field: key, length, content."""
    return _varint(number << 3 | _DELIMITED) + _varint(len(content)) + content


def _fields(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Number and content of the length-delimited fields of a message, in order."""
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        if key & 7 != _DELIMITED:
            raise ValueError(f"unexpected wire type {key & 7}")
        size, at = _read_varint(data, at)
        if at + size > len(data):
            raise ValueError("a field is longer than its message")
        yield key >> 3, data[at : at + size]
        at += size


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise ValueError("a number is cut off")
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at


def _varints(data: bytes) -> list[int]:
    values, at = [], 0
    while at < len(data):
        value, at = _read_varint(data, at)
        values.append(value)
    return values
