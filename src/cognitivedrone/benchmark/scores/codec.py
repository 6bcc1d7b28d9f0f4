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
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import cattrs
import numpy as np
from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn, override
from numpy.typing import NDArray

from cognitivedrone.errors import RunError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.json_text import parse_json

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


def loads(text: str) -> Any:
    """Parse JSON as strictly as `dumps` writes it: no name twice in an object, no NaN and no infinity.

    Raises `ValueError`.
    """
    return parse_json(text)


def read_document(path: Path, schema: str, kind: str, way_out: str, max_bytes: int) -> dict[str, Any]:
    """The JSON object of a file with this schema, without it. Raises `RunError` that names `kind` and the way out."""
    try:
        document = loads(read_regular(path, max_bytes).decode("utf-8"))
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
    try:
        return _CONVERTER.structure(value, kind)
    except (cattrs.BaseValidationError, cattrs.ForbiddenExtraKeysError, _Unfit) as error:
        problem, _, path = cattrs.transform_error(error, "", _problem)[0].rpartition(" @ ")
        raise RunError(f"{where}{path} {problem}") from None


class _Unfit(ValueError):
    """A value that its hint does not allow; the message completes "<place> ..."."""


def _problem(error: BaseException, _kind: type | None) -> str:
    """Message for one failed field; it follows the place."""
    if isinstance(error, cattrs.ForbiddenExtraKeysError):
        known = ", ".join(field.name for field in dataclasses.fields(error.cl))
        return f"has {min(error.extra_fields)!r}, which this version does not know; known: {known}"
    if isinstance(error, KeyError):
        return "is missing"
    return str(error)


def _must_be(wanted: str, value: Any) -> _Unfit:
    found = repr(value)
    return _Unfit(f"must be {wanted}, not {found if len(found) <= 60 else found[:57] + '...'}")


def _read_int(value: Any, _: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise _must_be("a whole number", value)
    return value


def _read_float(value: Any, _: Any) -> float:
    if value is None:
        return math.nan
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise _must_be("a number", value)
    return float(value)


def _read_str(value: Any, _: Any) -> str:
    if not isinstance(value, str):
        raise _must_be("text", value)
    return value


def _read_bool(value: Any, _: Any) -> bool:
    if not isinstance(value, bool):
        raise _must_be("true or false", value)
    return value


def _read_literal(value: Any, hint: Any) -> Any:
    if value not in get_args(hint):
        raise _Unfit(f"is {value!r}; it must be one of {', '.join(map(repr, get_args(hint)))}")
    return value


def _read_points(value: Any, _: Any) -> NDArray[np.float32]:
    """(n, 3) float32."""
    try:
        if isinstance(value, Sequence) and not isinstance(value, str):
            return np.array(value, dtype=np.float32).reshape(-1, 3)
    except (TypeError, ValueError):
        pass
    raise _must_be("a list of [x, y, z]", value)


def _read_tuple(value: Any, hint: Any) -> tuple[Any, ...]:
    """Tuples hold one kind of value, any number of them or as many as the hint lists."""
    kinds = get_args(hint)
    if not isinstance(value, list):
        raise _must_be("a list", value)
    if kinds[-1] is not Ellipsis and len(value) != len(kinds):
        raise _Unfit(f"has {len(value)} items; it must have {len(kinds)}")
    return tuple(_CONVERTER.structure(value, list[kinds[0]]))  # type: ignore[valid-type]


def _read_mapping(value: Any, hint: Any) -> dict[Any, Any]:
    if not isinstance(value, dict):
        raise _must_be("an object", value)
    key, item = get_args(hint)
    return _CONVERTER.structure(value, dict[key, item])  # type: ignore[valid-type]


def _dataclass_reader(kind: type[Any], converter: cattrs.Converter) -> Callable[[Any, Any], Any]:
    read = make_dict_structure_fn(kind, converter, _cattrs_forbid_extra_keys=True)

    def read_object(value: Any, hint: Any) -> Any:
        if not isinstance(value, dict):
            raise _must_be("an object", value)
        return read(value, hint)

    return read_object


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


def _origin_is(origin: Any) -> Callable[[Any], bool]:
    return lambda hint: get_origin(hint) is origin


def _is_dataclass(hint: Any) -> bool:
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)


def _make_converter() -> cattrs.Converter:
    converter = cattrs.Converter(unstruct_collection_overrides={tuple: list})
    for kind, read in ((int, _read_int), (float, _read_float), (str, _read_str), (bool, _read_bool)):
        converter.register_structure_hook(kind, read)
    converter.register_structure_hook_func(_origin_is(Literal), _read_literal)
    converter.register_structure_hook_func(_origin_is(tuple), _read_tuple)
    converter.register_structure_hook_func(_origin_is(Mapping), _read_mapping)
    converter.register_structure_hook_func(_is_array, _read_points)
    converter.register_structure_hook_factory(_is_dataclass, _dataclass_reader)
    converter.register_unstructure_hook_factory(_is_dataclass, _dataclass_writer)
    converter.register_unstructure_hook(bool, bool)
    converter.register_unstructure_hook(np.integer, int)
    for real in (float, np.floating):
        converter.register_unstructure_hook(real, _write_float)
    converter.register_unstructure_hook_func(_is_array, lambda points: np.round(points.astype(np.float64), 3).tolist())
    return converter


_CONVERTER = _make_converter()
