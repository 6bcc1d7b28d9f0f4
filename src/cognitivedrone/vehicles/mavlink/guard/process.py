"""What the guard process does: it listens to the vehicle and to the pilot process, and lets no trouble end the flight.

One loop, some fifty times a second, in the main thread. A second thread exists only while something that waits for the
vehicle is under way: the handshake, and the take-off with its checklist. Whatever goes wrong here or around it ends in
`FlightCore.land`; nothing but the drone on the ground, or in its pilot's hands, ends the process.
"""

from __future__ import annotations

import gc
import os
import select
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from cognitivedrone.control.safety import Guard, SafetyConfig
from cognitivedrone.errors import CognitiveDroneError, LinkError
from cognitivedrone.system import HANG_UP, come_first, end_of, steady_s
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.vehicles.checklist import Checklist
from cognitivedrone.vehicles.mavlink.client.connection import WATCH_S
from cognitivedrone.vehicles.mavlink.client.core import FlightCore
from cognitivedrone.vehicles.mavlink.client.handshake import RESTORE_S, MavlinkConfig
from cognitivedrone.vehicles.mavlink.client.transport import PacketLog, open_transport
from cognitivedrone.vehicles.mavlink.guard.messages import (
    MESSAGE_BYTES,
    Fault,
    Inbox,
    Kind,
    Message,
    MessageSocket,
    Reply,
    Snapshot,
    from_json,
    to_json,
)
from cognitivedrone.vehicles.mavlink.telemetry import Telemetry, Text

LOST_S = 0.5
"""A loop that was stopped for longer than this, by a signal, by swapping or by a sleep of the machine, lands."""
MOST_FAULTS, FAULTS_S = 10, 1.0
"""So many messages that cannot be flown by, in so long, and it lands; each one alone stops the drone."""
AT_ONCE = 64
"""Messages of the pilot that are read before the link is listened to again."""
REOPEN_S, GIVE_UP_S = 0.5, 60.0
"""A link that was cut is opened again that often, for so long."""
GONE_S = 300.0
"""A vehicle without a heartbeat for so long is not waited for any more, once the pilot process is done."""
LANDED, FAILED, LOST, LEFT = 0, 2, 3, 4
"""Exit codes: on the ground; could not begin; vehicle lost; dismissed while the vehicle was armed and not ours."""
NAMES = {HANG_UP: "the terminal has gone (SIGHUP)", signal.SIGTERM: "SIGTERM", signal.SIGINT: "SIGINT"}


class GuardProcess:
    """Raises `LinkError` where the link cannot be opened; `run` returns the exit code."""

    def __init__(
        self, pilot: MessageSocket, url: str, safety: SafetyConfig, config: MavlinkConfig, log: PacketLog, watched: int
    ) -> None:
        self._pilot: MessageSocket | None = pilot
        self._url = url
        self._hold_s = safety.policy.hold_s
        self._config = config
        self._watched = watched
        """A file that becomes readable when the pilot process ends; -1 is none."""
        self._core = FlightCore(url, Guard(safety), config, log=log.put, threaded=False)
        self._log = log
        self._inbox = Inbox()
        self._faults: deque[float] = deque()
        self._replies: deque[bytes] = deque(maxlen=1000)
        self._signals: deque[int] = deque()
        self._worker: threading.Thread | None = None
        self._answer: bool | None = None
        self._frame_at = -np.inf
        self._texts: tuple[Text, ...] = ()
        self._sent_at = self._last_received = -np.inf
        self._sent_sequence = 0
        self._sent = np.zeros(4, dtype=np.float32)
        self._stopped = False
        """By a message that could not be flown by, since the last one that could."""
        self._ignore_until = -np.inf
        self._ran_at = steady_s()
        self._cut_at: float | None = None
        self._opened_at = -np.inf
        self._leaving = self._dismissed = False
        self._landed_at: float | None = None
        self._wake, self._woken = socket.socketpair()

    def run(self) -> int:
        """Guard until nothing is left to guard; returns the exit code."""
        self._wake.setblocking(False)
        self._woken.setblocking(False)
        signal.set_wakeup_fd(self._woken.fileno(), warn_on_full_buffer=False)
        for number in NAMES:
            signal.signal(number, lambda number, _: self._signals.append(number))
        self._begin(self._accept)
        while (code := self._code()) is None:
            self._go_on()
        self._say(Reply("log", self._log.close()))
        self._say(Reply("words", _FINAL_MESSAGES[code]))
        self._send()
        return code

    def _go_on(self) -> None:
        """One round of the loop, whatever goes wrong in it."""
        try:
            self._step()
        except LinkError as error:
            self._cut(error)
        except Exception as error:  # a fault of the guard's own must not leave a drone in the air alone
            self._land(f"the guard failed: {error!r}")
            time.sleep(WATCH_S / 4)  # what fails again and again must not take the machine

    def _step(self) -> None:
        self._look_at_the_time()
        files = [file for file in (self._wake.fileno(), self._watched) if file >= 0]
        if self._pilot is not None and time.monotonic() >= self._ignore_until:
            files.append(self._pilot.fileno())
        if self._cut_at is None:
            self._core.link.step(WATCH_S, *files)
        else:
            select.select(files, [], [], WATCH_S)
            self._reopen()
        self._look_at_the_time()
        self._take_signals()
        if self._watched >= 0 and select.select([self._watched], [], [], 0)[0]:
            self._lose_pilot("the pilot process ended")
        self._read_pilot()
        self._send()

    # What ends a flight.

    def _land(self, reason: str) -> None:
        """Land what is ours, now; on the ground, end what was begun."""
        self._core.land(reason)
        with suppress(LinkError):
            self._core.watch()

    def _look_at_the_time(self) -> None:
        """Notice that this process stood still: its state is old, and so is the last setpoint."""
        now = steady_s()
        lost, self._ran_at = now - self._ran_at, now
        if lost > LOST_S and self._core.phase in ("climbing", "flying"):
            self._land(f"the guard stood still for {lost:.1f} s")

    def _take_signals(self) -> None:
        with suppress(BlockingIOError):
            self._wake.recv(4096)
        while self._signals:
            number = self._signals.popleft()
            if self._core.phase == "released" and number != HANG_UP:
                self._dismissed = True
            elif self._core.phase == "ground":
                self._leaving = True
            self._land(NAMES[number])

    def _lose_pilot(self, reason: str) -> None:
        ours, self._leaving, self._watched = self._core.phase in ("climbing", "flying"), True, -1
        if self._pilot is not None:
            self._pilot.close()
            self._pilot = None
        self._land(reason)
        if ours:
            with suppress(OSError, ValueError):  # standard error may take nothing at once, or be closed
                if select.select([], [2], [], 0)[1]:
                    os.write(2, f"cognitivedrone guard: {reason}; landing\n".encode())

    def _cut(self, error: LinkError) -> None:
        """The link was cut: try to open it again, to land."""
        self._cut_at = self._cut_at or time.monotonic()
        self._core.land(str(error))
        self._core.link.fail(error)
        self._say(Reply("cut", str(error)))

    def _reopen(self) -> None:
        if time.monotonic() - self._opened_at < REOPEN_S or self._core.phase == "ground":
            return
        self._opened_at = time.monotonic()
        with suppress(CognitiveDroneError):
            self._core.link.go_on_with(open_transport(self._url, timeout_s=WATCH_S))
            self._cut_at = None

    def _code(self) -> int | None:
        """With which code to leave; none while there is something to guard."""
        core, now = self._core, time.monotonic()
        if self._dismissed and core.phase in ("ground", "released"):
            return LEFT if core.telemetry.armed and core.phase == "released" else LANDED
        if not self._leaving:
            return None
        if core.phase == "ground":
            return None if self._worker is not None else LANDED
        if self._cut_at is not None and now - self._cut_at > GIVE_UP_S:
            return LOST
        if core.phase == "released" and not core.telemetry.armed:
            self._landed_at = self._landed_at or now
            return None if core.restoring and now - self._landed_at < RESTORE_S else LANDED
        return LOST if now - core.telemetry.heartbeat_at > GONE_S else None

    # The pilot process.

    def _read_pilot(self) -> None:
        for _ in range(AT_ONCE):
            if self._pilot is None or time.monotonic() < self._ignore_until:
                return
            try:
                data = self._pilot.recv(MESSAGE_BYTES + 1)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:  # the other end is closed
                self._lose_pilot("the pilot process closed its end")
                return
            found = self._inbox.read(data, time.monotonic_ns())
            if isinstance(found, Message):
                self._do(found)
            elif found.kind != "late":  # a late setpoint is none: how old the last good one is counts
                self._refuse(found)

    def _do(self, message: Message) -> None:
        now = time.monotonic()
        self._frame_at = message.sent_s - message.frame_age_s
        match message.kind:
            case Kind.SETPOINT if self._core.phase in ("flying", "released"):
                self._stopped = False
                self._core.seen(now - self._frame_at)
                # From a deadline that is earlier than the rules' own, the drone is held.
                age = max(now - message.sent_s, self._hold_s - (message.deadline_s - now))
                self._sent = self._core.command(message.command, age if self._config.clock == "wall" else 0.0)
            case Kind.FRAME if self._core.phase == "flying":
                self._core.seen(now - self._frame_at)
            case Kind.TAKE_OFF if self._worker is None and self._core.phase == "ground":
                self._answer = None
                self._begin(self._take_off)
            case Kind.CONFIRM | Kind.REFUSE:
                self._answer = message.kind == Kind.CONFIRM
            case Kind.LAND | Kind.RETURN:
                self._core.land("the flight is over", "LAND" if message.kind == Kind.LAND else "RTL")
            case Kind.HANG_UP:
                self._leaving = True
                self._land("the pilot process hung up")

    def _refuse(self, fault: Fault) -> None:
        """Stop the drone; land it where that happens again and again."""
        now = time.monotonic()
        self._faults.append(now)
        while self._faults[0] < now - FAULTS_S:
            self._faults.popleft()
        if not self._stopped and self._core.phase == "flying":
            self._stopped, self._sent = True, self._core.command(np.full(4, np.nan))
        if fault.kind == "flood":
            self._ignore_until = now + WATCH_S
        if fault.kind == "flood" or len(self._faults) > MOST_FAULTS:
            self._faults.clear()
            self._land(f"the pilot process sends what cannot be flown by: {fault.reason}")

    def _say(self, reply: Reply) -> None:
        self._replies.append(reply.pack())

    def _send(self) -> None:
        """Send the pilot process what is new, without ever waiting for it."""
        core, now = self._core, time.monotonic()
        telemetry = core.telemetry
        for text in telemetry.texts:
            if not any(text is known for known in self._texts):
                self._say(Reply("text", to_json(text)))
        self._texts = telemetry.texts
        try:
            while self._replies and self._pilot is not None:
                self._pilot.send(self._replies[0])
                self._replies.popleft()
            fresh = self._inbox.sequence > self._sent_sequence or telemetry.received_at > self._last_received
            if self._pilot is not None and (fresh or now - self._sent_at >= WATCH_S):
                self._sent_at, self._sent_sequence = now, self._inbox.sequence
                self._last_received = telemetry.received_at
                self._pilot.send(self._snapshot(telemetry).pack())
        except BlockingIOError:
            pass  # it does not read: there will be a newer one
        except OSError:
            self._lose_pilot("the pilot process closed its end")

    def _snapshot(self, telemetry: Telemetry) -> Snapshot:
        core, decision = self._core, self._core.decision
        return Snapshot(
            sequence=self._inbox.sequence,
            phase=core.phase,
            decision="" if decision is None else decision.kind,
            reason=core.over or ("" if decision is None else decision.reason),
            sent=self._sent,
            start=core.start,
            home=core.home,
            telemetry=telemetry,
        )

    # What waits for the vehicle.

    def _begin(self, job: Callable[[], Reply]) -> None:
        def work() -> None:
            try:
                self._say(job())
            except Exception as error:
                if self._core.phase != "ground":
                    self._core.land(f"the take-off failed: {error}")
                self._say(Reply("failed", str(error) if isinstance(error, CognitiveDroneError) else repr(error)))
            finally:
                self._worker = None

        self._worker = threading.Thread(target=work, name="take-off", daemon=True)
        self._worker.start()

    def _accept(self) -> Reply:
        self._core.meet()
        return Reply("met", to_json(self._core.met))

    def _take_off(self) -> Reply:
        self._core.take_off(self._confirm, lambda: time.monotonic() - self._frame_at)
        return Reply("flying")

    def _confirm(self, checklist: Checklist) -> bool:
        self._say(Reply("checklist", to_json(checklist)))

        def answered() -> bool | None:
            self._core.check_wanted()
            return None if self._answer is None else True

        while not self._core.link.wait(answered, 1.0):
            pass
        return bool(self._answer)


_FINAL_MESSAGES: dict[int, str] = {
    LANDED: "the drone is on the ground",
    LOST: "the vehicle was lost",
    LEFT: "dismissed; the vehicle was not ours any more, and armed",
}


def main() -> int:
    """Guard by the JSON of the command line: the link's URL, the rules, how the vehicle is talked to, inherited files.

    Returns the exit code.
    """
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
            pilot.send(Reply("failed", str(error)).pack())
        return FAILED
    gc.freeze()
    return guard.run()


if __name__ == "__main__":
    sys.exit(main())
