"""What attacks are made of: a function that returns why the package fell, and the command run in a watched folder."""

from __future__ import annotations

import atexit
import contextlib
import copy
import io
import os
import shutil
import signal
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from cognitivedrone.cli import main
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.text.printable import unprintable

PROJECT = Path(__file__).resolve().parents[1]
MARK = "OWNED"
"""A file or folder of this name shows that an attack's code ran."""
SECRET = "the-attacker-must-not-get-this"  # noqa: S105 - looked for in what is written
SMOKE = ("--suite", "open-v1:smoke", "--episodes", "1", "--workers", "0")
"""One short flight, in this process."""
LONGEST_S = 60
"""An attack that keeps the command busy for longer has fallen it."""


@dataclass(frozen=True)
class Attack:
    """One attack."""

    kind: str
    name: str
    run: Callable[[Path], str]
    """In a folder of its own; returns why the package fell, in a sentence, or an empty text if it held."""
    limit_s: int = LONGEST_S


class TooLong(BaseException):
    """An attack keeps the program busy."""


def scratch() -> Path:
    """A folder that is gone when this process ends."""
    folder = tempfile.mkdtemp(prefix="attacks-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


@contextlib.contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    """Raise `TooLong` in what takes longer."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def outcome(attack: Attack, folder: Path) -> str:
    """Run an attack in a new folder, with a secret beside it; why the package fell, or an empty text."""
    work = folder / "work"
    work.mkdir(parents=True)
    secret = folder / "secret.txt"
    secret.write_text(SECRET)
    here = Path.cwd()
    os.chdir(work)
    try:
        with time_limit(attack.limit_s):
            fell = attack.run(work)
    except TooLong:
        fell = f"busy for more than {attack.limit_s} s"
    except (Exception, SystemExit) as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        fell = f"raised {type(error).__name__}: {str(error)[:200]} ({Path(last.filename).name}, line {last.lineno})"
    finally:
        os.chdir(here)
    return fell or traces(folder)


def traces(folder: Path) -> str:
    """What attacks leave behind where they succeed."""
    for path in sorted(folder.rglob("*")):
        if path.name == MARK:
            return f"{path.name} was made: the attack's code ran"
    if (folder / "secret.txt").read_text() != SECRET:
        return "a file outside the folder was overwritten"
    copies = [path for path in (folder / "work").rglob("*") if path.is_file() and not path.is_symlink()]
    if any(SECRET.encode() in beginning(path) for path in copies):
        return "a file outside the folder was copied"
    return ""


def beginning(path: Path) -> bytes:
    """As much of a file as may hold a copy of the secret: some attacks leave sparse files of terabytes."""
    with path.open("rb") as file:
        return file.read(1 << 20)


@dataclass(frozen=True)
class Ended:
    """How the command ended."""

    code: int
    out: str
    err: str


def command(*words: object) -> Ended:
    """The command, in this process. What it raises beyond `SystemExit` is a fall."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main([str(word) for word in words])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    return Ended(code, out.getvalue(), err.getvalue())


def refused(*words: object, says: str = "") -> Callable[[Path], str]:
    """The command must end with exit code 2 and one sentence."""

    def run(folder: Path) -> str:
        return why_not_refused(command(*words), says)

    return run


def why_not_refused(ended: Ended, says: str = "") -> str:
    """Why an end of the command is no refusal in one sentence; empty if it is."""
    if ended.code != 2:
        return f"exit code {ended.code}: {(ended.out + ended.err)[-200:]!r}"
    if "Traceback" in ended.err:
        return f"a traceback: {ended.err[-200:]!r}"
    shown = ended.err.replace("\n", "").replace("\x1b", "") if "╭" in ended.err else ended.err.replace("\n", "")
    if found := unprintable(shown):
        return f"{found} was printed"
    if says not in ended.err:
        return f"refused for another reason: {ended.err[-200:]!r}"
    return ""


def told(act: Callable[[Path], object]) -> Callable[[Path], str]:
    """The call must end with one of the package's errors, in a sentence that can be shown."""

    def run(folder: Path) -> str:
        try:
            found = act(folder)
        except CognitiveDroneError as error:
            text = str(error)
            lines = "\n" in text
            return f"{lines and 'a line end'} was said: {text[:99]!r}" if lines or unprintable(text) else ""
        return f"it was taken: {found!r:.99}"

    return run


def taken(act: Callable[[Path], object]) -> Callable[[Path], str]:
    """The call must not fail: what it gets is odd, but harmless."""

    def run(folder: Path) -> str:
        try:
            act(folder)
        except CognitiveDroneError as error:
            return f"harmless, but refused: {str(error)[:150]!r}"
        return ""

    return run


def refused_in(write: Callable[[Path], object], *words: object) -> Callable[[Path], str]:
    def run(folder: Path) -> str:
        write(folder)
        return why_not_refused(command(*words))

    return run


def each(kind: str, runs: Mapping[str, Callable[[Path], str]]) -> list[Attack]:
    """Attacks of one kind, by name."""
    return [Attack(kind, name, run) for name, run in runs.items()]


def changed(document: Any, change: Callable[[Any], object]) -> Any:
    """A deep copy of a JSON document with a change."""
    made = copy.deepcopy(document)
    change(made)
    return made
