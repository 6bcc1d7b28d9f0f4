"""`python -m cognitivedrone.vehicles.mavlink.guard SETTINGS`: started by `GuardedDrone`, never by hand.

SETTINGS is JSON: the link's URL, the rules, how the vehicle is talked to, and the files that were inherited.
"""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import socket
import sys
from contextlib import suppress

from cognitivedrone.control.safety import SafetyConfig
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.json_text import parse_json
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.client.tlog import PacketLog
from cognitivedrone.vehicles.mavlink.guard.messages import Reply, from_json
from cognitivedrone.vehicles.mavlink.guard.process import FAILED, GuardProcess

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4


def main() -> int:
    """Guard; returns the exit code."""
    settings = parse_json(sys.argv[1], non_finite=True)
    pilot = socket.socket(fileno=settings["pilot"])
    pilot.setblocking(False)
    log = PacketLog(socket.socket(fileno=settings["log"]) if settings["log"] >= 0 else None)
    _come_first()
    try:
        guard = GuardProcess(
            pilot,
            settings["url"],
            from_json(SafetyConfig, settings["safety"]),
            from_json(MavlinkConfig, settings["config"]),
            log,
            _watched(settings["process"]),
        )
    except CognitiveDroneError as error:
        with suppress(OSError):
            pilot.send(Reply("failed", str(error)).pack())
        return FAILED
    gc.freeze()
    return guard.run()


def _watched(process: int) -> int:
    """A file that becomes readable when the pilot process ends; -1 where the system has none."""
    try:
        return os.pidfd_open(process)
    except (AttributeError, OSError):
        return -1


def _come_first() -> None:
    """Ask to run before others and to stay in memory; without the permission the guard does without."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except OSError:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, -10)
    # Under a limit, memory that is asked for later would be refused instead.
    if os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT)


if __name__ == "__main__":
    sys.exit(main())
