"""Version and runtime environment of CognitiveDrone."""

from __future__ import annotations

import platform
from importlib import metadata

from cognitivedrone import __version__, checkout


def version_line() -> str:
    """Version, commit of a checkout, Python and MuJoCo: the first line of a bug report."""
    commit = checkout.commit()
    source = f" (git {commit})" if commit else ""
    try:
        mujoco = metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        mujoco = "not installed"
    return f"cognitivedrone {__version__}{source}, Python {platform.python_version()}, MuJoCo {mujoco}"
