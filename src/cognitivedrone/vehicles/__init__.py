"""Vehicles: everything that a pilot can fly, all with the interface of `vehicles.contract`.

`VEHICLES` lists them; `--link` takes the name, followed by a colon and an address for those that need one.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from cognitivedrone import registry
from cognitivedrone.errors import LinkError, RunError
from cognitivedrone.plan import Scenario, VehicleSpec
from cognitivedrone.types import Track

if TYPE_CHECKING:
    from cognitivedrone.vehicles.contract import Request, Vehicle

VEHICLES: dict[str, str] = {
    "sim": "cognitivedrone.vehicles.simulated:open_sim",
    "sitl": "cognitivedrone.vehicles.sitl.session:open_sitl",
    "gazebo": "cognitivedrone.vehicles.gazebo.flight:open_gazebo_vehicle",
    "mavlink": "cognitivedrone.vehicles.mavlink.session:open_mavlink",
}


def open_vehicle(request: Request) -> Vehicle:
    """Open the requested vehicle, on the ground and disarmed; close it with `close`.

    Raises `LinkError`, `GazeboError`, `CameraError` or `MissingExtra` if it cannot be opened or must not be flown.
    """
    kind = request.spec.kind
    if request.down and not (kind == "sim" or (kind == "sitl" and request.pace == "lockstep")):
        raise LinkError(f"--link {kind} has no camera that looks down, which the policy needs; fly it with --link sim")
    vehicle: Vehicle = registry.load("link", kind, VEHICLES)(request)
    return vehicle


def check_vehicle(spec: VehicleSpec, scenario: Scenario) -> None:
    """Raise `RunError` for a scenario that a vehicle cannot fly."""
    if spec.kind != "gazebo":
        return
    if scenario.airframe != "iris":
        raise RunError("--link gazebo flies the Iris, the only airframe modelled there; add --airframe iris")
    if scenario.appearance == "photo":
        raise RunError("the exported Gazebo worlds have no photographed places; leave --appearance and --place out")
    if scenario.wind:
        raise RunError("the exported Gazebo worlds have no wind; leave --wind out")


def check_tracks(spec: VehicleSpec, tracks: Iterable[Track]) -> None:
    """Raise `RunError` for a track that a vehicle cannot fly."""
    if spec.kind != "gazebo":
        return
    for task in (task for track in tracks for task in track):
        if task.landing:
            lacks = "is a landing, and worlds in Gazebo have no pads"
        elif any(each.sway for each in (*task.obstacles, *(task.layout or ()))):
            lacks = "has a gate or an obstacle that moves, and worlds in Gazebo stand still"
        else:
            continue
        raise RunError(f"task {task.id} {lacks}; fly it with --link sim or sitl")


def autopilot_file(spec: VehicleSpec) -> Path | None:
    """The autopilot program that the vehicle starts, if any; raises `LinkError` if it cannot be found."""
    if spec.kind != "sitl":
        return None
    from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE, find_binary

    return find_binary(spec.sitl, f"give --sitl PATH or set {BINARY_VARIABLE} to its path")
