"""The one step from JSON values to checked types: a dataclass's hints are the schema, through cattrs.

`decode` makes the value, `check_form` only looks whether it could be made. Both name the place of the first thing that
does not fit. A whole number is no float and no true or false, an infinite number no number; null is read as NaN where a
float is expected.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal, TypeVar, get_args, get_origin

import cattrs
from cattrs.gen import make_dict_structure_fn

from cognitivedrone.errors import CognitiveDroneError

T = TypeVar("T")
_LONGEST = 60


class Unfit(ValueError):
    """A value that its hint does not allow; the message completes "<place> ..."."""


def must_be(wanted: str, value: Any) -> Unfit:
    """The error for a value that is none of what is wanted."""
    found = repr(value)
    return Unfit(f"must be {wanted}, not {found if len(found) <= _LONGEST else found[: _LONGEST - 3] + '...'}")


def decode(
    kind: type[T], value: Any, where: str, error: type[CognitiveDroneError], converter: cattrs.Converter | None = None
) -> T:
    """`value` as a `kind`: a dataclass, or any type that its hints may contain. Raises `error` with the place.

    A dataclass must have all names of the object, and the object all of its fields that have no default.
    """
    try:
        return (converter or STRICT).structure(value, kind)
    except (cattrs.BaseValidationError, cattrs.ForbiddenExtraKeysError, Unfit) as fault:
        problem, _, path = cattrs.transform_error(fault, "", _problem)[0].rpartition(" @ ")
        place = f"{where}{path.lstrip('.') if where.endswith(' ') else path}".rstrip()
        raise error(f"{place} {problem}") from None


def check_form(kind: type[Any], value: Any, where: str, error: type[CognitiveDroneError]) -> None:
    """Raise `error` unless `value` has the form of a `kind`. An object may have more names than its dataclass."""
    decode(kind, value, where, error, _TOLERANT)


def make_reader(*, unknown: Literal["refused", "ignored"]) -> cattrs.Converter:
    """A converter that checks every value; what to do with names that a dataclass does not have."""
    converter = cattrs.Converter(unstruct_collection_overrides={tuple: list})
    for kind, words in ((int, "a whole number"), (str, "text"), (bool, "true or false")):
        converter.register_structure_hook(kind, _reader_of(kind, words))
    converter.register_structure_hook(float, _read_float)
    converter.register_structure_hook_func(_origin_is(Literal), _read_literal)
    converter.register_structure_hook_func(_origin_is(tuple), _tuple_reader(converter))
    converter.register_structure_hook_func(_origin_is(Mapping), _mapping_reader(converter))

    def dataclass_reader(kind: type[Any], converter: cattrs.Converter) -> Callable[[Any, Any], Any]:
        read = make_dict_structure_fn(kind, converter, _cattrs_forbid_extra_keys=unknown == "refused")

        def read_object(value: Any, hint: Any) -> Any:
            if not isinstance(value, dict):
                raise must_be("an object", value)
            return read(value, hint)

        return read_object

    converter.register_structure_hook_factory(is_dataclass, dataclass_reader)
    return converter


def _problem(error: BaseException, _kind: type | None) -> str:
    """Message for one failed field; it follows the place."""
    if isinstance(error, cattrs.ForbiddenExtraKeysError):
        known = ", ".join(field.name for field in dataclasses.fields(error.cl))
        return f"has {min(error.extra_fields)!r}, which this version does not know; known: {known}"
    if isinstance(error, KeyError):
        return "is missing"
    return str(error)


def _reader_of(kind: type, words: str) -> Callable[[Any, Any], Any]:
    def read(value: Any, _: Any) -> Any:
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise must_be(words, value)
        return value

    return read


def _read_float(value: Any, _: Any) -> float:
    if value is None:
        return math.nan
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise must_be("a number", value)
    return float(value)


def _read_literal(value: Any, hint: Any) -> Any:
    if not any(value == known and type(value) is type(known) for known in get_args(hint)):
        raise Unfit(f"is {value!r:.{_LONGEST}}; it must be one of {', '.join(map(repr, get_args(hint)))}")
    return value


def _tuple_reader(converter: cattrs.Converter) -> Callable[[Any, Any], tuple[Any, ...]]:
    def read(value: Any, hint: Any) -> tuple[Any, ...]:
        """Tuples hold one kind of value, any number of them or as many as the hint lists."""
        kinds = get_args(hint)
        if not isinstance(value, list):
            raise must_be("a list", value)
        if kinds[-1] is not Ellipsis and len(value) != len(kinds):
            raise Unfit(f"has {len(value)} items; it must have {len(kinds)}")
        return tuple(converter.structure(value, list[kinds[0]]))  # type: ignore[valid-type]

    return read


def _mapping_reader(converter: cattrs.Converter) -> Callable[[Any, Any], dict[Any, Any]]:
    def read(value: Any, hint: Any) -> dict[Any, Any]:
        if not isinstance(value, dict):
            raise must_be("an object", value)
        key, item = get_args(hint)
        return converter.structure(value, dict[key, item])  # type: ignore[valid-type]

    return read


def _origin_is(origin: Any) -> Callable[[Any], bool]:
    return lambda hint: get_origin(hint) is origin


def is_dataclass(hint: Any) -> bool:
    """Whether a hint is a dataclass."""
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)


STRICT: Final = make_reader(unknown="refused")
_TOLERANT: Final = make_reader(unknown="ignored")
