"""Which CognitiveDrone this is, and on what it runs."""

from __future__ import annotations

import platform
from importlib import metadata

from cognitivedrone import __version__, checkout


def version_line() -> str:
    """Version, commit of a checkout, Python and MuJoCo: what a report of a fault should begin with."""
    commit = checkout.commit()
    source = f" (git {commit})" if commit else ""
    try:
        mujoco = metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        mujoco = "not installed"
    return f"cognitivedrone {__version__}{source}, Python {platform.python_version()}, MuJoCo {mujoco}"
