"""Messages as bytes: msgpack, with NumPy arrays encoded as openpi's clients and servers do.

An array is a map with the binary keys `__ndarray__`, `data`, `dtype` and `shape`, a NumPy scalar one with
`__npgeneric__`, `data` and `dtype`. Nothing else is decoded to an object: no pickle, no extension types, and arrays of
plain numbers only, whose size is checked before they are made. (msgpack's own timestamps fit no field.)
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from cognitivedrone.errors import MessageError, import_extra

EXTRA = "remote"
"""The extra that installs the packages of this one."""
LARGEST_BYTES: Final = 1 << 20
"""Maximum size of a message; one image has 197 kB."""
DTYPES: Final = {np.dtype(name).str for name in ("?", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")}
"""Element types of arrays, as NumPy writes them: little-endian numbers."""
_MOST_AXES = 8
_MOST_ITEMS = 4096
"""Of a list or map; actions of a whole flight as a list are shorter."""


def pack(message: object) -> bytes:
    """A message of maps, lists, text, numbers and arrays; raises `TypeError` for anything else."""
    packed: bytes = import_extra("msgpack", EXTRA).packb(message, default=_encoded)
    return packed


def unpack(data: bytes, largest_bytes: int = LARGEST_BYTES) -> Any:
    """The message; arrays are its own copies. Raises `MessageError` if it is malformed or too large."""
    if len(data) > largest_bytes:
        raise MessageError("too_large", f"the message has {len(data)} bytes; at most {largest_bytes} are accepted")
    try:
        return import_extra("msgpack", EXTRA).unpackb(
            data,
            object_hook=_decoded,
            ext_hook=_refuse,
            max_array_len=_MOST_ITEMS,
            max_map_len=_MOST_ITEMS,
            max_str_len=largest_bytes,
            max_bin_len=largest_bytes,
        )
    except MessageError:
        raise
    except Exception as error:  # of many unrelated classes
        reason = str(error) or type(error).__name__
        raise MessageError("bad_message", f"the message is not msgpack as expected: {reason[:200]}") from None


def array_of(data: object, dtype: object, shape: object) -> np.ndarray[Any, Any]:
    """The array with these parts, checked; raises `MessageError`."""
    if not isinstance(dtype, str) or dtype not in DTYPES:
        raise MessageError("bad_array", f"an array has the dtype {dtype!r:.40}; use one of {', '.join(sorted(DTYPES))}")
    if (
        not isinstance(shape, list)
        or len(shape) > _MOST_AXES
        or not all(type(size) is int and 0 <= size < 2**31 for size in shape)
    ):
        raise MessageError(
            "bad_array", f"an array has the shape {shape!r:.60}; it is a list of up to {_MOST_AXES} sizes"
        )
    expected = math.prod(shape) * np.dtype(dtype).itemsize
    if not isinstance(data, bytes) or len(data) != expected:
        found = f"{len(data)} bytes" if isinstance(data, bytes) else type(data).__name__
        raise MessageError("bad_array", f"an array {dtype} {shape} has {found} of data; expected {expected} bytes")
    return np.frombuffer(data, dtype=dtype).reshape(shape).copy()


def _encoded(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic) and value.dtype.str not in DTYPES:
        raise TypeError(f"arrays of dtype {value.dtype} cannot be sent; use one of {', '.join(sorted(DTYPES))}")
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    if isinstance(value, np.generic):
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"a {type(value).__name__} cannot be sent")


def _decoded(table: dict[Any, Any]) -> Any:
    if b"__ndarray__" in table:
        return array_of(table.get(b"data"), table.get(b"dtype"), table.get(b"shape"))
    if b"__npgeneric__" in table:
        dtype, value = table.get(b"dtype"), table.get(b"data")
        if not isinstance(dtype, str) or dtype not in DTYPES or not isinstance(value, bool | int | float):
            raise MessageError("bad_array", f"a NumPy scalar has the dtype {dtype!r:.40} and the value {value!r:.40}")
        try:
            return np.dtype(dtype).type(value)
        except (OverflowError, ValueError):
            raise MessageError("bad_array", f"the NumPy scalar {value!r:.40} does not fit its dtype {dtype}") from None
    return table


def _refuse(code: int, _data: bytes) -> Any:
    raise MessageError("bad_message", f"the message has an extension type ({code}); none is accepted")
