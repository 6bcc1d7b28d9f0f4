"""What numbers an option takes, as part of its type, and the check of a command's arguments and of plans.

seed: Seed = 0
wind: Annotated[float, Range(0, 50, "m/s")] = 0.0
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from cognitivedrone.errors import UsageError


@dataclass(frozen=True, slots=True)
class Range:
    """The numbers from `least` to `most`, both included; never infinite."""

    least: float = -math.inf
    most: float = math.inf
    unit: str = ""

    def __contains__(self, value: float) -> bool:
        # Python compares whole numbers of any size with floats, but isfinite converts them.
        return self.least <= value <= self.most and abs(value) != math.inf

    def wanted(self, value: float) -> str:
        """What was expected instead of this value."""
        unit = f" {self.unit}" if self.unit else ""
        if self.least == -math.inf and self.most == math.inf:
            return f"a finite number{unit}"
        if self.most < _MANY:
            return f"from {self.least:g} to {self.most:g}{unit}"
        return f"at most {self.most}{unit}" if value > self.most else f"at least {self.least:g}{unit}"


_MANY = 10**6  # a limit that only a mistake exceeds
FINITE = Range()
WIND = Range(0, 50, "m/s")
"""Of a steady wind; a hurricane begins at 33 m/s."""
Seed = Annotated[int, Range(0, 2**63 - 1)]
Index = Annotated[int, Range(0, 2**31 - 1)]
"""From 0."""
Count = Annotated[int, Range(1, 2**31 - 1)]
Amount = Annotated[int, Range(0, 2**31 - 1)]
"""A count that may be 0."""
Processes = Annotated[int, Range(1, 4096)]
Port = Annotated[int, Range(0, 65535)]
Share = Annotated[float, Range(0, 1)]


def check_arguments(command: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Check the arguments of a command, or the options of a plan, against its annotations; raises `UsageError`."""
    hints = get_type_hints(command, include_extras=True)
    for name, value in arguments.items():
        allowed = next(_ranges(hints.get(name)), FINITE)
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, int | float) and not isinstance(number, bool) and number not in allowed:
                raise UsageError(f"--{name.replace('_', '-')} is {_shown(number)}; it must be {allowed.wanted(number)}")


def fitted(name: str, hint: Any, value: Any) -> Any:
    """An option's value as its annotation has it: text for a path, a list for a tuple, NumPy's numbers for Python's.

    Raises `UsageError` for a value of another type.
    """
    while get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    kinds = [_bare(kind) for kind in (get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,))]
    for kind in kinds:
        origin, parts = get_origin(kind), get_args(kind)
        if origin is Literal and (value in parts or isinstance(value, str)):  # plans name the choices themselves
            return value
        if origin is tuple and isinstance(value, list | tuple) and parts[1:] == (...,):
            return tuple(fitted(name, parts[0], each) for each in value)
        if kind is int and isinstance(value, Integral) and not isinstance(value, bool):
            return value if isinstance(value, int) else int(value)
        if kind is float and isinstance(value, Real) and not isinstance(value, bool):
            return value if isinstance(value, int | float) else float(value)
        if kind is Path and str not in kinds and isinstance(value, str | PathLike):
            return Path(value)
        if origin is Literal or parts[1:] == (...,):
            continue
        if not isinstance(kind, type) or (isinstance(value, kind) and not (kind is int and isinstance(value, bool))):
            return value
    raise UsageError(f"--{name.replace('_', '-')} is {value!r:.60}; it must be {_wanted(kinds)}")


def _bare(kind: Any) -> Any:
    return _bare(get_args(kind)[0]) if get_origin(kind) is Annotated else kind


def _wanted(kinds: Sequence[Any]) -> str:
    """What an option takes, in words."""
    words = {
        int: "a whole number",
        float: "a number",
        bool: "True or False",
        str: "text",
        Path: "a path",
        NoneType: "None",
    }
    parts = [
        " or ".join(map(repr, get_args(kind))) if get_origin(kind) is Literal else words.get(kind) or str(kind)
        for kind in kinds
    ]
    return " or ".join(parts)


def _ranges(hint: Any) -> Iterator[Range]:
    """The ranges within an annotation, such as that of `tuple[Seed, ...] | None`."""
    for part in get_args(hint):
        if isinstance(part, Range):
            yield part
        else:
            yield from _ranges(part)


def _shown(number: float) -> str:
    if isinstance(number, int) and abs(number) >= 10**30:
        return "a number of over 30 digits"
    return str(number)


def check_words(arguments: Sequence[str]) -> None:
    """Refuse empty arguments of a command line, which a shell makes of variables that are not set.

    An empty path would be read as the working directory. Raises `UsageError`.
    """
    option = ""
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if not argument.strip() or (name.startswith("--") and equals and not value.strip()):
            after = name if equals else option
            raise UsageError(f"the value{f' of {after}' if after else ''} is empty; give one, or leave the option out")
        option = argument if argument.startswith("--") else ""
