"""Names to objects: a family of plug-ins is one literal dict from a name to "module:attribute".

A name of the family may carry an argument, as in "small:runs/a/model.onnx", where what it names takes a text.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args, get_type_hints

from cognitivedrone.errors import PolicyError, did_you_mean


def load(kind: str, name: str, table: Mapping[str, str]) -> Callable[..., Any]:
    """The factory that `name` stands for: a key of `table`, or the user's own "module:attribute".

    Raises `PolicyError` naming the known names, or what was wrong with the user's own.
    """
    target = table.get(name, name)
    module_name, colon, attribute = target.partition(":")
    if not colon:
        raise PolicyError(
            f"unknown {kind} {name!r}; {did_you_mean(name, table)} Your own is given as module:attribute."
        )
    try:
        factory = getattr(importlib.import_module(module_name), attribute)
    except ModuleNotFoundError as error:
        near = difflib.get_close_matches(module_name, table, n=1)
        hint = f"did you mean '{near[0]}:{attribute}'?" if near else "is its folder on PYTHONPATH?"
        raise PolicyError(f"{kind} {name!r}: no module {error.name!r}; {hint}") from None
    except AttributeError:
        raise PolicyError(f"{kind} {name!r}: module {module_name!r} has no {attribute!r}") from None
    if not callable(factory):
        raise PolicyError(f"{kind} {name!r}: {attribute!r} is not a class or function that makes a {kind}")
    result: Callable[..., Any] = factory
    return result


def make(kind: str, name: str, table: Mapping[str, str], methods: tuple[str, ...]) -> Any:
    """A new object of the plug-in `name`: a key of `table`, such a key with ":argument", or "module:attribute".

    Raises `PolicyError` where it cannot be made, or lacks one of the interface's methods.
    """
    key, colon, argument = name.partition(":")
    if colon and key in table:
        made = _made_with(kind, key, argument, table)
    else:
        try:
            made = load(kind, name, table)()
        except TypeError as error:
            raise PolicyError(f"{kind} {name!r} cannot be made without arguments: {error}") from None
    missing = [method for method in methods if not callable(getattr(made, method, None))]
    if missing:
        raise PolicyError(f"{kind} {name!r} has no method {missing[0]}(); see cognitivedrone.interfaces")
    return made


def file_of(kind: str, name: str, table: Mapping[str, str]) -> Path | None:
    """The file that a plug-in of the package by this name depends on; none where it depends on none.

    Asks the plug-in's own `file_of(argument)`. Raises `PolicyError` where the file is missing.
    """
    key, colon, argument = name.partition(":")
    if key not in table or (colon and not argument):
        return None
    ask = getattr(load(kind, key, table), "file_of", None)
    found: Path | None = ask(argument or None) if ask else None
    return found


def _made_with(kind: str, key: str, argument: str, table: Mapping[str, str]) -> Any:
    """A new object of the family's plug-in `key`, told `argument`."""
    factory = load(kind, key, table)
    if not _takes_text(factory):
        raise PolicyError(f"{kind} {key!r} takes no argument, {argument!r} was given; write {key!r} alone")
    if not argument:
        raise PolicyError(f"{kind} '{key}:' ends at its colon; write {key!r}, or {key}: and its argument")
    return factory(argument)


def _takes_text(factory: Callable[..., Any]) -> bool:
    """Whether the first parameter of a factory may be a text, by its annotation."""
    first = next(iter(inspect.signature(factory).parameters), None)
    hints = get_type_hints(factory.__init__ if inspect.isclass(factory) else factory)
    hint = hints.get(first) if first else None
    return str in (hint, *get_args(hint))
