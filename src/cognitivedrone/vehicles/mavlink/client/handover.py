"""What we still do for a vehicle that is not ours any more: nothing that acts against its pilot, or keeps it up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, Autopilot
from cognitivedrone.vehicles.mavlink.client.checks.parameters import ACTS_IN_FLIGHT
from cognitivedrone.vehicles.mavlink.telemetry import Telemetry

RESTORE_S = 3.0
"""For the vehicle's parameters to be put back; what is not is left to the next start."""
ENDS_BY_ITSELF: Final = frozenset({"LAND", "RTL", "SMART_RTL", "AUTO_RTL", "AUTO", "PRECLAND", "MISSION"})
"""Modes that a pilot may choose and that end on the ground by themselves. Our silence would change them: `FS_OPTIONS`
spares only what a pilot flies."""


def must_beat(telemetry: Telemetry, changed: Iterable[str], passed_s: float, autopilot: Autopilot = ARDUPILOT) -> bool:
    """Whether our heartbeats still serve it, so long after the hand-over, with these parameters not put back yet.

    Silent, they let its own failsafe act, should nobody fly it. In a mode that ends on the ground by itself that would
    act against its pilot, and so would what we have set, until it is put back. What flies by a stream of velocities
    acts when those stop, whatever our heartbeats do, and by these alone also in its pilot's modes.
    """
    if autopilot.flies_by_stream:
        return True
    restoring = passed_s < RESTORE_S and not ACTS_IN_FLIGHT.isdisjoint(changed)
    return not telemetry.armed or restoring or telemetry.mode in ENDS_BY_ITSELF
