"""The error tree. Every message names the place and the fix; the CLI prints it alone and exits with 2,
or the error's own `exit_code`.

CognitiveDroneError
├── UsageError       an unknown command, a value out of its range
│   └── UnknownOption    an option that there is not; also a TypeError
├── TaskError        a malformed task or task file, an unknown family or suite
├── LabelError       an unknown label, pack or style, an unreadable image
├── RenderError      no OpenGL to render with
├── SimulationError  flight conditions that cannot be simulated, such as a negative wind or an unreadable delay
│   ├── AirframeError    an unknown airframe
│   └── AppearanceError  an unknown appearance of the scene
├── PolicyError      a policy or reasoner that cannot be made or cannot fly
│   ├── PluginError      an unknown policy, reasoner or other plug-in, or arguments that it does not take
│   ├── ModelError       a model file or checkpoint that is missing, damaged, too large or of another kind
│   ├── ServerError      a server that a policy or reasoner needs and that does not answer or refuses
│   ├── GroundTruthError an oracle in a flight that has no ground truth
│   ├── ActionError      an action of another shape than (k, 4), or not of numbers
│   │   └── NonFiniteAction
│   └── PolicyRaised
├── ReasonerError    a reasoner's answer that is missing or unusable; the flight continues
├── MessageError     a message between a policy server and a client that is malformed or refused
├── RunError         a benchmark run that cannot start, continue or be read
├── DataError        a data set that cannot be written, read or trusted
├── HubError         a model or data set that cannot be pushed to or pulled from the Hugging Face Hub, or may not be
├── TrainingError    a training run that cannot start or continue, or a checkpoint that cannot be read
├── NotUnderstood    a sentence that names nothing known; exit code 3
├── LinkError        a vehicle that cannot be reached, refuses a command, or cannot be flown
├── GazeboError      a Gazebo world that cannot be exported or checked, or a Gazebo that does not answer
├── CameraError      a camera that cannot be opened, stopped sending frames, or reached the end of its file
└── MissingExtra     an optional dependency is not installed
"""

from __future__ import annotations

import difflib
import importlib
import shlex
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any
from urllib.parse import unquote, urlsplit

from cognitivedrone.choices import MessageFault as MessageFault
from cognitivedrone.choices import ReasonerFault as ReasonerFault
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.text.printable import visible, without_secrets, wrapped


class CognitiveDroneError(Exception):
    """Base of everything this package raises on purpose.

    Messages repeat texts of others: of policies, servers and files. What no file or terminal takes, such as a lone
    surrogate, is shown as an escape sequence, and addresses without their secrets.
    """

    exit_code = 2
    """Of the command that it ends."""

    def __init__(self, *parts: object) -> None:
        super().__init__(*(_shown(part) if isinstance(part, str) else part for part in parts))

    def __reduce__(self) -> tuple[Any, ...]:
        return _remade, (type(self), self.args, self.__dict__)


class UsageError(CognitiveDroneError):
    """An unknown command."""


class UnknownOption(UsageError, TypeError):
    """A keyword argument that is none of the options; also a `TypeError`, as Python raises it."""


class TaskError(CognitiveDroneError):
    """A malformed task or task file, an unknown family or suite."""


class LabelError(CognitiveDroneError):
    """An unknown label, pack or style, or an unreadable image."""


class RenderError(CognitiveDroneError):
    """No OpenGL to render with."""


class FirstFrameError(RenderError):
    """A graphics card that takes contexts but returns no frame, as with too many processes on it."""


class SimulationError(CognitiveDroneError):
    """Flight conditions that cannot be simulated, such as a negative wind or an unreadable delay."""


class AirframeError(SimulationError):
    """An unknown airframe."""


class AppearanceError(SimulationError):
    """An unknown appearance of the scene."""


class PolicyError(CognitiveDroneError):
    """A policy or reasoner that cannot be made or cannot fly."""


class PluginError(PolicyError):
    """An unknown policy, reasoner or other plug-in, or arguments that it does not take."""


class ModelError(PolicyError):
    """A model file or checkpoint that is missing, damaged, too large for this machine or of another kind."""


class ServerError(PolicyError):
    """A server that a policy or reasoner needs and that does not answer, refuses the key or lacks the model."""


class GroundTruthError(PolicyError):
    """An oracle in a flight that has no ground truth, such as that of a real vehicle."""


class ActionError(PolicyError):
    """An action of another shape than (k, 4), or not of numbers."""


class NonFiniteAction(ActionError):
    """The policy returned a NaN or infinite velocity: the flight ends, the benchmark run continues."""


class PolicyRaised(PolicyError):
    """A policy or reasoner raised an exception of its own: the flight ends, the benchmark run continues."""

    def __init__(self, message: str, trace: str) -> None:
        super().__init__(message)
        self.trace = _shown(trace)
        """The traceback."""


class ReasonerError(CognitiveDroneError):
    """A reasoner's answer that is missing or unusable: counted by `kind`, and the flight continues."""

    def __init__(self, kind: ReasonerFault, message: str, trace: str = "", *, certainty: float | None = None) -> None:
        super().__init__(message)
        self.kind: ReasonerFault = kind
        self.trace = _shown(trace)
        """The traceback, where the reasoner raised an exception of its own."""
        self.certainty = certainty
        """Of a reasoner that saw the scene and is undecided: how likely a gate matches the instruction, and its best
        answer right, 0 to 1."""


class MessageError(CognitiveDroneError):
    """A message between a policy server and a client that is malformed or refused."""

    def __init__(self, code: MessageFault, message: str) -> None:
        super().__init__(message)
        self.code: MessageFault = code


class RunError(CognitiveDroneError):
    """A benchmark run that cannot start, continue or be read."""


class DataError(CognitiveDroneError):
    """A data set that cannot be written, read or trusted."""


class HubError(CognitiveDroneError):
    """A model or data set that cannot be pushed to or pulled from the Hugging Face Hub, or may not be."""


class TrainingError(CognitiveDroneError):
    """A training run that cannot start or continue, or a checkpoint that cannot be read."""


class NotUnderstood(CognitiveDroneError):
    """A sentence that names nothing known: which words, and what is nearest to them."""

    exit_code = 3


class LinkError(CognitiveDroneError):
    """A vehicle that cannot be reached, refuses a command, or cannot be flown."""


class GazeboError(CognitiveDroneError):
    """A world that cannot be exported or checked, or a Gazebo that cannot be reached or does not answer."""


class CameraError(CognitiveDroneError):
    """A camera that cannot be opened, stopped sending frames, or reached the end of its file."""


class MissingExtra(CognitiveDroneError):
    """An optional dependency is not installed; one that no extra has is installed by its own name."""

    def __init__(self, package: str, extra: str | None) -> None:
        of = "" if extra is None else f"; it comes with cognitivedrone[{extra}]"
        command = f"{_installer()[0]} {package}" if extra is None else install_command(extra)
        super().__init__(f"{package} is not installed{of}: {command}")


def _remade(kind: type[CognitiveDroneError], arguments: tuple[Any, ...], state: dict[str, Any]) -> CognitiveDroneError:
    """An error that arrives from another process, whatever its class was made with."""
    error = kind.__new__(kind)
    error.args = arguments
    error.__dict__.update(state)
    return error


def _shown(text: str) -> str:
    return visible(without_secrets(text), keep="\n\t")


def import_extra(module: str, extra: str, package: str | None = None) -> Any:
    """Import a module of an optional dependency; raises `MissingExtra` for `package`, or for the missing module."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise MissingExtra(package or str(error.name or module), extra) from None


def install_command(extra: str) -> str:
    """The command that adds an extra to this installation: same source, same installer.

    A checkout, wheel or repository is reinstalled from the same place; the package index is used only if it was before.
    """
    command, origin = _installer()
    source = parse_json(origin)
    url = source.get("url", "")
    if source.get("dir_info", {}).get("editable"):
        return f"{command} -e {shlex.quote(unquote(urlsplit(url).path) + f'[{extra}]')}"
    if revision := source.get("vcs_info"):
        url = f"{revision['vcs']}+{url}@{revision['commit_id']}"
    return f"{command} {shlex.quote(f'cognitivedrone[{extra}]' + (f' @ {url}' if url else ''))}"


def _installer() -> tuple[str, str]:
    """The command that installs into this environment, and where this package came from (direct_url.json)."""
    from importlib import metadata

    installer, origin = "pip", "{}"
    with suppress(metadata.PackageNotFoundError):  # sources that were put on the path, never installed
        this = metadata.distribution("cognitivedrone")
        installer = (this.read_text("INSTALLER") or "pip").strip()
        origin = this.read_text("direct_url.json") or "{}"
    python = shlex.quote(sys.executable)
    return f"uv pip install --python {python}" if installer == "uv" else f"{python} -m pip install", origin


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A closing hint for "unknown name" messages: similar names, or all names if there are few."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.6)
    if near:
        return "did you mean " + " or ".join(repr(n) for n in near) + "?"
    if len(known) <= 16:
        return "known: " + ", ".join(known)
    return f"known: {', '.join(known[:12])}, ... ({len(known)} in all)"


@contextmanager
def plain_warnings() -> Iterator[None]:
    """Print warnings as sentences, without source locations, while a command or worker process runs."""
    before = warnings.formatwarning
    warnings.formatwarning = lambda text, *_args, **_more: wrapped(f"warning: {text}", sys.stderr) + "\n"
    try:
        yield
    finally:
        warnings.formatwarning = before
