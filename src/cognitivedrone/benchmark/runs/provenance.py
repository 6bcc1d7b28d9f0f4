"""Provenance of a run besides its options: machine, commit, the user's own modules, command line."""

from __future__ import annotations

import importlib.util
import os
import platform
import shlex
import sysconfig
from collections.abc import Mapping
from pathlib import Path

from cognitivedrone import checkout, system
from cognitivedrone.policies import POLICIES
from cognitivedrone.reasoners import REASONERS
from cognitivedrone.system.interrupts import is_ctrl_c


def platform_facts(command: str, policy: str = "", reasoner: str = "") -> dict[str, str]:
    """The machine, the source and the command, as text.

    For a user's own policy or reasoner ("module:attribute") this includes the file of its module, and the command
    includes the PYTHONPATH that finds it.
    """
    facts = {
        "command": command,
        "commit": checkout.commit() or "none",
        "system": system.name(),
        "machine": platform.machine(),
        "processor": system.processor(),
        "cores": str(os.cpu_count() or 1),
    }
    roots: list[str] = []
    for kind, name, table in (("policy", policy, POLICIES), ("reasoner", reasoner, REASONERS)):
        file = own_module(name, table)
        if file is None:
            continue
        facts[f"{kind}_file"] = _shown(file)
        root = _root(file, name.partition(":")[0])
        roots += [_shown(root)] if root not in _installed() and _shown(root) not in roots else []
    if roots:
        facts["command"] = f"PYTHONPATH={shlex.quote(os.pathsep.join(roots))} {command}"
    return facts


def own_module(name: str, table: Mapping[str, str]) -> Path | None:
    """The source file of a user's own plug-in "module:attribute"; none for names in `table`, or without a file."""
    module, colon, _ = name.partition(":")
    if not colon or module in table:
        return None
    try:
        spec = importlib.util.find_spec(module)
    except BaseException as error:  # whatever the user's package raises; making the plug-in reports it
        if is_ctrl_c(error):
            raise
        return None
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return None
    return Path(spec.origin).resolve()


def _root(file: Path, module: str) -> Path:
    """The folder on the module path that contains `module`."""
    levels = module.count(".") + (file.name == "__init__.py")
    return file.parents[levels]


def _installed() -> set[Path]:
    """Folders that need no PYTHONPATH."""
    return {Path(path).resolve() for path in sysconfig.get_paths().values()}


def _shown(path: Path) -> str:
    """The path, relative to the current folder if it is inside it."""
    here = Path.cwd().resolve()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
