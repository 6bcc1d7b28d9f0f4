"""Vehicles: what a pilot flies, all behind the contract of `vehicles.contract`.

`VEHICLES` names them; `--link` takes the name, with what follows its colon for those that need an address.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cognitivedrone import registry
from cognitivedrone.errors import RunError
from cognitivedrone.plan import Scenario, VehicleSpec

if TYPE_CHECKING:
    from cognitivedrone.vehicles.contract import Request, Vehicle

VEHICLES: dict[str, str] = {
    "sim": "cognitivedrone.vehicles.simulated:open_sim",
    "sitl": "cognitivedrone.vehicles.sitl.session:open_sitl",
    "gazebo": "cognitivedrone.vehicles.gazebo.pilot:open_gazebo_vehicle",
    "mavlink": "cognitivedrone.vehicles.mavlink.session:open_mavlink",
}


def open_vehicle(request: Request) -> Vehicle:
    """The vehicle that is asked for, on the ground, nothing armed; its `close` ends it.

    Raises `LinkError`, `GazeboError`, `CameraError` or `MissingExtra` where it cannot be had or must not be flown.
    """
    vehicle: Vehicle = registry.load("link", request.spec.kind, VEHICLES)(request)
    return vehicle


def check_vehicle(spec: VehicleSpec, scenario: Scenario) -> None:
    """Raise `RunError` for a scenario that a vehicle cannot fly, `LinkError` for a program that is missing."""
    autopilot_file(spec)
    if spec.kind != "gazebo":
        return
    if scenario.airframe != "iris":
        raise RunError("--link gazebo flies the Iris, which is modelled there; add --airframe iris")
    if scenario.wind:
        raise RunError("no wind blows in the world that Gazebo runs; leave --wind out")


def autopilot_file(spec: VehicleSpec) -> Path | None:
    """The program that is started to fly, if there is one; raises `LinkError` where it cannot be found."""
    if spec.kind != "sitl":
        return None
    from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE, find_binary

    return find_binary(spec.sitl, f"give --sitl PATH or set {BINARY_VARIABLE} to its path")
