"""Dataclasses to JSON and back, checked field by field.

`decode` takes its schema from the type hints, so a wrong file is refused with the place of the first wrong value.
Numbers that are not finite are written as null, and null is read as NaN where a float is asked for. A field with the
metadata `{"json": "where set"}` is left out where it has its default.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from cognitivedrone.errors import RunError

T = TypeVar("T")


def encode(value: Any) -> Any:
    """Plain JSON values for dataclasses, mappings, sequences, numbers and arrays; arrays are rounded to 3 decimals."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        members = ((field, getattr(value, field.name)) for field in dataclasses.fields(value))
        return {field.name: encode(member) for field, member in members if not _left_out(field, member)}
    if isinstance(value, np.ndarray):
        return np.round(value.astype(np.float64), 3).tolist()
    if isinstance(value, Mapping):
        return {str(key): encode(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [encode(item) for item in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    raise TypeError(f"{type(value).__name__} has no JSON form")


def dumps(value: Any, *, indent: int | None = None) -> str:
    """JSON text of `encode(value)`, the same for the same value."""
    separators = (",", ":") if indent is None else (",", ": ")
    return json.dumps(encode(value), ensure_ascii=False, allow_nan=False, indent=indent, separators=separators)


def _left_out(field: dataclasses.Field[Any], member: Any) -> bool:
    return field.metadata.get("json") == "where set" and bool(member == field.default)


def decode(kind: type[T], value: Any, where: str) -> T:
    """`value` as a `kind`: a dataclass, or anything that its hints may hold. Raises `RunError` naming the place."""
    decoded: T = _decode(kind, value, where)
    return decoded


def _decode(kind: Any, value: Any, where: str) -> Any:
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _decode_dataclass(kind, value, where)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        (kind,) = (argument for argument in arguments if argument is not type(None))
        return _decode(kind, value, where)
    if origin is Literal:
        if value not in arguments:
            raise RunError(f"{where} is {value!r}; it must be one of {', '.join(map(repr, arguments))}")
        return value
    if origin is tuple:
        return _decode_tuple(arguments, value, where)
    if origin is np.ndarray:
        return _decode_points(value, where)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, dict):
            raise _wrong(where, "an object", value)
        return {key: _decode(arguments[1], item, f"{where}.{key}") for key, item in value.items()}
    return _decode_scalar(kind, value, where)


def _decode_scalar(kind: Any, value: Any, where: str) -> Any:
    if kind is float:
        if value is None:
            return math.nan
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return float(value)
        raise _wrong(where, "a number", value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise _wrong(where, {"int": "a whole number", "str": "text", "bool": "true or false"}[kind.__name__], value)
    return value


def _decode_dataclass(kind: type[Any], value: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise _wrong(where, "an object", value)
    hints = get_type_hints(kind)
    fields = {field.name: field for field in dataclasses.fields(kind)}
    for name, field in fields.items():
        if name not in value and field.default is dataclasses.MISSING:
            raise RunError(f"{where} lacks {name!r}")
    unknown = sorted(value.keys() - fields.keys())
    if unknown:
        raise RunError(f"{where} has {unknown[0]!r}, which this version does not know; known: {', '.join(fields)}")
    return kind(**{name: _decode(hints[name], item, f"{where}.{name}") for name, item in value.items()})


def _decode_tuple(kinds: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise _wrong(where, "a list", value)
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(value) != len(kinds):
        raise RunError(f"{where} has {len(value)} items; it must have {len(kinds)}")
    return tuple(
        _decode(kind, item, f"{where}[{index}]") for index, (kind, item) in enumerate(zip(kinds, value, strict=True))
    )


def _decode_points(value: Any, where: str) -> Any:
    """(n, 3) float32."""
    points = value if isinstance(value, Sequence) and not isinstance(value, str) else None
    try:
        return np.array(points, dtype=np.float32).reshape(-1, 3)
    except (TypeError, ValueError):
        raise _wrong(where, "a list of [x, y, z]", value) from None


def _wrong(where: str, wanted: str, value: Any) -> RunError:
    got = repr(value)
    return RunError(f"{where} must be {wanted}, not {got if len(got) <= 60 else got[:57] + '...'}")
