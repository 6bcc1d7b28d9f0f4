"""Commands as they are typed in a folder, run in this process: a Python that starts and loads all takes seconds."""

import io
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

import pytest

from cognitivedrone.cli import main


def typed(arguments: Sequence[object], folder: Path, **environment: str) -> str:
    """What the command prints; fails where it does not end well. A `PYTHONPATH` counts from the folder."""
    words, code = list(map(str, arguments)), None
    with _in(folder, environment), redirect_stdout(io.StringIO()) as printed:
        try:
            main(words)
        except SystemExit as end:
            code = end.code
    assert not code, f"{shlex.join(words)}\n{printed.getvalue()}"
    return printed.getvalue()


@contextmanager
def _in(folder: Path, environment: dict[str, str]) -> Iterator[None]:
    """As a process of its own would be; modules of the folder are forgotten afterwards."""
    known = set(sys.modules)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, value in environment.items():
            patch.setenv(name, value)
        for path in filter(None, environment.get("PYTHONPATH", "").split(os.pathsep)):
            patch.syspath_prepend(folder / path)
        try:
            yield
        finally:
            for name in set(sys.modules) - known:
                file = getattr(sys.modules[name], "__file__", None)
                if file and Path(file).is_relative_to(folder):
                    del sys.modules[name]
