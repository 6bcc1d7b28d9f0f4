"""A MAVLink connection to one vehicle: a loop that receives and heartbeats, and requests that wait for replies."""

from __future__ import annotations

import contextlib
import math
import secrets
import select
import threading
import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, TypeVar

from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, AUTOPILOTS, REAL32, AutopilotKind
from cognitivedrone.vehicles.mavlink.client.heartbeats import Chain, Flown, Heartbeats, Shown, heard
from cognitivedrone.vehicles.mavlink.client.traffic import (
    OUR_COMPONENT,
    OUR_SYSTEM,
    MessageDecoder,
    Traffic,
    answered,
    noticed,
    request_time,
)
from cognitivedrone.vehicles.mavlink.client.transport import Transport
from cognitivedrone.vehicles.mavlink.telemetry import (
    ARMED_FLAG,
    GROUND_STATION,
    Telemetry,
    dialect,
    is_vehicle,
    last_words,
    updated,
)

T = TypeVar("T")

HEARTBEAT_S, WATCH_S, PING_S = 1.0, 0.02, 0.2
"""Periods of our heartbeat, of the watch, and of a request that the vehicle answers at once (TIMESYNC)."""
MOVED_S, ALONE_S = 0.5, 0.2
"""A vehicle that was silent for so long may go on from another address; before, who sends as it there is another. So
long must that address be the only one: after a stop of our own, the queued packets show which side was silent."""
READ_AT_ONCE = 64
"""Reads or datagrams that are processed before the next call of `watch`."""
ACK_S, TRIES = 1.0, 3
RESULTS = {1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 6: "cancelled"}
"""MAV_RESULT; 0 is accepted and 5 in progress."""
IN_PROGRESS = 5
REQUEST_MESSAGE = 512
"""MAV_CMD_REQUEST_MESSAGE."""
SIGNED = 1
"""Bit of a packet's incompatibility flags: https://mavlink.io/en/guide/message_signing.html."""
SIGNS = (
    "it signs its packets, and may ignore ours, which are not signed: switch signing off on this link, or put a router"
    " between that signs"
)
MODE_S = 0.1
"""How often a vehicle that heartbeats too seldom by itself is asked for a heartbeat."""


@dataclass(frozen=True, slots=True)
class VehicleId:
    """The vehicle at the other end, as its heartbeat identifies it."""

    system: int
    component: int
    kind: int
    """MAV_TYPE."""
    autopilot: int
    """MAV_AUTOPILOT."""


class MavlinkConnection:
    """Connects to the first vehicle whose heartbeat arrives, or to the one with system id `system`.

    A thread receives and sends heartbeats; without `threaded`, the caller does so by calling `step` repeatedly. `watch`
    is called from there about fifty times a second, `log` for every packet received and sent, and `flown`, which says
    how the vehicle must show itself, for every heartbeat; none may block.
    Once the link is cut, every method raises `LinkError`.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        system: int | None = None,
        log: Callable[[bytes], None] = lambda _: None,
        watch: Callable[[], None] = lambda: None,
        flown: Callable[[float], Flown] = lambda _: Flown(),
        threaded: bool = True,
    ) -> None:
        self._transport = transport
        self._system = system
        self._log = log
        self._watch = watch
        self._flown = flown
        self._beat = self._vehicle_beat = self._watched = self._pinged = self._asked = -math.inf
        self._encoder = dialect().MAVLink(SimpleNamespace(write=self._put), OUR_SYSTEM, OUR_COMPONENT)
        self._decoder = MessageDecoder(datagrams=transport.datagrams)
        self._sending = threading.Lock()
        self._asking = threading.RLock()
        self._news = threading.Condition()
        self._stopping = threading.Event()
        self._failure: LinkError | None = None
        self._replies: dict[Hashable, Any] = {}
        self._asked_for: set[Hashable] = set()
        """Parameters and commands whose answers are kept: a flood of others must not fill the memory."""
        self._kinds: dict[str, int] = {}
        """MAV_PARAM_TYPE of the parameters received."""
        self.vehicle: VehicleId | None = None
        self.signs = False
        """Whether the vehicle signs its packets: then it may ignore ours."""
        self.telemetry = Telemetry()
        """What the vehicle reports; its mode, and whether it is armed, only as its heartbeats are believed."""
        self.heartbeats = Heartbeats()
        self._chain = Chain()
        self.beating = True
        """Whether we heartbeat: as long as the vehicle is to notice our silence."""
        self.traffic = Traffic(nonce=secrets.randbelow(1000))
        """Other senders on the link, and whether our packets reach the vehicle."""
        self._peer: tuple[Hashable, float] = (None, -math.inf)
        """Where the vehicle last sent from, and when."""
        self._mover: tuple[Hashable, float] = (None, -math.inf)
        """Where it may have moved to, and since when."""
        self._thread = threading.Thread(target=self._run, name="mavlink", daemon=True) if threaded else None
        if self._thread is not None:
            self._thread.start()

    @property
    def autopilot(self) -> AutopilotKind:
        """What the vehicle runs; ArduPilot until its heartbeat arrives, and for what is not flown."""
        return AUTOPILOTS.get(self.vehicle.autopilot, ARDUPILOT) if self.vehicle is not None else ARDUPILOT

    def check(self) -> None:
        """Raise what cut the link, if it is cut."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Stop receiving and sending heartbeats."""
        self._stopping.set()
        if self._thread is not None and threading.current_thread() is not self._thread:
            self._thread.join()
        self._transport.close()

    def send(self, message: str, *fields: Any) -> None:
        """Encode and send a message by its name in lower case and its fields in the order of the definition."""
        packet = getattr(self._encoder, f"{message}_encode")(*fields)
        with self._sending:
            self._encoder.send(packet)

    def wait(self, found: Callable[[], T | None], timeout_s: float) -> T | None:
        """What `found` gives, asked again at every message, or none after `timeout_s`."""
        deadline = time.monotonic() + timeout_s
        with self._news:
            while True:
                self.check()
                if (result := found()) is not None:
                    return result
                if (left := deadline - time.monotonic()) <= 0:
                    return None
                self._news.wait(min(left, 0.1))

    def until(self, holds: Callable[[], bool], timeout_s: float) -> bool:
        """Whether it came to hold within `timeout_s`."""
        return self.wait(lambda: holds() or None, timeout_s) is not None

    def command(self, number: int, *parameters: float, what: str) -> None:
        """Send a COMMAND_LONG and wait until it is accepted, three times if need be.

        Raises `LinkError` where it is not: with the vehicle's status text, and `what` names the command.
        """
        began = time.monotonic()
        with self._asking:
            for attempt in range(TRIES):
                self._replies.pop(("ack", number), None)
                self.order(number, *parameters, attempt=attempt)
                result = self._result(number, ACK_S)
                while result == IN_PROGRESS:
                    self._replies.pop(("ack", number), None)
                    result = self._result(number, 10.0)
                if result == 0:
                    return
                if result is not None:
                    # The reason comes as a text, sometimes just after the refusal.
                    self.until(lambda: bool(last_words(self.telemetry, began)), 0.3)
                    words = last_words(self.telemetry, began - 3.0)
                    raise LinkError(f"the vehicle refused {what}: {RESULTS.get(result, f'result {result}')}{words}")
        cause = SIGNS if self.signs else "is another program using this link, or is it one-way?"
        raise LinkError(f"the vehicle did not answer to {what}, asked {TRIES} times; {cause}")

    def order(self, number: int, *parameters: float, attempt: int = 0) -> None:
        """Send a COMMAND_LONG without waiting for an answer."""
        vehicle = self._target()
        self._asked_for.add(("ack", number))
        seven = (*parameters, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)[:7]
        self.send("command_long", vehicle.system, vehicle.component, number, attempt, *seven)

    def message(self, name: str, number: int, timeout_s: float = 2.0) -> Any | None:
        """Ask for one message and wait for it; none where it is refused or does not come."""

        def answered() -> tuple[Any | None] | None:
            refused = self._replies.get(("ack", REQUEST_MESSAGE), 0) != 0
            return (self._replies.get(name),) if refused or name in self._replies else None

        with self._asking:
            self._replies.pop(name, None)
            self._replies.pop(("ack", REQUEST_MESSAGE), None)
            self.order(REQUEST_MESSAGE, number)
            answer = self.wait(answered, timeout_s)
            return answer[0] if answer is not None else None

    def parameters(self, names: Sequence[str]) -> dict[str, float | None]:
        """The values of parameters; none for those that the vehicle does not know: it does not answer for them."""
        vehicle = self._target()
        with self._asking:
            for name in names:
                self._forget_parameter(name)
            for _ in range(TRIES):
                missing = [name for name in names if ("parameter", name) not in self._replies]
                for name in missing:
                    self.send("param_request_read", vehicle.system, vehicle.component, name.encode(), -1)
                if self.until(lambda: all(("parameter", name) in self._replies for name in names), ACK_S / 2):
                    break
            return {name: self._replies.get(("parameter", name)) for name in names}

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter and see that it took; raises `LinkError` where it did not."""
        with self._asking:
            for _ in range(TRIES):
                self.send_parameter(name, value)
                echo = self.wait(lambda: self._replies.get(("parameter", name)), ACK_S)
                if echo is not None and math.isclose(echo, value, rel_tol=1e-5):
                    return
        raise LinkError(f"the vehicle did not take {name} = {value:g}; set it with a ground station")

    def send_parameter(self, name: str, value: float) -> None:
        """Set a parameter without waiting; `reported_parameter` gives the vehicle's answer."""
        vehicle = self._target()
        self._forget_parameter(name)
        # ArduPilot takes every parameter as a float.
        kind = self._kinds.get(name, REAL32) if self.autopilot.exact_integers else REAL32
        field = self.autopilot.parameter_field(value, kind)
        self.send("param_set", vehicle.system, vehicle.component, name.encode(), field, kind)

    def reported_parameter(self, name: str) -> float | None:
        """The value that the vehicle last reported since the parameter was requested or set."""
        value: float | None = self._replies.get(("parameter", name))
        return value

    def _forget_parameter(self, name: str) -> None:
        """What was reported of it, because it is asked for again."""
        self._asked_for.add(("parameter", name))
        self._replies.pop(("parameter", name), None)

    def _target(self) -> VehicleId:
        if self.vehicle is None:
            raise LinkError("no vehicle has sent a heartbeat on this link yet")
        return self.vehicle

    def _result(self, number: int, timeout_s: float) -> int | None:
        return self.wait(lambda: self._replies.get(("ack", number)), timeout_s)

    # Listening.

    def step(self, wait_s: float = WATCH_S, *others: int) -> None:
        """Heartbeat and watch where that is due; then take what comes.

        Waits at most so long for it, or for one of the `others` (files) to become readable. Raises `LinkError` where
        the link is cut.
        """
        now = time.monotonic()
        # Once a second of the vehicle's time as well: a simulator that runs fast would think us gone.
        vehicle_time = self.telemetry.vehicle_time
        if self.beating and (now - self._beat >= HEARTBEAT_S or vehicle_time - self._vehicle_beat >= HEARTBEAT_S):
            self._beat, self._vehicle_beat = now, vehicle_time
            self.send("heartbeat", GROUND_STATION, 8, 0, 0, 4)  # no autopilot, active
        if self.vehicle is not None and now - self._pinged >= PING_S:
            self._pinged = now
            self.send("timesync", 0, request_time(self.traffic, now))
        if self.autopilot.asked_for_mode and now - self._asked >= MODE_S:
            self._asked = now
            self.order(REQUEST_MESSAGE, 0)
        if now - self._watched >= WATCH_S:
            self._watched = now
            self._watch()
        # Last: what cannot be taken must not keep the heartbeat back.
        link = self._transport.fileno()
        if link in select.select([link, *others], [], [], wait_s)[0]:
            # All of it, since what waits has grown old where this process stood still; but not for ever.
            for _ in range(READ_AT_ONCE):
                data, peer = self._transport.read(0.0)
                if not data:
                    break
                self._take(data, peer)

    def go_on_with(self, transport: Transport) -> None:
        """Talk over another transport from now on, after the last one was cut."""
        with self._sending:
            self._transport.close()
            self._transport, self._failure = transport, None
            self._decoder = MessageDecoder(datagrams=transport.datagrams)
            self._peer = None, -math.inf

    def fail(self, error: LinkError) -> None:
        """Have every method raise this."""
        with self._news:
            self._failure = error
            self._news.notify_all()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self.step()
        except LinkError as error:
            self.fail(error)
        except Exception as error:
            # A thread that ends unnoticed would leave a drone in the air unsupervised: the caller gets the error.
            self.fail(LinkError(f"listening to the vehicle failed: {error!r}"))

    def _take(self, data: bytes, peer: Hashable) -> None:
        now = time.monotonic()
        with self._news:
            for message in self._decoder.messages(data, now):
                self._log(bytes(message.get_msgbuf()))
                # A message with an impossible value must not end the loop; the values it should have set grow old.
                with contextlib.suppress(ValueError, OverflowError):
                    self._receive(message, peer, now)
            self.traffic = replace(self.traffic, broken=self._decoder.broken)
            self._news.notify_all()

    def _receive(self, message: Any, peer: Hashable, now: float) -> None:
        kind, sender = message.get_type(), (message.get_srcSystem(), message.get_srcComponent())
        wanted = self.vehicle is None and self._system in (None, sender[0])
        if kind == "HEARTBEAT" and wanted and is_vehicle(message):
            self.vehicle = VehicleId(*sender, message.type, message.autopilot)
        known = (self.vehicle.system, self.vehicle.component) if self.vehicle is not None else None
        if sender != known:
            self.traffic = noticed(self.traffic, message, known, now)
            return
        where, last = self._peer
        if where is not None and peer != where:
            if now - last < MOVED_S:
                self._doubt("", now)
                return
            if self._mover[0] != peer:
                self._mover = peer, now
            if now - self._mover[1] < ALONE_S:
                return
        self._peer, self._mover = (peer, now), (None, -math.inf)
        self.signs = bool(message.get_header().incompat_flags & SIGNED)
        if kind == "HEARTBEAT":
            self._transport.answer_to(peer)  # wherever the vehicle has moved to
            if not self._believed(message, now):
                self.telemetry = replace(self.telemetry, received_at=now)
                return
        else:
            self._chain.note(message.get_seq(), now)
        self.telemetry = updated(self.telemetry, message, now, self.autopilot)
        if kind == "COMMAND_ACK":
            if message.target_system in (0, OUR_SYSTEM) and ("ack", message.command) in self._asked_for:
                self._replies["ack", message.command] = message.result
        elif kind == "TIMESYNC":
            self.traffic = answered(self.traffic, message, now)
        elif kind == "PARAM_VALUE":
            if ("parameter", message.param_id) in self._asked_for:
                value = self.autopilot.parameter(message)
                if math.isfinite(value):  # no vehicle has another; it counts as no answer
                    self._kinds[message.param_id] = message.param_type
                    self._replies["parameter", message.param_id] = value
        else:
            self._replies[kind] = message

    def _believed(self, message: Any, now: float) -> bool:
        """Whether the vehicle is as this heartbeat shows it."""
        vehicle = self._target()
        if (message.type, message.autopilot) != (vehicle.kind, vehicle.autopilot):
            self._doubt(f"a heartbeat of MAV_TYPE {message.type} and MAV_AUTOPILOT {message.autopilot}", now)
            return False
        mode, armed = self.autopilot.mode(message.custom_mode), bool(message.base_mode & ARMED_FLAG)
        shown = Shown(mode, armed, message.get_seq(), self._chain.follows(message.get_seq(), now))
        self.heartbeats = heard(self.heartbeats, shown, self._flown(now), now)
        if self.heartbeats.contradicted_at == now:
            self._doubt(self.heartbeats.contradiction, now)
        return self.heartbeats.accepts(shown)

    def _doubt(self, reason: str, now: float) -> None:
        """Note that somebody else sends as the vehicle."""
        self.traffic = replace(self.traffic, impostor_at=now, impostor=reason)

    def _put(self, data: bytes) -> None:
        self._log(data)
        self._transport.write(data)
