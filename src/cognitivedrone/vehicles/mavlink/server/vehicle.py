"""The simulator as a MAVLink vehicle: it behaves like ArduCopter, so that ground stations can fly it.

One `SimulatedVehicle` is one world of a `Simulator`, the flight modes that control it, and its ports. The vehicle has
its own time: `step` advances it, `serve` does so at the pace of the wall clock.
The protocol: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import select
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cognitivedrone.errors import RunError
from cognitivedrone.frames import yaw_of
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.gate_monitor import GateEvent
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.types import DroneState, FloatArray, Image
from cognitivedrone.vehicles.mavlink.server.commands import Commands, Peer
from cognitivedrone.vehicles.mavlink.server.modes import FlightModes, Mode, Severity
from cognitivedrone.vehicles.mavlink.server.parameters import TABLE, Parameters
from cognitivedrone.vehicles.mavlink.server.ports import Address, Port, open_port
from cognitivedrone.vehicles.mavlink.server.reports import REPORTS, VehicleSnapshot, battery_volts
from cognitivedrone.vehicles.mavlink.telemetry import dialect

STEP_TICKS = BatchedFlight.SAMPLE_TICKS
STEP_S = STEP_TICKS * BatchedFlight.TICK_S
"""Period of `SimulatedVehicle.step`, s."""
SYSTEM, COMPONENT = 1, 1
"""The vehicle's ids; the component is MAV_COMP_ID_AUTOPILOT1."""
FORGET_S = 30.0
"""A UDP peer that is silent for this long is forgotten."""
_PARAMETERS_PER_STEP = 4
_SETTLE_S = 2.0
_MOST_BEHIND_S = 0.25


@dataclass(frozen=True, slots=True)
class VehicleConfig:
    """Configuration of a simulated vehicle."""

    links: tuple[str, ...] = ("udpout:127.0.0.1:14550", "tcpin:127.0.0.1:5760")
    """`udpout:host:port` sends first, as a listening ground station expects; `udpin` and `tcpin` listen. There is no
    authentication: use addresses other than the loopback only on purpose."""
    battery_minutes: float = 15.0
    """Flight time of a full battery."""

    def __post_init__(self) -> None:
        if not self.links:
            raise RunError("a simulated vehicle needs a link, such as udpout:127.0.0.1:14550")


class SimulatedVehicle:
    """A quadrotor on the floor, below the initial position of the simulator's drone, that waits for a ground station.

    Use it as a context manager, or call `close`. All methods are thread-safe. Raises `MissingExtra` without pymavlink,
    `RunError` if a port cannot be opened. The simulator must have one world; the caller keeps ownership.
    `judge` is called with every event at a gate, and may show another stage.
    """

    def __init__(
        self,
        simulator: Simulator,
        config: VehicleConfig | None = None,
        judge: Callable[[GateEvent], None] = lambda _: None,
    ) -> None:
        if simulator.worlds != 1:
            raise RunError(f"a vehicle is one world; this simulator has {simulator.worlds}")
        self.config = config or VehicleConfig()
        self.simulator = simulator
        self._judge = judge
        self.time = 0.0
        """Since the vehicle started, s."""
        self.battery = 1.0
        """Remaining charge, 0 to 1; may be set."""
        self._m = dialect()
        self._lock = threading.RLock()
        self._steps = 0
        self.parameters = Parameters()
        self.modes = FlightModes(self.parameters, self._stand(), self.say)
        self._commands = Commands(self._m, self)
        self._peers: dict[tuple[Port, Address], Peer] = {}
        self._ports: list[Port] = []
        try:
            for text in self.config.links:
                self._ports.append(open_port(text))
        except RunError:
            self.close()
            raise

    def __enter__(self) -> SimulatedVehicle:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def addresses(self) -> tuple[Address, ...]:
        """Host and port of each link, as bound."""
        return tuple(port.address for port in self._ports)

    def step(self, count: int = 1) -> None:
        """Receive, decide, fly and report, `count` times `STEP_S`; does not wait."""
        for _ in range(count):
            with self._lock:
                self.listen()
                state = self.simulator.state(0)
                self.modes.voltage = battery_volts(self.battery)
                self.simulator.command(0, self.modes.update(state, self.time))
                (gate_event,) = self.simulator.advance(STEP_TICKS)
                if gate_event is not None:
                    self._judge(gate_event)
                self._steps += 1
                self.time = self._steps * STEP_S
                if self.modes.armed:
                    self.battery = max(0.0, self.battery - STEP_S / (60 * self.config.battery_minutes))
                self._report()

    def listen(self) -> None:
        """Process and answer received messages; no simulated time passes."""
        with self._lock:
            for port in self._ports:
                self._listen_at(port)

    def pilot(self, mode: Mode, sticks: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> None:
        """Act as the pilot with the remote control: switch mode, and hold sticks that command a velocity.

        sticks: heading frame, m/s and rad/s; flown in STABILIZE, ALT_HOLD and LOITER.
        """
        with self._lock:
            self.modes.set_mode(mode)
            self.modes.sticks = np.array(sticks)

    def frame(self) -> Image:
        """Current first-person view (size, size, 3); needs a simulator with cameras and a stage."""
        with self._lock:
            frame: Image = self.simulator.frames()[0]
            return frame

    def state(self) -> DroneState:
        """True state."""
        with self._lock:
            return self.simulator.state(0)

    def say(self, severity: Severity, text: str) -> None:
        """Send a STATUSTEXT to all peers, truncated to the protocol's 50 characters."""
        payload = text.encode("ascii", "replace")[:50]
        with self._lock:
            for peer in list(self._peers.values()):
                peer.mav.statustext_send(int(severity), payload)

    def sockets(self) -> list[Any]:
        """Sockets to wait on for incoming data."""
        with self._lock:
            return [each for port in self._ports for each in port.sockets()]

    def snapshot(self) -> VehicleSnapshot:
        """The current state, for reports."""
        return VehicleSnapshot(self.time, self.simulator.state(0), self.modes, self.battery)

    def close(self) -> None:
        """Release the ports."""
        with self._lock:
            for port in self._ports:
                port.close()
            self._ports, self._peers = [], {}

    def _stand(self) -> FloatArray:
        """Put the drone on the floor and let it come to rest; returns its position (3,), world, m."""
        flight = self.simulator.flight
        here = flight.position[0]
        low = np.array([here[0], here[1], self.simulator.airframe.hull_radius])
        flight.reset(0, low, float(yaw_of(flight.quaternion[0])))
        for _ in range(round(_SETTLE_S / STEP_S)):
            self.simulator.command(0, np.array([0.0, 0.0, -0.5, 0.0]))
            flight.advance(STEP_TICKS)
        position: FloatArray = flight.position[0].copy()
        return position

    def _listen_at(self, port: Port) -> None:
        for address in port.peers():
            if (port, address) not in self._peers:
                self._greet(self._new_peer(port, address))
        for address, data in port.receive():
            # An unknown sender gets a parser for this datagram only, and becomes a peer with its first valid packet.
            peer = self._peers.get((port, address)) or self._new_peer(port, address)
            if port.datagrams:
                peer.mav.buf, peer.mav.buf_index = bytearray(), 0
            for message in peer.mav.parse_buffer(data) or ():
                if message.get_type() == "BAD_DATA" or not self._for_us(message):
                    continue
                if (port, address) not in self._peers:
                    self._greet(peer)
                peer.received_at = self.time
                self._commands.heed(peer, message)
        for peer in [peer for (its, _), peer in self._peers.items() if its is port]:
            silent = not port.datagrams or self.time - peer.received_at >= FORGET_S
            if silent and peer.address not in port.peers():
                del self._peers[port, peer.address]

    def _for_us(self, message: Any) -> bool:
        """Whether a message is addressed to this vehicle or to all, and is not its own."""
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return message.get_srcSystem() != SYSTEM and system in (0, SYSTEM) and component in (0, COMPONENT)

    def _new_peer(self, port: Port, address: Address) -> Peer:
        peer = Peer(port, address, None, self.time)
        peer.mav = self._m.MAVLink(peer, srcSystem=SYSTEM, srcComponent=COMPONENT)
        peer.mav.robust_parsing = True
        return peer

    def _greet(self, peer: Peer) -> None:
        """Add a peer, and say what it talks to."""
        self._peers[peer.port, peer.address] = peer
        peer.mav.statustext_send(int(Severity.INFO), b"CognitiveDrone: a simulated copter")

    def _report(self) -> None:
        """Send every report that is due."""
        snapshot: VehicleSnapshot | None = None
        for peer in list(self._peers.values()):
            for name in [peer.parameters.popleft() for _ in range(min(_PARAMETERS_PER_STEP, len(peer.parameters)))]:
                self.send_parameter(peer, name)
            for name, rate in peer.rates.items():
                if rate <= 0 or self.time < peer.due.get(name, 0.0) - 1e-9:
                    continue
                # The next is due one period after the last, without catching up on missed ones.
                peer.due[name] = max(peer.due.get(name, self.time) + 1 / rate, self.time)
                snapshot = snapshot or self.snapshot()
                peer.mav.send(REPORTS[name][0](self._m, snapshot))

    def send_parameter(self, peer: Peer, name: str) -> None:
        """Send PARAM_VALUE."""
        m = self._m
        kind = {"int8": m.MAV_PARAM_TYPE_INT8, "int16": m.MAV_PARAM_TYPE_INT16, "float": m.MAV_PARAM_TYPE_REAL32}
        p = self.parameters
        peer.mav.param_value_send(name.encode(), p[name], kind[TABLE[name].kind], len(p), list(p).index(name))


def serve(vehicle: SimulatedVehicle, stop: Callable[[], bool], *, speed: float = 1.0) -> float:
    """Fly until `stop()` is true, at `speed` times the wall clock; returns the seconds that it fell behind.

    Messages are answered as they arrive. On a slow machine the vehicle's time runs slower, but never jumps.
    """
    if not 0 < speed <= 100:
        raise RunError(f"--speed is {speed:g}; give more than 0, at most 100")
    period, lost = STEP_S / speed, 0.0
    due = time.monotonic()
    while not stop():
        wait = due - time.monotonic()
        if wait > 0:
            if select.select(vehicle.sockets(), [], [], wait)[0]:
                vehicle.listen()
            continue
        vehicle.step()
        due += period
        behind = time.monotonic() - due
        if behind > _MOST_BEHIND_S:
            lost, due = lost + behind, due + behind
    return lost
