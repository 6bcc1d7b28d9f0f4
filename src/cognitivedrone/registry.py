"""Plug-ins by name: each family is one literal dict from a name to "module:attribute".

All plug-ins, the package's and the user's own, are named in the same syntax:

    NAME                                small
    NAME:VALUE                          small:runs/a/model.onnx
    NAME:VALUE,option=value,...         openvla:checkpoints/7b,decoder=parallel
    MODULE:ATTRIBUTE                    my_policy:MyPolicy
    MODULE:ATTRIBUTE:VALUE,option=...   my_policy:MyPolicy:weights.pt,device=cpu

Values are passed to the class or function by position, options by name, each converted to the type of the parameter's
annotation or default. A switch (bool) may be written as its name alone. Put a part that contains a comma in double
quotes.
"""

from __future__ import annotations

import ast
import csv
import difflib
import importlib
import inspect
import sys
import traceback
import types
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from cognitivedrone.errors import PluginError, did_you_mean
from cognitivedrone.files import check_regular, read_regular, reason_of
from cognitivedrone.system.imports import switch_off
from cognitivedrone.system.interrupts import is_ctrl_c
from cognitivedrone.text.printable import visible

_SWITCH = {"yes": True, "true": True, "on": True, "1": True, "no": False, "false": False, "off": False, "0": False}
_LARGEST_SOURCE = 2**20
_CLASSES_SHOWN = 4
"""At most so many classes of a file are named."""


@dataclass(frozen=True, slots=True)
class Call:
    """A plug-in's factory and its arguments."""

    factory: Callable[..., Any]
    arguments: Mapping[str, Any]
    """By parameter name."""

    def __call__(self) -> Any:
        """Make the object."""
        return self.factory(**self.arguments)


def load(kind: str, name: str, table: Mapping[str, str], methods: Collection[str] = ()) -> Callable[..., Any]:
    """The factory named `name`: a key of `table`, or the user's own "module:attribute".

    A user's own must make objects with `methods`, as far as can be seen without calling it. Raises `PluginError` that
    lists the known names, or says what is wrong with the user's own.
    """
    target = table.get(name, name)
    module_name, colon, attribute = target.partition(":")
    if not colon:
        raise PluginError(
            _hint_for_file(kind, name)
            or f"unknown {kind} {name!r} (your own is given as module:attribute); {did_you_mean(name, table)}"
        )
    switch_off()  # plug-ins load libraries
    try:
        factory = getattr(importlib.import_module(module_name), attribute)
    except ModuleNotFoundError as error:
        if error.name is None or f"{module_name}.".startswith(f"{error.name}."):
            what = f"no module {error.name!r}; {_hint_for(module_name, attribute, table)}"
        else:
            what = f"{_file_in(error)} imports {error.name!r}, which is not installed in this environment"
        raise PluginError(f"{kind} {name!r}: {what}") from None
    except AttributeError:
        raise PluginError(f"{kind} {name!r}: module {module_name!r} has no {attribute!r}") from None
    except BaseException as error:
        if is_ctrl_c(error):
            raise
        raise PluginError(f"{kind} {name!r}: module {module_name!r} cannot be imported: {one_line(error)}") from error
    if not callable(factory):
        raise PluginError(f"{kind} {name!r}: {attribute!r} is not a class or function that makes a {kind}")
    made = _made_by(factory)
    missing = [method for method in methods if not callable(getattr(made, method, None))]
    if name not in table and missing:
        needs = " and ".join(f"{method}()" for method in methods)
        raise PluginError(
            f"{kind} {name!r} has no method {missing[0]}(), so it is not called; give a class with {needs}, or a"
            " function whose return annotation is such a class (see cognitivedrone.interfaces)"
        )
    result: Callable[..., Any] = factory
    return result


def _made_by(factory: Callable[..., Any]) -> object:
    """The class whose objects a factory makes: itself, or its annotated result; none if that is not known."""
    if inspect.isclass(factory):
        return factory
    try:
        return get_type_hints(factory).get("return")
    except Exception:  # annotations that cannot be evaluated
        return None


def _hint_for(module: str, attribute: str, table: Mapping[str, str]) -> str:
    """What may be meant by the name of a module that does not exist."""
    if module.endswith(".py"):
        file = Path(module)
        return f"name the module, not its file: PYTHONPATH={file.parent} ... {file.stem}:{attribute}"
    near = difflib.get_close_matches(module, table, n=1)
    return f"did you mean '{near[0]}:{attribute}'?" if near else "is its folder on PYTHONPATH?"


def _hint_for_file(kind: str, name: str) -> str:
    """How to write the user's own plug-in that is named by its file or module alone; empty if there is no such file."""
    stem = Path(name).stem if name.endswith(".py") else name
    places = [Path(name)] if name.endswith(".py") else [Path(place) / f"{name}.py" for place in ("", *sys.path)]
    file = next((place for place in places if place.is_file()), None)
    if file is None:
        return f"{kind} {name!r}: there is no such file; your own is written {stem}:CLASS" if stem != name else ""
    classes = ["CLASS"]
    with suppress(OSError, SyntaxError, ValueError):
        found = [
            node.name for node in ast.parse(read_regular(file, _LARGEST_SOURCE)).body if isinstance(node, ast.ClassDef)
        ]
        classes = found[:_CLASSES_SHOWN] or classes
    written = " or ".join(f"{stem}:{name}" for name in classes)
    return f"{kind} {name!r} is a file's name; name a class in it: PYTHONPATH={file.parent} ... {written}"


def _file_in(error: BaseException) -> str:
    """Name of the file in which an error of an import arose."""
    files = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
    return Path(next(file for file in reversed(files) if not file.startswith("<"))).name


def call_of(kind: str, text: str, table: Mapping[str, str], methods: Collection[str] = ()) -> Call:
    """Parse `text`, in the syntax above, into a call. Raises `PluginError` as `load`, and for invalid arguments."""
    head, colon, rest = text.partition(":")
    name = head
    if head not in table:
        attribute, colon, rest = rest.partition(":")
        name = f"{head}:{attribute}" if attribute else text
    factory = load(kind, name, table, methods)
    if colon and not rest:
        raise PluginError(f"{kind} {text!r} ends at its colon; write {name!r}, or {usage(name, factory)}")
    return Call(factory, _bind(kind, name, factory, rest))


def check_self_contained(kind: str, text: str, table: Mapping[str, str], names: Collection[str]) -> None:
    """Raise `PluginError` unless `text`, which a file states, is one of `names` in `table`, with harmless arguments.

    Those are numbers, switches and choices: no code, file or address. A file must not decide what of them is used.
    """
    head = text.partition(":")[0]
    if head in names:
        call = call_of(kind, text, table)
        hints = _hints(call.factory)
        if all(
            isinstance(value, (int, float)) or value in _choices(hints.get(option))
            for option, value in call.arguments.items()
        ):
            return
    raise PluginError(
        f"the {kind} {text[:80]!r} is named by a file, which must not choose the code, files or servers that are used"
        f" (only: {', '.join(names)}); where you know and trust it, name it yourself with --{kind}"
    )


def make(kind: str, text: str, table: Mapping[str, str], methods: Collection[str] = ()) -> Any:
    """A new object of the plug-in named by `text`; raises `PolicyError` if it cannot be made."""
    call = call_of(kind, text, table, methods)
    own = text.partition(":")[0] not in table
    try:
        return call()
    except BaseException as error:
        if not own or is_ctrl_c(error):
            raise
        raise PluginError(f"{kind} {text!r} cannot be made: {one_line(error)}") from error


def files_of(kind: str, text: str, table: Mapping[str, str], methods: Collection[str] = ()) -> tuple[Path, ...]:
    """The files that the plug-in depends on, from its `file_of`, called with the same arguments: a path, or several.

    One that is inherited by a class with other arguments says nothing of it. Raises `PluginError` if a file is missing.
    """
    if text not in table and ":" not in text:
        return ()  # making it reports the unknown name
    call = call_of(kind, text, table, methods)
    ask = getattr(call.factory, "file_of", None)
    if ask is None or not _takes(ask, call.arguments):
        return ()
    answer: Path | Sequence[Path] | None = ask(**call.arguments)
    files = () if answer is None else (answer,) if isinstance(answer, Path) else tuple(answer)
    for found in files:
        if found.exists() and not (found.is_dir() and getattr(call.factory, "reads_folder", False)):
            try:
                check_regular(found)  # before it is hashed: a pipe or a device would never end
            except OSError as error:
                raise PluginError(f"{kind} {text!r}: {found} cannot be read: {reason_of(error)}; give a file") from None
    return files


def on_card(kind: str, text: str, table: Mapping[str, str]) -> bool:
    """Whether each object of the plug-in holds a network on a graphics card: see `interfaces.PlugIn.on_card`."""
    if text not in table and ":" not in text:
        return False  # making it reports the unknown name
    call = call_of(kind, text, table)
    return bool(getattr(call.factory, "on_card", False)) and call.arguments.get("device") != "cpu"


def _takes(function: Callable[..., Any], arguments: Mapping[str, Any]) -> bool:
    try:
        inspect.signature(function).bind(**arguments)
    except TypeError:
        return False
    return True


def usage(name: str, factory: Callable[..., Any]) -> str:
    """The syntax of a plug-in and its arguments, such as `replay:PATH` or `vlm[:URL][,timeout=NUMBER]`."""
    hints = _hints(factory)
    text = ""
    for parameter in _parameters(factory).values():
        hint = _hint(parameter, hints)
        by_position = parameter.kind is not parameter.KEYWORD_ONLY
        value = "yes|no" if hint is bool else "|".join(map(str, _choices(hint))) or _PLACEHOLDERS.get(hint, "TEXT")
        if by_position and not _choices(hint):
            value = parameter.name.upper()
        part = ("," if text else ":") + (value if by_position else f"{parameter.name}={value}")
        text += part if parameter.default is parameter.empty else f"[{part}]"
    return name + text


_PLACEHOLDERS: dict[Any, str] = {int: "NUMBER", float: "NUMBER", Path: "PATH"}


def _bind(kind: str, name: str, factory: Callable[..., Any], text: str) -> dict[str, Any]:
    """Arguments for `factory`, by name, from "VALUE,option=value,..."."""
    what = f"{kind} {name!r}"
    parameters, hints = _parameters(factory), _hints(factory)
    if text and not parameters:
        raise PluginError(f"{what} takes no argument, {text!r} was given; write {name!r} alone")
    positional = [parameter for parameter in parameters.values() if parameter.kind is not parameter.KEYWORD_ONLY]
    given: dict[str, Any] = {}
    for part in _parts(text):
        option, equals, value = (piece.strip() for piece in part.partition("="))
        switch = part in parameters and _hint(parameters[part], hints) is bool
        if switch:
            option, value = part, "yes"
        elif not (equals and option.isidentifier()):
            free = [parameter.name for parameter in positional if parameter.name not in given]
            if not part or not free:
                raise PluginError(f"{what}: cannot place {part!r} of {text!r}; write {usage(name, factory)}")
            option, value = free[0], part
        if option not in parameters:
            known = did_you_mean(option, parameters)
            raise PluginError(f"{what} has no option {option!r}; {known} It is written {usage(name, factory)}")
        if option in given:
            raise PluginError(f"{what}: {option} is given twice in {text!r}; keep one")
        given[option] = _converted(f"{what}: {option}", value, _hint(parameters[option], hints))
    for parameter in parameters.values():
        if parameter.default is parameter.empty and parameter.name not in given:
            raise PluginError(f"{what} needs {parameter.name}; write {usage(name, factory)}")
    return given


def _parts(text: str) -> list[str]:
    if not text:
        return []
    (row,) = csv.reader([text], skipinitialspace=True)
    return [part.strip() for part in row]


def _parameters(factory: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """The parameters that can be passed by name and written as text."""
    try:
        parameters = inspect.signature(factory).parameters
    except (TypeError, ValueError):  # some classes written in C
        return {}
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    hints = _hints(factory)
    return {
        name: parameter
        for name, parameter in parameters.items()
        if parameter.kind in named
        and ((hint := _hint(parameter, hints)) in (None, str, int, float, bool, Path) or _choices(hint))
    }


def _hints(factory: Callable[..., Any]) -> dict[str, Any]:
    try:
        return get_type_hints(factory.__init__ if inspect.isclass(factory) else factory)
    except Exception:  # ignore a user's annotations that cannot be evaluated
        return {}


def _hint(parameter: inspect.Parameter, hints: Mapping[str, Any]) -> Any:
    """A parameter's type: its annotation without None, or the type of its default."""
    hint = hints.get(parameter.name)
    if get_origin(hint) in (Union, types.UnionType):
        (hint, *_) = [each for each in get_args(hint) if each is not type(None)]
    if hint is None and isinstance(parameter.default, (bool, int, float)):
        return type(parameter.default)
    return hint


def _choices(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) is Literal else ()


def _converted(what: str, text: str, hint: Any) -> Any:
    """A value converted from text to its type. Raises `PluginError`."""
    choices = {str(choice): choice for choice in _choices(hint)} or (_SWITCH if hint is bool else {})
    if choices:
        if text not in choices:
            raise PluginError(f"{what} is {text!r}; it is {'yes or no' if hint is bool else ' or '.join(choices)}")
        return choices[text]
    if not text:
        raise PluginError(f"{what} has no value")
    if hint in (int, float):
        try:
            return hint(text)
        except ValueError:
            wanted = "a whole number" if hint is int else "a number"
            raise PluginError(f"{what} is {text!r}; it is {wanted}") from None
    return Path(text).expanduser() if hint is Path else text


def one_line(error: BaseException) -> str:
    """An error of a user's own code in one line, with the place where it arose."""
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, SyntaxError):
        frames.clear()  # its text names file and line; the frames are those of the import
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return visible(" ".join(f"{type(error).__name__}: {error}".split())[:300]) + place
