"""Dataclasses to JSON and back, through cattrs; reading checks every field.

`decode` derives its schema from the type hints and rejects an invalid file with the path of the first invalid value.
Non-finite numbers are written as null, and null is read as NaN where a float is expected. A field with the metadata
`{"json": "where set"}` is omitted at its default.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, get_origin

import cattrs
import numpy as np
from cattrs.gen import make_dict_unstructure_fn, override
from numpy.typing import NDArray

from cognitivedrone.errors import RunError
from cognitivedrone.files import read_regular, reason_of, schema
from cognitivedrone.text.json_text import parse_json

T = TypeVar("T")
_SURROGATE = re.compile("[\ud800-\udfff]")


def encode(value: Any) -> Any:
    """Plain JSON values for dataclasses, mappings, sequences, numbers and arrays; arrays are rounded to 3 decimals."""
    return _CONVERTER.unstructure(value)


def dumps(value: Any, *, indent: int | None = None) -> str:
    """JSON text of `encode(value)`, identical for equal values. Surrogates, which no file takes, are spelled out."""
    separators = (",", ":") if indent is None else (",", ": ")
    text = json.dumps(encode(value), ensure_ascii=False, allow_nan=False, indent=indent, separators=separators)
    return _SURROGATE.sub(lambda found: rf"\\u{ord(found.group()):04x}", text)


def read_document(path: Path, schema: str, kind: str, way_out: str, max_bytes: int) -> dict[str, Any]:
    """The JSON object of a file with this schema, without it. Raises `RunError` that names `kind` and the way out."""
    try:
        document = parse_json(read_regular(path, max_bytes).decode("utf-8"))
    except OSError as error:
        raise RunError(f"{path} cannot be read ({reason_of(error)}); {way_out}") from None
    except ValueError as error:
        raise RunError(f"{path} cannot be read: {error}; {way_out}") from None
    found = document.pop("schema", None) if isinstance(document, dict) else None
    if found != schema:
        raise RunError(f"{path} is no {kind} of this version: its schema is {found!r}, not {schema!r}; {way_out}")
    return dict(document)


def decode(kind: type[T], value: Any, where: str) -> T:
    """`value` as a `kind`: a dataclass, or any type that its hints may contain. Raises `RunError` with the place."""
    return schema.decode(kind, value, where, RunError, _CONVERTER)


def _read_points(value: Any, _: Any) -> NDArray[np.float32]:
    """(n, 3) float32."""
    with suppress(TypeError, ValueError, OverflowError), np.errstate(over="ignore"):
        if isinstance(value, Sequence) and not isinstance(value, str):
            points = np.array(value, dtype=np.float32).reshape(-1, 3)
            if np.isfinite(points).all():
                return points
    raise schema.must_be("a list of [x, y, z]", value)


def _dataclass_writer(kind: type[Any], converter: cattrs.Converter) -> Callable[[Any], Any]:
    fields = dataclasses.fields(kind)
    optional: dict[str, Any] = {
        field.name: override(omit_if_default=True) for field in fields if field.metadata.get("json") == "where set"
    }
    return make_dict_unstructure_fn(kind, converter, **optional)


def _write_float(value: float) -> float | None:
    # Write whole-numbered floats as integers, so that a file does not depend on how a value was computed.
    return value if isinstance(value, int) else float(value) if math.isfinite(value) else None


def _is_array(hint: Any) -> bool:
    """Whether a hint is an `NDArray[...]`, an alias that NumPy 2.5 defines differently from earlier versions."""
    return np.ndarray in (hint, get_origin(hint)) or (get_origin(hint) or hint) is NDArray


def _is_dataclass(hint: Any) -> bool:
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)


def _make_converter() -> cattrs.Converter:
    converter = schema.make_reader(unknown="refused")
    converter.register_structure_hook_func(_is_array, _read_points)
    converter.register_unstructure_hook_factory(_is_dataclass, _dataclass_writer)
    converter.register_unstructure_hook(bool, bool)
    converter.register_unstructure_hook(np.integer, int)
    for real in (float, np.floating):
        converter.register_unstructure_hook(real, _write_float)
    converter.register_unstructure_hook_func(_is_array, lambda points: np.round(points.astype(np.float64), 3).tolist())
    return converter


_CONVERTER = _make_converter()
