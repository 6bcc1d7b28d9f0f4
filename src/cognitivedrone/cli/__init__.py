"""The `cognitivedrone` command: table of commands, help, and reporting of user errors.

A command's module is loaded only when that command runs, and its parser knows only that command's options: so help
is fast, and the error for a misspelt option lists the options of the same command.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import os
import re
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any, NoReturn

import docstring_parser
import tyro
from docstring_parser import Docstring, DocstringStyle

from cognitivedrone.cli.streams import prepare_streams
from cognitivedrone.errors import CognitiveDroneError, MissingExtra, UsageError, did_you_mean, plain_warnings
from cognitivedrone.files import reason_of
from cognitivedrone.ranges import check_arguments, check_words
from cognitivedrone.system.imports import hidden_module, switch_off
from cognitivedrone.system.interrupts import STOPPED, ending_in_order, was_asked
from cognitivedrone.system.processes import SAFE_PATH
from cognitivedrone.system.shortages import way_out_of
from cognitivedrone.text.printable import message, wrapped

PROGRAM = "cognitivedrone"
Ending = Callable[[], AbstractContextManager[None]]
"""Makes the context in which signals end a command."""
COMMANDS: dict[str, dict[str, tuple[str, str]]] = {
    "score policies": {
        "bench": ("scoring:bench", "fly a policy through a suite of tasks and score it"),
        "merge": ("scoring:merge", "join the shards of a run"),
        "compare": ("scoring:compare", "compare two runs, task by task"),
        "film": ("scoring:film", "film an episode of a run: flight.mp4, flight.html"),
        "view": ("scoring:view", "draw what the drone sees at the start of a task"),
        "submit": ("scoring:submit", "make a file for the leaderboard from finished runs"),
        "verify": ("scoring:verify", "fly a sample of a leaderboard file again"),
        "reason": ("scoring:reason", "score a reasoner alone, without flying"),
        "predict": ("scoring:predict", "score a policy's actions on recorded flights"),
        "doctor": ("scoring:doctor", "say what is wrong with a policy: input, output, timing"),
        "audit": ("scoring:audit", "fly a pilot with one thing changed at a time"),
        "sweep": ("scoring:sweep", "fly a suite with increasing latency and plot the success rate"),
        "list": ("scoring:list_names", "names for the options: suites, policies, reasoners, airframes"),
    },
    "fly": {
        "play": ("flying:play", "the live page: say what to fly to, and watch it think and fly"),
        "fly": ("flying:fly", "fly the simulator, ArduPilot or a real drone by instruction"),
        "sim": ("flying:sim", "serve the simulator as a MAVLink vehicle"),
        "gazebo export": ("flying:export_world", "write tasks as worlds for Gazebo"),
        "gazebo check": ("flying:check_world", "check worlds with Gazebo's own parser"),
    },
    "serve": {
        "serve": ("serving:serve", "serve a policy and a reasoner to remote clients"),
    },
    "collect data and train": {
        "collect": ("data:collect", "collect a data set of expert flights"),
        "data show": ("data:show", "counts, lengths and actions of a data set"),
        "data report": ("data:report_card", "a page with film strips and statistics"),
        "data verify": ("data:verify", "check every shard against its hash"),
        "data export": ("data:export", "write a data set as RLDS, LeRobot, published or MCAP"),
        "data import": ("data:import_", "import a data set of another format"),
        "data replay": ("data:replay", "fly a recorded episode again"),
        "train": ("training:train", "train a small model"),
        "train-openvla": ("training:train_openvla", "fine-tune OpenVLA-7B"),
    },
    "share": {
        "hub push": ("hub:push", "upload a model or a data set to the Hugging Face Hub"),
        "hub pull": ("hub:pull", "download a model or a data set from there"),
    },
}
"""Module and function in this package, and one line of help, for every command; words of a command are separated by
blanks. The keys are the headings of the help."""
TARGETS = {name: target for group in COMMANDS.values() for name, (target, _) in group.items()}
FIRST = (
    ("bench --suite open-v1:smoke", "score the small VLA on 30 tasks"),
    ("view --suite open-v1:test --episode 29", "draw the drone's view of a task: view.png"),
    ("play", "the live page: type an instruction, watch the drone think and fly"),
)
"""Suggested first commands."""
UNEXPECTED = 1
"""Exit code of a command that ends by an error of the program's own."""
_LONGEST_ERROR = 300


@plain_warnings()
def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; a user error ends in one sentence and exit code 2, any other error in one and exit code 1."""
    prepare_streams()
    switch_off()
    ours = arguments is None  # else we run in a process of somebody else's, whose signals are not ours
    if ours:
        # Our own Python processes must not import modules that happen to lie in the current folder, such as json.py.
        os.environ.setdefault(SAFE_PATH, "1")
    try:
        ending: Ending = ending_in_order if ours else contextlib.nullcontext
        _run(list(sys.argv[1:] if arguments is None else arguments), ending)
        sys.stdout.flush()  # a full disk behind it shows up here, not after the last line
    except CognitiveDroneError as error:
        if isinstance(error, MissingExtra) and _was_stopped(error, ours):
            _end("stopped", STOPPED)
        _end(str(error), error.exit_code)
    except BrokenPipeError:
        _drop_output()  # the reader of the output has closed it
        sys.exit(1)
    except OSError as error:
        place = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
        _drop_output()
        _end(f"{place}{reason_of(error)}; {way_out_of(error) or 'check the free space and the permissions'}")
    except MemoryError as error:
        _end(f"there is not enough memory; {way_out_of(error)}")
    except KeyboardInterrupt as stop:
        _end(str(stop) or "stopped", STOPPED)
    except Exception as error:
        if _was_stopped(error, ours):
            _end("stopped", STOPPED)  # ctrl-C in foreign code, such as a compiled module being loaded, which then fails
        _drop_output()
        _end(_unexpected(error), UNEXPECTED)


def _unexpected(error: Exception) -> str:
    """The sentence for what nothing else has caught, with the place of its traceback."""
    told = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    if hidden := hidden_module():
        return hidden
    sentence = f"an error that nobody expected: {' '.join(told.split())[:_LONGEST_ERROR]}"
    text = message("".join(traceback.format_exception(error)))
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix=f"{PROGRAM}-error-", suffix=".txt", delete=False, encoding="utf-8", errors="backslashreplace"
        ) as file:
            file.write(text)
    except OSError:  # no room for it
        return f"{sentence}; please report it, with this traceback:\n{text.rstrip()}"
    return f"{sentence}; please report it, with the traceback that is in {file.name}"


def _was_stopped(error: BaseException, ours: bool) -> bool:
    """Whether an error is what became of Ctrl-C; `ours` if the process is this command's."""
    causes = [error]
    while (cause := causes[-1].__cause__ or causes[-1].__context__) is not None and cause not in causes:
        causes.append(cause)
    return (ours and was_asked()) or any(isinstance(cause, KeyboardInterrupt) for cause in causes)


def _run(arguments: list[str], ending: Ending) -> None:
    """Run a command; `ending` makes the context in which signals end it."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(help_text())  # noqa: T201
        return
    if arguments[0] == "--version":
        from cognitivedrone.cli.version import version_line

        print(version_line())  # noqa: T201
        return
    name = next((name for name in (" ".join(arguments[:2]), arguments[0]) if name in TARGETS), None)
    if name is None:
        _explain(arguments)
        return
    command = load(name)
    if command.__doc__ is not None:
        command.__doc__ = command.__doc__.replace(":\n\n", ":\n")  # of which tyro's help would make two blank lines
    docstring_parser.parse_from_object = _parse_from_object
    words = arguments[len(name.split()) :]
    check_words(words)
    tyro.cli(_checked(command, ending), prog=f"{PROGRAM} {name}", args=words)


def _parse_from_object(obj: Any, style: DocstringStyle = DocstringStyle.AUTO) -> Docstring:
    """The docstring of an object, for tyro, which would break an attribute's lines as they are in the source."""
    found = _as_in_the_source(obj, style)
    for each in found.params:
        each.description = re.sub(r"(?<!\n)\n(?![\n\s-])", " ", inspect.cleandoc(each.description or ""))
    return found


_as_in_the_source = docstring_parser.parse_from_object


def _checked(command: Callable[..., None], ending: Ending) -> Callable[..., None]:
    """The command, which begins once its arguments are in their ranges."""

    @functools.wraps(command)
    def begin(*values: Any, **named: Any) -> None:
        check_arguments(command, inspect.signature(command).bind(*values, **named).arguments)
        with ending():
            command(*values, **named)

    return begin


def load(name: str) -> Callable[..., Any]:
    """The function of a command, such as "bench" or "data show"."""
    module, _, function = TARGETS[name].partition(":")
    loaded: Callable[..., Any] = getattr(importlib.import_module(f"{__name__}.{module}"), function)
    return loaded


def help_text(first_word: str = "") -> str:
    """The commands under their headings, or those that begin with a word such as "data"."""
    lines = [f"usage: {PROGRAM} {first_word or 'COMMAND'} ..."]
    if not first_word:
        lines += ["", "Language-driven drones: score policies, fly them, collect data, train.", "", "try first:"]
        for command, effect in FIRST:
            lines += [f"  {PROGRAM} {command}", f"      {effect}"]
    for heading, commands in COMMANDS.items():
        shown = {name: text for name, (_, text) in commands.items() if first_word in ("", name.partition(" ")[0])}
        if shown:
            lines += ["", f"{heading}:", *(f"  {name:<17}{text}" for name, text in shown.items())]
    lines += ["", "COMMAND --help lists its options; --version shows the installed version."]
    return "\n".join(lines)


def _explain(arguments: list[str]) -> None:
    """Help for a first word that several commands share; raises `UsageError` for an unknown command."""
    first = arguments[0]
    second = {name.partition(" ")[2] for name in TARGETS if name.startswith(f"{first} ")}
    if second and (len(arguments) == 1 or arguments[1] in ("-h", "--help")):
        print(help_text(first))  # noqa: T201
        return
    if second:
        raise UsageError(f"unknown command '{first} {arguments[1]}'; {did_you_mean(arguments[1], second)}")
    known = {name.partition(" ")[0] for name in TARGETS}
    what = "option" if first.startswith("-") else "command"
    raise UsageError(f"unknown {what} {first!r}; {did_you_mean(first, known)}")


def _end(sentence: str, code: int = 2) -> NoReturn:
    _report(sentence)
    sys.exit(code)


def _report(sentence: str) -> None:
    print(wrapped(f"{PROGRAM}: {sentence}", sys.stderr), file=sys.stderr)  # noqa: T201


def _drop_output() -> None:
    """Discard output that standard output refuses, so that the process does not report the error again at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
