"""The connection to a Ray cluster, for commands that spread their work over several machines."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from cognitivedrone.errors import CognitiveDroneError, UsageError, import_extra
from cognitivedrone.system import refusal
from cognitivedrone.system.processes import isolated
from cognitivedrone.system.usage_reports import switch_off


def import_ray() -> Any:
    """The Ray module; raises `MissingExtra` if it is not installed, `UsageError` on Windows."""
    if refused := refusal("--executor ray"):
        raise UsageError(refused)
    switch_off()
    return import_extra("ray", "ray")


class _KnownPaths(list[str]):
    """Paths of modules that Ray gives to its workers: of the driver's working directory nothing, unless it is a path
    of the driver's modules, too.
    """

    def extend(self, paths: Iterable[str]) -> None:
        super().extend(path for path in paths if path in sys.path)


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
        settings = ray.job_config.JobConfig()
        settings._py_driver_sys_path = _KnownPaths()
        with isolated():
            ray.init(include_dashboard=False, log_to_driver=False, logging_level="error", job_config=settings)
    except Exception as problem:  # Ray's own, some of no special class
        where = os.environ.get("RAY_ADDRESS", "this machine")
        raise error(f"the Ray cluster at {where} cannot be used ({problem}); 'ray status' shows its state") from None
    try:
        yield ray
    finally:
        ray.shutdown()
