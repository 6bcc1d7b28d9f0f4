"""Runs commands as on macOS or Windows: our modules get views of `os`, `signal` ... without what is not there.

What a system lacks is read from the types of the standard library that mypy brings (typeshed), not from a list here.
`environment` makes an interpreter and all that it starts such a system, by `foreign_views.py`.
"""

import ast
import functools
import json
import os
from collections.abc import Iterator
from pathlib import Path

SYSTEMS = ("darwin", "win32")
MODULES = ("os", "signal", "time", "socket", "select", "faulthandler")
WHOLE = ("fcntl", "grp", "msvcrt", "pty", "pwd", "resource", "syslog", "termios", "tty", "winreg", "_winapi")


@functools.cache
def lacking(system: str) -> dict[str, frozenset[str]]:
    """For each of these modules, the names of Linux that a system lacks."""
    return {module: _names(module, "linux") - _names(module, system) for module in (*MODULES, *WHOLE)}


def absent(system: str) -> frozenset[str]:
    """Those of these modules that a system lacks as a whole."""
    return frozenset(module for module in WHOLE if 4 * len(_names(module, system)) < max(map(len, _everywhere(module))))


def _everywhere(module: str) -> list[frozenset[str]]:
    return [_names(module, system) for system in ("linux", *SYSTEMS)]


@functools.cache
def _names(module: str, system: str) -> frozenset[str]:
    import mypy

    stubs = Path(mypy.__file__).parent / "typeshed/stdlib"
    file = next(path for path in (stubs / f"{module}.pyi", stubs / module / "__init__.pyi") if path.exists())
    names = frozenset(_defined(ast.parse(file.read_text(encoding="utf-8")).body, system))
    return names if module != "socket" else names | _names("_socket", system)


def _defined(body: list[ast.stmt], system: str) -> Iterator[str]:
    for statement in body:
        if isinstance(statement, ast.If):
            yield from _defined(statement.body if _true(statement.test, system) else statement.orelse, system)
        elif isinstance(statement, ast.FunctionDef | ast.ClassDef):
            yield statement.name
        elif isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            yield statement.target.id
        elif isinstance(statement, ast.Assign):
            yield from (target.id for target in statement.targets if isinstance(target, ast.Name))
        elif isinstance(statement, ast.ImportFrom) and statement.module and statement.module.startswith("_"):
            yield from (alias.asname or alias.name for alias in statement.names)


def _true(test: ast.expr, system: str) -> bool:
    class Sys:
        platform = system
        version_info = (3, 11)

    return bool(eval(ast.unparse(test), {"sys": Sys, "TYPE_CHECKING": True}))  # noqa: S307


def environment(system: str, folder: Path) -> dict[str, str]:
    """The environment in which Python is such a system; what it needs at its start is written into `folder`."""
    table = {module: sorted(names) for module, names in lacking(system).items() if module not in absent(system)}
    start = f"import sys\nsys.path.append({str(Path(__file__).parent)!r})\n"
    (folder / "sitecustomize.py").write_text(f"{start}import foreign_views\nforeign_views.install({system!r})\n")
    (folder / "lacking.json").write_text(json.dumps({"names": table, "modules": sorted(absent(system))}))
    return {**os.environ, "PYTHONPATH": str(folder), "FOREIGN": str(folder / "lacking.json")}
