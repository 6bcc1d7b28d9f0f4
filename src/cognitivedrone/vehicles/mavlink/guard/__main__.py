"""`python -m cognitivedrone.vehicles.mavlink.guard SETTINGS`: started by `SupervisedDrone`, never by hand.

SETTINGS is JSON: the link's URL, the rules, how the vehicle is talked to, and the files that were inherited.
"""

from __future__ import annotations

import gc
import pickle
import socket
import sys
from contextlib import suppress

from cognitivedrone.control.safety import SafetyConfig
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.system import come_first, end_of
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.client.transport import PacketLog
from cognitivedrone.vehicles.mavlink.guard.messages import MessageSocket, Reply, from_json
from cognitivedrone.vehicles.mavlink.guard.process import FAILED, GuardProcess


def main() -> int:
    """Guard; returns the exit code."""
    settings = parse_json(sys.argv[1], non_finite=True)
    end, framed = socket.socket(fileno=settings["pilot"]), settings["framed"]
    end.setblocking(False)
    pilot = MessageSocket(end, framed)
    come_first()  # before the log has its thread, which holds the interpreter at times and must not be left waiting
    log = PacketLog(open(settings["log"], "wb", buffering=0) if settings["log"] >= 0 else None)  # noqa: PTH123, SIM115
    try:
        guard = GuardProcess(
            pilot,
            settings["url"],
            from_json(SafetyConfig, settings["safety"]),
            from_json(MavlinkConfig, settings["config"]),
            log,
            end_of(settings["process"]),
        )
    except CognitiveDroneError as error:
        with suppress(OSError):
            pilot.send(pickle.dumps(Reply("failed", str(error))))
        return FAILED
    gc.freeze()
    return guard.run()


if __name__ == "__main__":
    sys.exit(main())
