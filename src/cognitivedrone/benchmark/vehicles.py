"""What flies in a benchmark: our own simulator, or an autopilot in another process, on our physics or in Gazebo."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from cognitivedrone.benchmark.run_types import RunConfig
from cognitivedrone.errors import RunError
from cognitivedrone.sim.airframe import AIRFRAMES, Airframe
from cognitivedrone.sim.gl import renderer_name
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.vehicles.one_drone import LinkReport, OneDrone
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE, find_binary


@dataclass(frozen=True, slots=True)
class Linked:
    """A simulator of one world, and the link behind it."""

    simulator: Simulator
    flight: OneDrone | None = None
    """What another program flies; none in our own simulator."""
    renderer: Callable[[], str] = renderer_name
    """Name of what draws the frames."""

    @property
    def report(self) -> LinkReport:
        """What has happened on the link so far; all zeros where there is none."""
        return self.flight.report if self.flight else LinkReport()

    @property
    def trouble(self) -> str:
        """Why the last vehicle was lost, in words; empty where none was."""
        return self.flight.trouble if self.flight else ""


def autopilot_file(config: RunConfig) -> Path | None:
    """The program that we start to fly, if there is one.

    Raises `LinkError` where it cannot be found, `RunError` for options that do not go with it.
    """
    if config.link == "sim":
        return None
    if config.link == "gazebo":
        _check_gazebo(config)
        return None
    return find_binary(None, f"set {BINARY_VARIABLE} to its path")


def open_link(config: RunConfig, undo: ExitStack) -> Linked:
    """The simulator that the options ask for; `undo` closes it, and what flies in it."""
    binary, airframe = autopilot_file(config), AIRFRAMES[config.airframe]
    if config.link == "gazebo":
        return _open_gazebo(airframe, undo)
    if binary is None:
        simulator = Simulator(1, airframe=airframe)
        undo.callback(simulator.close)
        return Linked(simulator)
    from cognitivedrone.vehicles.sitl.flight import SitlFlight

    flight = SitlFlight(binary, airframe)
    undo.callback(flight.close)
    simulator = Simulator(1, airframe=airframe, flight=flight)
    undo.callback(simulator.close)
    return Linked(simulator, flight)


def _check_gazebo(config: RunConfig) -> None:
    """Raise `RunError` for options that a running Gazebo has no place for."""
    if config.airframe != "iris":
        raise RunError("--link gazebo flies the Iris, which is modelled there; add --airframe iris")
    if config.wind:
        raise RunError("no wind blows in the world that Gazebo runs; leave --wind out")
    if config.workers not in (None, 0, 1):
        raise RunError(f"one vehicle flies in Gazebo, so --workers {config.workers} is too many; leave it out")


def _open_gazebo(airframe: Airframe, undo: ExitStack) -> Linked:
    from cognitivedrone.vehicles.gazebo.pilot import open_gazebo

    flight = undo.enter_context(open_gazebo())
    simulator = Simulator(1, airframe=airframe, flight=flight, eyes=flight)
    undo.callback(simulator.close)
    return Linked(simulator, flight, lambda: flight.renderer)
