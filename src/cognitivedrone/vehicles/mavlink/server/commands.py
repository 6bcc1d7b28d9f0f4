"""MAVLink message handlers of the simulated vehicle: commands, modes, parameters, setpoints, streams, missions.

Results and refusals follow ArduCopter: https://ardupilot.org/dev/docs/mavlink-commands.html.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from cognitivedrone.types import DroneState
from cognitivedrone.vehicles.mavlink.server.modes import FlightModes, Mode, Severity
from cognitivedrone.vehicles.mavlink.server.parameters import Parameters
from cognitivedrone.vehicles.mavlink.server.reports import REPORTS, VehicleSnapshot
from cognitivedrone.vehicles.mavlink.server.targets import (
    GLOBAL_FRAMES,
    LOCAL_FRAMES,
    PositionTarget,
    Setpoint,
    TargetHeading,
    compass_to_world,
    decode,
)

MAX_RATE_HZ = 100.0
"""Maximum rate of a stream: one message per step."""
_POSITION_ONLY = 0x0FF8


class Peer(Protocol):
    """Sender of a message: what an answer needs."""

    mav: Any
    rates: dict[str, float]
    due: dict[str, float]
    parameters: Any


class CommandedVehicle(Protocol):
    """The vehicle that commands act on."""

    time: float
    parameters: Parameters
    modes: FlightModes

    def state(self) -> DroneState:
        """True state."""
        ...

    def say(self, severity: Severity, text: str) -> None:
        """Send a STATUSTEXT to all peers."""
        ...

    def snapshot(self) -> VehicleSnapshot:
        """The current state, for reports."""
        ...

    def send_parameter(self, peer: Any, name: str) -> None:
        """Send PARAM_VALUE."""
        ...


class Commands:
    """The message handlers of one vehicle."""

    def __init__(self, m: Any, vehicle: CommandedVehicle) -> None:
        self._m = m
        self._vehicle = vehicle
        self._modes = vehicle.modes
        self._ids = {getattr(m, f"MAVLINK_MSG_ID_{name}"): name for name in REPORTS}
        self._refusal_sent = -math.inf
        self._messages: dict[str, Callable[[Any, Any], None]] = {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": self._command_long,
            "COMMAND_INT": self._command_int,
            "SET_MODE": self._set_mode,
            "PARAM_REQUEST_LIST": self._list_parameters,
            "PARAM_REQUEST_READ": self._read_parameter,
            "PARAM_SET": self._set_parameter,
            "SET_POSITION_TARGET_LOCAL_NED": self._local_target,
            "SET_POSITION_TARGET_GLOBAL_INT": self._global_target,
            "REQUEST_DATA_STREAM": self._data_stream,
            "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_COUNT": self._mission_upload,
            "MISSION_CLEAR_ALL": self._mission_clear,
            "TIMESYNC": self._timesync,
        }
        self._commands: dict[int, Callable[[Peer, list[float]], int]] = {
            m.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            m.MAV_CMD_NAV_TAKEOFF: self._take_off,
            m.MAV_CMD_NAV_LAND: lambda _peer, _p: self._switch(Mode.LAND),
            m.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _peer, _p: self._switch(Mode.RTL),
            m.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            m.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            m.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            m.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: lambda peer, _p: self._report(peer, "AUTOPILOT_VERSION"),
        }

    def heed(self, peer: Any, message: Any) -> None:
        """Process one message and answer it; unknown messages are ignored."""
        handler = self._messages.get(message.get_type())
        if handler is not None:
            handler(peer, message)

    def _heartbeat(self, _peer: Peer, message: Any) -> None:
        if message.get_srcSystem() == self._vehicle.parameters["SYSID_MYGCS"]:
            self._modes.note_ground_station()

    # Commands

    def _command_long(self, peer: Peer, message: Any) -> None:
        self._run(peer, message, [getattr(message, f"param{i}") for i in range(1, 8)])

    def _command_int(self, peer: Peer, message: Any) -> None:
        m = self._m
        if message.command == m.MAV_CMD_DO_REPOSITION:
            self._acknowledge(peer, message, self._reposition(message))
            return
        self._run(
            peer, message, [getattr(message, f"param{i}") for i in range(1, 5)] + [message.x, message.y, message.z]
        )

    def _run(self, peer: Peer, message: Any, parameters: list[float]) -> None:
        handler = self._commands.get(message.command)
        result = self._m.MAV_RESULT_UNSUPPORTED if handler is None else handler(peer, parameters)
        self._acknowledge(peer, message, result)

    def _acknowledge(self, peer: Peer, message: Any, result: int, command: int | None = None) -> None:
        peer.mav.command_ack_send(
            message.command if command is None else command,
            result,
            0,
            0,
            message.get_srcSystem(),
            message.get_srcComponent(),
        )

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

    def _take_off(self, _peer: Peer, p: list[float]) -> int:
        return self._done(self._modes.take_off(p[6]))

    def _switch(self, mode: float) -> int:
        return self._done(self._modes.set_mode(_whole(mode)))

    def _do_set_mode(self, _peer: Peer, p: list[float]) -> int:
        if not _whole(p[0]) & self._m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return int(self._m.MAV_RESULT_DENIED)
        return self._switch(p[1])

    def _set_mode(self, peer: Peer, message: Any) -> None:
        custom = message.base_mode & self._m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        result = self._switch(message.custom_mode) if custom else int(self._m.MAV_RESULT_DENIED)
        self._acknowledge(peer, message, result, self._m.MAVLINK_MSG_ID_SET_MODE)

    def _reposition(self, message: Any) -> int:
        """DO_REPOSITION: fly to a position; switch to GUIDED if the first bit of the options is set."""
        m, vehicle = self._m, self._vehicle
        if message.frame not in GLOBAL_FRAMES:
            return int(m.MAV_RESULT_DENIED)
        if self._modes.mode != Mode.GUIDED and not _whole(message.param2) & 1:
            return int(m.MAV_RESULT_DENIED)
        position = np.array([message.x / 1e7, message.y / 1e7, message.z])
        setpoint = Setpoint(message.frame, _POSITION_ONLY, position, np.zeros(3), 0.0, 0.0)
        target = decode(setpoint, vehicle.state(), self._modes.home, vehicle.time)
        if isinstance(target, str):
            return self._done(target)
        if isinstance(target, PositionTarget) and math.isfinite(message.param4):
            heading = TargetHeading(compass_to_world(math.radians(message.param4)))
            target = PositionTarget(target.position, target.velocity, heading, target.time)
        self._modes.set_mode(Mode.GUIDED)
        self._modes.aim(target)
        return int(m.MAV_RESULT_ACCEPTED)

    # Setpoints

    def _local_target(self, _peer: Peer, t: Any) -> None:
        position = np.array([t.x, t.y, t.z], dtype=np.float64)
        self._aim(t, LOCAL_FRAMES, position)

    def _global_target(self, _peer: Peer, t: Any) -> None:
        self._aim(t, GLOBAL_FRAMES, np.array([t.lat_int / 1e7, t.lon_int / 1e7, t.alt]))

    def _aim(self, t: Any, frames: tuple[int, ...], position: Any) -> None:
        """Follow a setpoint in GUIDED; an unsupported one stops the vehicle."""
        if self._modes.mode != Mode.GUIDED:
            return
        velocity = np.array([t.vx, t.vy, t.vz], dtype=np.float64)
        setpoint = Setpoint(t.coordinate_frame, t.type_mask, position, velocity, t.yaw, t.yaw_rate)
        vehicle, target = self._vehicle, None
        if t.coordinate_frame in frames:
            target = decode(setpoint, vehicle.state(), self._modes.home, vehicle.time)
        if target is not None and not isinstance(target, str):
            self._modes.aim(target)
            return
        self._modes.stop()
        if vehicle.time - self._refusal_sent >= 1.0:  # setpoints may arrive at 50 Hz; limit the messages
            self._refusal_sent = vehicle.time
            vehicle.say(Severity.WARNING, f"Target refused: {target or f'frame {t.coordinate_frame} is unknown'}")

    # Parameters

    def _list_parameters(self, peer: Peer, _message: Any) -> None:
        peer.parameters.clear()
        peer.parameters.extend(self._vehicle.parameters)

    def _read_parameter(self, peer: Peer, message: Any) -> None:
        table = self._vehicle.parameters
        name = table.name(message.param_index) if message.param_index >= 0 else message.param_id
        if name in table:
            self._vehicle.send_parameter(peer, str(name))

    def _set_parameter(self, peer: Peer, message: Any) -> None:
        """Change a parameter; the answer is the current value, whether or not the change was accepted."""
        table = self._vehicle.parameters
        if message.param_id not in table:
            return
        refusal = table.set(message.param_id, float(message.param_value))
        if refusal:
            self._vehicle.say(Severity.WARNING, refusal)
        self._vehicle.send_parameter(peer, message.param_id)

    # Streams

    def _rate(self, peer: Peer, name: str, rate: float) -> None:
        peer.rates[name] = min(rate, MAX_RATE_HZ)
        peer.due[name] = self._vehicle.time

    def _set_interval(self, peer: Peer, p: list[float]) -> int:
        m, name = self._m, self._ids.get(_whole(p[0]))
        if name is None or not math.isfinite(p[1]):
            return int(m.MAV_RESULT_DENIED)
        interval = p[1]  # us; -1 stops, 0 is the default rate
        self._rate(peer, name, 0.0 if interval < 0 else REPORTS[name][1] if interval == 0 else 1e6 / interval)
        return int(m.MAV_RESULT_ACCEPTED)

    def _get_interval(self, peer: Peer, p: list[float]) -> int:
        identity = _whole(p[0])
        name = self._ids.get(identity)
        if name is None:
            return int(self._m.MAV_RESULT_DENIED)
        rate = peer.rates[name]
        peer.mav.message_interval_send(identity, round(1e6 / rate) if rate > 0 else -1)
        return int(self._m.MAV_RESULT_ACCEPTED)

    def _request_message(self, peer: Peer, p: list[float]) -> int:
        name = self._ids.get(_whole(p[0]))
        return int(self._m.MAV_RESULT_DENIED) if name is None else self._report(peer, name)

    def _report(self, peer: Peer, name: str) -> int:
        peer.mav.send(REPORTS[name][0](self._m, self._vehicle.snapshot()))
        return int(self._m.MAV_RESULT_ACCEPTED)

    def _data_stream(self, peer: Peer, message: Any) -> None:
        """The older request: sets all streams at once, whichever group is named."""
        rate = float(message.req_message_rate) if message.start_stop else 0.0
        for name, (_, usual) in REPORTS.items():
            if usual > 0 and name != "HEARTBEAT":
                self._rate(peer, name, rate)

    # Missions: none are stored

    def _mission_list(self, peer: Peer, message: Any) -> None:
        peer.mav.mission_count_send(message.get_srcSystem(), message.get_srcComponent(), 0, message.mission_type)

    def _mission_upload(self, peer: Peer, message: Any) -> None:
        m = self._m
        result = m.MAV_MISSION_UNSUPPORTED if message.count else m.MAV_MISSION_ACCEPTED
        peer.mav.mission_ack_send(message.get_srcSystem(), message.get_srcComponent(), result, message.mission_type)

    def _mission_clear(self, peer: Peer, message: Any) -> None:
        peer.mav.mission_ack_send(
            message.get_srcSystem(), message.get_srcComponent(), self._m.MAV_MISSION_ACCEPTED, message.mission_type
        )

    def _timesync(self, peer: Peer, message: Any) -> None:
        if message.tc1 == 0:
            peer.mav.timesync_send(round(self._vehicle.time * 1e9), message.ts1)


def _whole(value: float) -> int:
    """An integer from a float parameter; -1 if it is not an integer."""
    return int(value) if math.isfinite(value) and value == int(value) else -1
