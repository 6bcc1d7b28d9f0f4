"""An ArduCopter or a PX4 over MAVLink as a `Drone` with its `Clock`, guarded from within this process: for simulations.

    with MavlinkDrone("udp:127.0.0.1:14550", camera, Guard()) as drone:
        drone.take_off(confirm)
        fly(drone, policy, drone, mission)

Leaving the block, by its end, by an error or by ctrl-C, lands a drone that is still ours. A policy that holds the
interpreter stops the rules of safety with it: `fly` flies by `SupervisedDrone` (`vehicles/mavlink/guard`), which is the
same with the rules in a process of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from time import sleep

import numpy as np

from cognitivedrone.control.safety import Decision, Order, SafetyConfig, order
from cognitivedrone.control.safety.health import Health
from cognitivedrone.errors import LinkError
from cognitivedrone.types import Action, Observation
from cognitivedrone.vehicles.camera import Camera
from cognitivedrone.vehicles.checklist import Checklist
from cognitivedrone.vehicles.mavlink.client.core import PAUSE_S, FlightCore, LandingMode
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.client.health import FlightGuard
from cognitivedrone.vehicles.mavlink.client.link.connection import MavlinkConnection
from cognitivedrone.vehicles.mavlink.client.link.tlog import PacketLog, open_log
from cognitivedrone.vehicles.mavlink.telemetry import Telemetry


class MavlinkDrone:
    """Connects when it is made: waits for the vehicle and checks that it is a copter on ArduPilot or PX4.

    The camera is its own from then on, and closed with it, also where it cannot be made. Raises `LinkError` for what
    cannot be reached or flown, `MissingExtra` without pymavlink.
    """

    def __init__(self, url: str, camera: Camera, guard: FlightGuard, config: MavlinkConfig | None = None) -> None:
        self.config = config or MavlinkConfig()
        self.camera = camera
        with ExitStack() as undo:
            undo.callback(camera.close)
            log = PacketLog(None if self.config.tlog is None else open_log(self.config.tlog))
            undo.callback(log.close)
            self._core = FlightCore(url, guard, self.config, log=log.put)
            undo.callback(self._core.close)
            self._core.meet()
            self.vehicle, self.simulated = self._core.met.vehicle, self._core.met.simulated
            """The vehicle, and whether it identifies itself as this project's simulator."""
            self._undo = undo.pop_all()

    def __enter__(self) -> MavlinkDrone:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def link(self) -> MavlinkConnection:
        """The conversation with the vehicle."""
        return self._core.link

    @property
    def telemetry(self) -> Telemetry:
        """The newest values that the vehicle has reported."""
        return self._core.telemetry

    @property
    def decision(self) -> Decision | None:
        """The guard's last one; none before take-off."""
        return self._core.decision

    @property
    def over(self) -> str | None:
        """Why the flight is over, once it lands or has been taken over; a mission ends then."""
        return self._core.over

    def checklist(self) -> Checklist:
        """Read what safety leans on, set what may be set, and list it all."""
        return self._core.checklist(self.camera.read().age_s)

    def take_off(self, confirm: Callable[[Checklist], bool]) -> None:
        """Wait until it is ready, have a person confirm the checklist, arm, and climb: `FlightCore.take_off`."""
        self._core.take_off(confirm, lambda: self.camera.read().age_s)

    def observe(self) -> Observation:
        """Newest frame and state; the height is above the place of take-off."""
        self.link.check()
        shot = self.camera.read()
        self._core.seen(shot.age_s)
        state = self.telemetry
        return Observation(
            image=shot.image,
            instruction="",
            velocity=state.heading_velocity,
            height=float(state.position[2] - self._core.home[2]),
            yaw_rate=state.yaw_rate,
            time=self.now(),
        )

    def send(self, action: Action) -> Action:
        """Ask for a velocity; returns what was sent, zeros where the guard holds, brakes, lands or has let go."""
        self.link.check()
        return self._core.command(action)

    def now(self) -> float:
        """Seconds since the end of the take-off."""
        return self._core.clock() - self._core.start

    @property
    def resolution_s(self) -> float:
        """Steps of the clock: on vehicle time it goes on with the telemetry."""
        return 0.0 if self.config.clock == "wall" else 1 / self.config.stream_hz

    def sleep_until(self, time: float) -> None:
        """Wait; on vehicle time, raises `LinkError` where that stands still."""
        if self.config.clock == "wall":
            sleep(max(0.0, time - self.now()))
            return
        while (before := self.now()) < time:
            if not self.link.until(lambda: self.now() > before, PAUSE_S):
                raise LinkError(f"the vehicle's time has stood still for {PAUSE_S:g} s; is its simulation paused?")

    def land(self, mode: LandingMode = "LAND") -> None:
        """Land where it is, or fly back first, and wait for the motors to stop; nothing where it is not ours.

        Raises `LinkError` where it has not landed in time.
        """
        if self._core.phase in ("ground", "released"):
            return
        self.link.check()
        self._core.land("the flight is over", mode)
        self._core.wait_for_landing()

    def close(self) -> None:
        """Land a drone that is still ours, then hang up."""
        with self._undo:
            self.land()


class PassThroughGuard:
    """Passes every command while the vehicle is ours and armed: where a gate monitor judges, no rule holds it back.

    Decides `hands_off`, permanently, if the motors stop or a mode appears that we did not order. One that never `lands`
    is let go at the end: its process ends in the air. Wall-clock times mean nothing here, where the vehicle's time may
    stand still.
    """

    def __init__(self, *, lands: bool = True) -> None:
        self._lands, self._landing, self._over = lands, "", ""

    def judge(self, health: Health) -> Decision:
        """Fly, land, or hands off."""
        if not self._over and not health.armed:
            self._over = "the motors were stopped"
        if not self._over and health.mode not in health.ordered_modes:
            self._over = f"the mode became {health.mode}"
        if self._over:
            return Decision("hands_off", self._over)
        return Decision("land", self._landing) if self._landing else Decision("fly", "")

    def shape(self, health: Health) -> Action:
        """The command, unchanged."""
        return np.zeros(4, dtype=np.float32) if health.command is None else health.command.astype(np.float32)

    def order(self, decision: Decision, health: Health, landing: str) -> Order:
        """To land, as the rules do; nothing where it never lands."""
        return order(decision, health, SafetyConfig(), landing) if self._lands else Order()

    def land(self, reason: str) -> None:
        """Land from now on, or let go."""
        if self._lands:
            self._landing = self._landing or reason
        else:
            self._over = self._over or reason
