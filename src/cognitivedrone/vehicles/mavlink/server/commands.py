"""MAVLink message handlers of the simulated vehicle: commands, modes, parameters, velocities, streams.

Results and refusals follow ArduCopter: https://ardupilot.org/dev/docs/mavlink-commands.html.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cognitivedrone.frames import enu_to_ned, flu_to_frd, rotate_yaw, yaw_of
from cognitivedrone.types import FloatArray
from cognitivedrone.vehicles.mavlink.server.modes import Mode, Severity
from cognitivedrone.vehicles.mavlink.server.ports import Address, Port
from cognitivedrone.vehicles.mavlink.server.reports import REPORTS

if TYPE_CHECKING:
    from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle

MAX_RATE_HZ = 100.0
"""Maximum rate of a stream: one message per step."""
_LOCAL_FRAMES, _BODY_FRAMES = (1, 7), (8, 9)  # MAV_FRAME
_POSITION, _VELOCITY, _ACCELERATION, _FORCE, _YAW, _YAW_RATE = 0x007, 0x038, 0x1C0, 0x200, 0x400, 0x800
"""Of POSITION_TARGET_TYPEMASK, which leaves out; but `_FORCE`, which says that an acceleration is a force."""


@dataclass(eq=False)
class Peer:
    """A peer at the other end of a link."""

    port: Port
    address: Address
    mav: Any
    """pymavlink's encoder and parser."""
    received_at: float
    """Time of its last message, s."""
    rates: dict[str, float] = field(default_factory=lambda: {name: rate for name, (_, rate) in REPORTS.items()})
    due: dict[str, float] = field(default_factory=dict)
    parameters: deque[str] = field(default_factory=deque)
    """Parameters still to be sent."""

    def write(self, data: bytes) -> None:
        """Called by `mav` to send bytes."""
        self.port.send(self.address, data)


class Commands:
    """The message handlers of one vehicle."""

    def __init__(self, m: Any, vehicle: SimulatedVehicle) -> None:
        self._m = m
        self._vehicle = vehicle
        self._modes = vehicle.modes
        self._ids = {getattr(m, f"MAVLINK_MSG_ID_{name}"): name for name in REPORTS}
        self._refusal_sent = -math.inf
        self._messages: dict[str, Callable[[Peer, Any], None]] = {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": self._command,
            "SET_MODE": self._set_mode,
            "PARAM_REQUEST_LIST": self._list_parameters,
            "PARAM_REQUEST_READ": self._read_parameter,
            "PARAM_SET": self._set_parameter,
            "SET_POSITION_TARGET_LOCAL_NED": self._aim,
            "REQUEST_DATA_STREAM": self._data_stream,
            "MISSION_REQUEST_LIST": self._no_mission,
            "TIMESYNC": self._timesync,
        }
        self._commands: dict[int, Callable[[Peer, list[float]], int]] = {
            m.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            m.MAV_CMD_NAV_TAKEOFF: lambda _, p: self._done(self._modes.take_off(p[6])),
            m.MAV_CMD_NAV_LAND: lambda _, _p: self._switch(Mode.LAND),
            m.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _, _p: self._switch(Mode.RTL),
            m.MAV_CMD_DO_SET_MODE: lambda _, p: self._switch(p[1], _whole(p[0])),
            m.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            m.MAV_CMD_REQUEST_MESSAGE: lambda peer, p: self._report(peer, _whole(p[0])),
        }

    def heed(self, peer: Peer, message: Any) -> None:
        """Process one message and answer it; unknown messages are ignored."""
        if (handler := self._messages.get(message.get_type())) is not None:
            handler(peer, message)

    def _heartbeat(self, _peer: Peer, message: Any) -> None:
        if message.get_srcSystem() == self._vehicle.parameters["SYSID_MYGCS"]:
            self._modes.note_ground_station()

    def _command(self, peer: Peer, message: Any) -> None:
        handler = self._commands.get(message.command)
        values = [getattr(message, f"param{i}") for i in range(1, 8)]
        result = self._m.MAV_RESULT_UNSUPPORTED if handler is None else handler(peer, values)
        self._acknowledge(peer, message, message.command, result)

    def _acknowledge(self, peer: Peer, message: Any, command: int, result: int) -> None:
        peer.mav.command_ack_send(command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent())

    def _done(self, refusal: str | None) -> int:
        """The MAVLink result for a refusal or none; a refusal is announced to all peers."""
        if refusal is None:
            return int(self._m.MAV_RESULT_ACCEPTED)
        self._vehicle.say(Severity.CRITICAL, refusal)
        return int(self._m.MAV_RESULT_FAILED)

    def _arm(self, _peer: Peer, p: list[float]) -> int:
        if p[0] not in (0.0, 1.0):
            return int(self._m.MAV_RESULT_UNSUPPORTED)
        return self._done(self._modes.arm() if p[0] else self._modes.disarm())

    def _switch(self, mode: float, base_mode: int = 1) -> int:
        """To a mode by its number, if the lowest bit says that it is ArduCopter's own."""
        return self._done(self._modes.set_mode(_whole(mode))) if base_mode & 1 else int(self._m.MAV_RESULT_DENIED)

    def _set_mode(self, peer: Peer, message: Any) -> None:
        result = self._switch(message.custom_mode, message.base_mode)
        self._acknowledge(peer, message, self._m.MAVLINK_MSG_ID_SET_MODE, result)

    def _aim(self, _peer: Peer, t: Any) -> None:
        """Follow a velocity in GUIDED; a target that is not supported stops the vehicle."""
        vehicle = self._vehicle
        if self._modes.mode != Mode.GUIDED:
            return
        velocity = np.array([t.vx, t.vy, t.vz], dtype=np.float64)
        yaw_rate = 0.0 if t.type_mask & _YAW_RATE else t.yaw_rate
        if not (refusal := _refusal(t, velocity, yaw_rate)):
            self._modes.aim(self._world(t.coordinate_frame, velocity), -yaw_rate)
            return
        self._modes.aim(None)
        if vehicle.time - self._refusal_sent >= 1.0:  # setpoints may arrive at 50 Hz; limit the messages
            self._refusal_sent = vehicle.time
            vehicle.say(Severity.WARNING, f"Target refused: {refusal}")

    def _world(self, frame: int, velocity: FloatArray) -> FloatArray:
        """(3,) world, m/s. A body-frame velocity is rotated once, by the current heading."""
        if frame in _BODY_FRAMES:
            return rotate_yaw(flu_to_frd(velocity), float(yaw_of(self._vehicle.state().quaternion)))
        return enu_to_ned(velocity)

    def _list_parameters(self, peer: Peer, _message: Any) -> None:
        peer.parameters = deque(self._vehicle.parameters)

    def _read_parameter(self, peer: Peer, message: Any) -> None:
        table, index = self._vehicle.parameters, message.param_index
        name = message.param_id if index < 0 else list(table)[index] if index < len(table) else None
        if name in table:
            self._vehicle.send_parameter(peer, str(name))

    def _set_parameter(self, peer: Peer, message: Any) -> None:
        """Change a parameter; the answer is the current value, whether or not the change was accepted."""
        table = self._vehicle.parameters
        if message.param_id not in table:
            return
        if refusal := table.set(message.param_id, float(message.param_value)):
            self._vehicle.say(Severity.WARNING, refusal)
        self._vehicle.send_parameter(peer, message.param_id)

    def _rate(self, peer: Peer, name: str, rate: float) -> None:
        peer.rates[name] = min(rate, MAX_RATE_HZ)
        peer.due[name] = self._vehicle.time

    def _set_interval(self, peer: Peer, p: list[float]) -> int:
        name, interval = self._ids.get(_whole(p[0])), p[1]  # us; -1 stops, 0 is the default rate
        if name is None or not math.isfinite(interval):
            return int(self._m.MAV_RESULT_DENIED)
        self._rate(peer, name, 0.0 if interval < 0 else REPORTS[name][1] if interval == 0 else 1e6 / interval)
        return int(self._m.MAV_RESULT_ACCEPTED)

    def _report(self, peer: Peer, number: int) -> int:
        if (name := self._ids.get(number)) is None:
            return int(self._m.MAV_RESULT_DENIED)
        peer.mav.send(REPORTS[name][0](self._m, self._vehicle.snapshot()))
        return int(self._m.MAV_RESULT_ACCEPTED)

    def _data_stream(self, peer: Peer, message: Any) -> None:
        """The older request: sets all streams at once, whichever group is named."""
        for name, (_, usual) in REPORTS.items():
            if usual > 0 and name != "HEARTBEAT":
                self._rate(peer, name, float(message.req_message_rate) if message.start_stop else 0.0)

    def _no_mission(self, peer: Peer, message: Any) -> None:
        peer.mav.mission_count_send(message.get_srcSystem(), message.get_srcComponent(), 0, message.mission_type)

    def _timesync(self, peer: Peer, message: Any) -> None:
        if message.tc1 == 0:
            peer.mav.timesync_send(round(self._vehicle.time * 1e9), message.ts1)


def _refusal(t: Any, velocity: FloatArray, yaw_rate: float) -> str:
    """Why a SET_POSITION_TARGET_LOCAL_NED is not flown, as text; empty for a velocity.

    A part of it is ignored if any of its bits is set. Acceleration next to a velocity is ignored.
    """
    if t.coordinate_frame not in _LOCAL_FRAMES + _BODY_FRAMES:
        return f"frame {t.coordinate_frame} is not supported"
    if t.type_mask & _VELOCITY or not t.type_mask & _POSITION:
        return "give a velocity, and no position"
    if t.type_mask & _FORCE and not t.type_mask & _ACCELERATION:
        return "force is not supported"
    if not t.type_mask & _YAW:
        return "give a yaw rate, and no yaw"
    return "" if np.isfinite(velocity).all() and math.isfinite(yaw_rate) else "it is not a number"


def _whole(value: float) -> int:
    """An integer from a float parameter; -1 if it is not an integer."""
    return int(value) if math.isfinite(value) and value == int(value) else -1
