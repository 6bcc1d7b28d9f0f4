"""The connection to a Ray cluster, for commands that spread their work over several machines."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cognitivedrone.errors import CognitiveDroneError, import_extra


def import_ray() -> Any:
    """The Ray module; raises `MissingExtra` if it is not installed."""
    return import_extra("ray", "ray")


@contextmanager
def ray_cluster(error: type[CognitiveDroneError]) -> Iterator[Any]:
    """The Ray module, connected to the cluster that `RAY_ADDRESS` names, or to one on this machine.

    A connection that the caller's process already had is used and stays open. Raises `MissingExtra` if Ray is not
    installed, and `error` if the cluster does not answer.
    """
    ray = import_ray()
    if ray.is_initialized():
        yield ray
        return
    try:
        ray.init(include_dashboard=False, log_to_driver=False, logging_level="error")
    except Exception as problem:  # Ray's own, some of no special class
        where = os.environ.get("RAY_ADDRESS", "this machine")
        raise error(f"the Ray cluster at {where} cannot be used ({problem}); 'ray status' shows its state") from None
    try:
        yield ray
    finally:
        ray.shutdown()
