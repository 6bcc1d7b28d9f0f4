"""TFRecord files of `tf.train.Example`, written and read without TensorFlow.

A record is framed as length (uint64), masked CRC-32C of the length, payload, masked CRC-32C of the payload, all little
endian (https://www.tensorflow.org/tutorials/load_data/tfrecord). The payload is a protocol buffer, `Example`: a map
from a name to one list of bytes, float32 or int64.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import google_crc32c
import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, text_format
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from cognitivedrone.errors import DataError
from cognitivedrone.files import open_regular

Feature: TypeAlias = Sequence[bytes] | NDArray[np.float32] | NDArray[np.int64]
"""A list of byte strings, or a flat array of float32 or int64."""

MAX_RECORD_BYTES = 2**30
"""Of one episode; protocol buffers have at most twice as many."""
HEAD_BYTES = 12
"""Size of the framing before a payload."""
FRAME_BYTES = 16
"""Total size of the framing of a payload."""

_KINDS = {"<f4": "float_list", "<i8": "int64_list"}

_SCHEMA = """
name: "example.proto" package: "tf" syntax: "proto3"
message_type { name: "BytesList" field { name: "value" number: 1 label: LABEL_REPEATED type: TYPE_BYTES } }
message_type { name: "FloatList" field { name: "value" number: 1 label: LABEL_REPEATED type: TYPE_FLOAT } }
message_type { name: "Int64List" field { name: "value" number: 1 label: LABEL_REPEATED type: TYPE_INT64 } }
message_type { name: "Feature" oneof_decl { name: "kind" }
  field { name: "bytes_list" number: 1 type: TYPE_MESSAGE type_name: ".tf.BytesList" oneof_index: 0 }
  field { name: "float_list" number: 2 type: TYPE_MESSAGE type_name: ".tf.FloatList" oneof_index: 0 }
  field { name: "int64_list" number: 3 type: TYPE_MESSAGE type_name: ".tf.Int64List" oneof_index: 0 } }
message_type { name: "Features" nested_type { name: "FeatureEntry" options { map_entry: true }
    field { name: "key" number: 1 type: TYPE_STRING }
    field { name: "value" number: 2 type: TYPE_MESSAGE type_name: ".tf.Feature" } }
  field { name: "feature" number: 1 label: LABEL_REPEATED type: TYPE_MESSAGE type_name: ".tf.Features.FeatureEntry" } }
message_type { name: "Example" field { name: "features" number: 1 type: TYPE_MESSAGE type_name: ".tf.Features" } }
"""
"""TensorFlow's `example.proto`, in a pool of its own, so that TensorFlow may be loaded as well."""
_POOL = descriptor_pool.DescriptorPool()
_POOL.Add(text_format.Parse(_SCHEMA, descriptor_pb2.FileDescriptorProto()))
_EXAMPLE = message_factory.GetMessageClass(_POOL.FindMessageTypeByName("tf.Example"))


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
        with open_regular(path) as file:
            size, number = os.fstat(file.fileno()).st_size, 0
            while head := file.read(HEAD_BYTES):
                if len(head) < HEAD_BYTES or _masked_crc(head[:8]) != head[8:]:
                    raise DataError(f"{path}: record {number} has a broken head; copy or export the file again")
                (length,) = struct.unpack("<Q", head[:8])
                if length > MAX_RECORD_BYTES:
                    raise DataError(
                        f"{path}: record {number} has {length:,} bytes, and at most {MAX_RECORD_BYTES:,} are read;"
                        " export flights of fewer steps"
                    )
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
    example = _EXAMPLE()
    for name, values in features.items():
        kind = _KINDS[values.dtype.str] if isinstance(values, np.ndarray) else "bytes_list"
        getattr(example.features.feature[name], kind).value.extend(values)
    encoded: bytes = example.SerializeToString(deterministic=True)
    return encoded


def decode_example(payload: bytes) -> dict[str, Feature]:
    """The inverse of `encode_example`; raises `ValueError` if the bytes are not an `Example`."""
    try:
        features = _EXAMPLE.FromString(payload).features.feature
    except DecodeError as error:
        raise ValueError(str(error)) from None
    return {name: _values(feature) for name, feature in features.items()}


def _values(feature: Any) -> Feature:
    kind = feature.WhichOneof("kind")
    values = getattr(feature, kind).value if kind else ()
    dtype = next((dtype for dtype, name in _KINDS.items() if name == kind), None)
    return list(values) if dtype is None else np.array(values, dtype)


def _masked_crc(data: bytes) -> bytes:
    crc = google_crc32c.value(data)
    return struct.pack("<I", (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF)
