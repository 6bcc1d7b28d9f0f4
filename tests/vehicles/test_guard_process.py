"""The guard as a process of its own: against a vehicle that plays a part, over real sockets and with real signals."""

from __future__ import annotations

import fcntl
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from peer import FLOWN, FORWARD, MODES, SURE, Peer, StillCamera, kinds_logged, playing
from waiting import soon

from cognitivedrone.control.safety import SafetyConfig, Timeouts
from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.client import transport
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.client.preflight import FRESH_S
from cognitivedrone.vehicles.mavlink.client.transport import LARGEST_BACKLOG, PacketLog, open_transport
from cognitivedrone.vehicles.mavlink.guard import messages, process
from cognitivedrone.vehicles.mavlink.guard.drone import SupervisedDrone
from cognitivedrone.vehicles.mavlink.guard.messages import (
    LARGEST_RATE,
    MESSAGE_BYTES,
    Fault,
    Inbox,
    Kind,
    Message,
    MessageSocket,
    pack,
)

CALM = SafetyConfig(link=Timeouts(2, 4), state=Timeouts(2, 4), policy=Timeouts(2, 4), camera=Timeouts(2, 4))
"""For tests of something else, on machines that are busy."""
STOP = (0.0, 0.0, 0.0, 0.0)


@contextmanager
def connected(peer: Peer, safety: SafetyConfig = CALM, config: MavlinkConfig = SURE) -> Iterator[SupervisedDrone]:
    """A drone on the ground, and no guard that outlives the test."""
    drone = SupervisedDrone(f"udpout:127.0.0.1:{peer.port}", StillCamera(), safety, config)
    try:
        yield drone
        drone.close()
    finally:
        with suppress(LinkError):
            drone.close()
        end(drone)


@contextmanager
def flying(peer: Peer, safety: SafetyConfig = CALM, config: MavlinkConfig = SURE) -> Iterator[SupervisedDrone]:
    with connected(peer, safety, config) as drone:
        drone.take_off(lambda _: True)
        drone.observe()
        drone.send(FORWARD)
        yield drone


def end(drone: SupervisedDrone) -> None:
    drone._process.kill()
    drone._process.wait()


def landing(peer: Peer) -> bool:
    return peer.part.mode == MODES["LAND"]


PILOT = """
import sys, time
sys.path.insert(0, {folder!r})
import numpy as np
from peer import StillCamera
from cognitivedrone.control.safety import SafetyConfig, Timeouts
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.guard.drone import SupervisedDrone
safety, config = SafetyConfig({rules}), MavlinkConfig(takeoff_timeout_s=60)
drone = SupervisedDrone("udpout:127.0.0.1:{port}", StillCamera(), safety, config)
print(drone.process, flush=True)
drone.take_off(lambda _: True)
print("flying", flush=True)
began = time.monotonic()
while True:
    drone.observe()
    drone.send(np.array([1, 0, 0, 0], np.float32))
    time.sleep(0.05)
    if time.monotonic() > began + 0.3:
        {after}
"""


QUICK = "land_after_brake_s=0.2"
PATIENT = ", ".join(f"{name}=Timeouts(600, 600)" for name in ("policy", "first_command", "camera", "link", "state"))
PATIENT += ", " + ", ".join(f"{name}=Timeouts(600, 600)" for name in ("heartbeat", "uplink", "estimator_report"))
"""Rules by which no silence ends a flight within a test: what does is noticed by itself, and at once."""


@contextmanager
def pilot(peer: Peer, after: str = "pass", rules: str = QUICK) -> Iterator[subprocess.Popen[str]]:
    """A pilot process of its own, in a session of its own; `after` is what it does in flight. It is reaped."""
    code = PILOT.format(folder=str(Path(__file__).parent), port=peer.port, after=after, rules=rules)
    # A guard that lands after the end of its pilot keeps standard error open: a pipe would never close.
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        start_new_session=True,
    )  # fmt: skip
    guard = int(process.stdout.readline())
    try:
        yield process
        process.kill()
        soon(lambda: not Path(f"/proc/{guard}").exists())
    finally:
        for number in (process.pid, guard):
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        process.communicate()


# A flight.


@pytest.fixture
def streams(monkeypatch):
    """Between pilot, guard and log as on macOS: no sockets of messages."""
    monkeypatch.setattr(messages, "message_pair", lambda: (*socket.socketpair(), True))


@pytest.mark.usefixtures("streams")
def test_a_flight_over_streams(tmp_path):
    test_a_flight_from_arming_to_landing(tmp_path)


@pytest.mark.usefixtures("streams")
@pytest.mark.parametrize("nonsense", ["too long", "not a number"])
def test_nonsense_over_a_stream_lands_when_it_goes_on(nonsense):
    test_nonsense_stops_once_and_lands_when_it_goes_on(nonsense)


@pytest.mark.usefixtures("streams")
def test_a_stream_that_carries_no_messages_any_more_lands():
    with playing() as peer, flying(peer) as drone:
        soon(lambda: peer.setpoints_since(0))
        drone._socket._end.send(b"\xff" * 100)
        soon(lambda: landing(peer))
        soon(lambda: drone._gone)
        with pytest.raises(LinkError, match="the guard process has ended"):
            drone.close()


def test_a_flight_from_arming_to_landing(tmp_path):
    log = tmp_path / "new" / "flight.tlog"
    with playing() as peer:
        with connected(peer, config=replace(SURE, tlog=log)) as drone:
            lists = []
            drone.take_off(lambda checklist: lists.append(str(checklist)) or True)  # type: ignore[func-returns-value]
            before = time.monotonic()
            seen = drone.observe()
            assert drone.send(FORWARD) == pytest.approx(FORWARD)
            soon(lambda: peer.setpoints_since(before))
            assert drone.decision.kind == "fly"
            assert drone.over is None
        assert "ArduCopter 4.6" in lists[0]
        assert "80% left" in lists[0]
        assert [c.command for c in peer.orders(176, 400, 22)] == [176, 400, 22, 176]
        assert peer.modes_ordered() == [MODES["GUIDED"], MODES["LAND"]]
        assert (drone.over, drone.log_trouble) == ("the flight is over", "")
        assert drone._process.returncode == process.LANDED
        assert drone.camera.closed
    # Heading north at 1 m/s, 0.5 east, 0.25 down; half a metre up is where it stood.
    assert seen.velocity == pytest.approx([1.0, -0.5, -0.25])
    assert seen.height == pytest.approx(1.5)
    assert seen.yaw_rate == pytest.approx(-0.25)
    assert seen.image.shape == (256, 256, 3)
    assert kinds_logged(log) >= FLOWN


def test_the_camera_is_as_fresh_when_the_vehicle_needs_long_to_be_ready():
    with playing(prearm=False) as peer, connected(peer, config=SURE) as drone:
        timer = threading.Timer(2 * FRESH_S, setattr, (peer.part, "prearm", True))
        timer.start()
        lists: list[str] = []
        drone.take_off(lambda checklist: lists.append(str(checklist)) or True)  # type: ignore[func-returns-value]
        timer.join()
    assert re.search(r"\[ ok \] camera +newest frame is 0\.\d s old", lists[0]), lists[0]


def test_what_is_not_fit_to_fly_is_reported_as_it_is_in_this_process():
    with playing(battery=20) as peer, connected(peer) as drone:
        with pytest.raises(LinkError, match=r"(?s)not fit to fly.*\[bad \] battery"):
            drone.take_off(lambda _: True)
        peer.part.battery = 80
        soon(lambda: drone.telemetry.battery == 0.8)
        with pytest.raises(LinkError, match="not confirmed"):
            drone.take_off(lambda _: False)
        assert not peer.part.armed
        assert peer.orders(176, 400, 22) == []


def test_a_link_that_cannot_be_opened():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(LinkError, match="is the port right, and free"):
            SupervisedDrone(f"udp:127.0.0.1:{taken.getsockname()[1]}", StillCamera())


def test_the_guard_loads_nothing_heavy():
    code = "import sys, cognitivedrone.vehicles.mavlink.guard.process; print('\\n'.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not set(loaded) & {"av", "PIL", "mujoco", "scipy", "gymnasium", "pyarrow", "onnxruntime", "torch", "rich"}


# The pilot process.


@pytest.mark.parametrize(("number", "rules"), [(signal.SIGKILL, PATIENT), (signal.SIGSTOP, QUICK)])
def test_a_pilot_process_that_is_killed_is_landed_at_once_and_one_that_is_stopped_by_the_rules(number, rules):
    with playing() as peer, pilot(peer, rules=rules) as process:
        soon(lambda: peer.setpoints_since(0))
        process.send_signal(number)
        soon(lambda: landing(peer))


def test_a_pilot_process_that_holds_the_interpreter_is_stopped_braked_and_landed():
    holds = "import re; re.match('(a+)+$', 'a' * 60 + 'b')"  # one call into C that takes years
    with playing() as peer, pilot(peer, holds):
        soon(lambda: len(peer.setpoints_since(0)) >= 3)
        soon(lambda: stopped(peer))
        soon(lambda: landing(peer))


def stopped(peer: Peer) -> bool:
    """Whether a stop was heard after a velocity; before the first command of the pilot the guard holds, too."""
    speeds = [s.vx for _, s in list(peer.received) if s.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    return 0.0 in speeds[next((n for n, vx in enumerate(speeds) if vx), len(speeds)) :]


@pytest.mark.parametrize("guard", [False, True], ids=["pilot process", "guard"])
@pytest.mark.parametrize(
    ("number", "climbing"),
    [(signal.SIGHUP, False), (signal.SIGTERM, True), pytest.param(signal.SIGINT, False, marks=pytest.mark.slow)],
)
def test_a_signal_to_the_pilot_process_or_the_guard_lands_in_climb_and_flight(number, climbing, guard):
    with playing(climbs=not climbing) as peer, pilot(peer, rules=PATIENT) as process:
        if climbing:
            soon(lambda: peer.orders(22))
        else:
            soon(lambda: peer.setpoints_since(0))
        if guard:
            os.kill(children(process.pid)[0], number)
        else:
            os.killpg(process.pid, number)
        soon(lambda: landing(peer))


def children(process: int) -> list[int]:
    return list(map(int, Path(f"/proc/{process}/task/{process}/children").read_text().split()))


def raw(drone: SupervisedDrone, data: bytes) -> None:
    drone._socket.send(data)


NONSENSE: dict[str, Callable[[int], bytes]] = {
    "too long": lambda _: bytes(3000),
    "an old number": lambda _: pack(Kind.SETPOINT, 1, time.monotonic_ns(), deadline_ns=2**62),
    "not a number": lambda n: pack(
        Kind.SETPOINT, n, time.monotonic_ns(), deadline_ns=2**62, command=np.array([np.nan, 0, 0, 0])
    ),
}
"""Of what `test_what_is_wrong_with_a_message_is_counted` has."""


@pytest.mark.parametrize("nonsense", NONSENSE)
def test_nonsense_stops_once_and_lands_when_it_goes_on(nonsense):
    with playing() as peer, flying(peer) as drone:
        soon(lambda: peer.setpoints_since(0))
        before = time.monotonic()
        raw(drone, NONSENSE[nonsense](10_000))
        soon(lambda: STOP in peer.setpoints_since(before))
        sent = peer.setpoints_since(before)
        assert not np.any(sent[sent.index(STOP) :])  # a command before it may have been on its way
        if nonsense != "not a number":  # which has used up the number
            assert drone.send(FORWARD)[0] > 0
            assert drone.over is None
        for n in range(process.MOST_FAULTS + 1):
            raw(drone, NONSENSE[nonsense](10_001 + n))
        drone._sequence = 20_000  # whose numbers count again
        soon(lambda: landing(peer))
        soon(lambda: drone.over)
        assert "sends what cannot be flown by" in drone.over


def test_a_flood_lands_and_the_guard_goes_on_heartbeating():
    with playing() as peer, flying(peer) as drone:
        stop = threading.Event()

        def flood() -> None:
            while not stop.is_set():
                with suppress(BlockingIOError):
                    drone._post(Kind.SETPOINT, FORWARD)

        thread = threading.Thread(target=flood)
        thread.start()
        try:
            soon(lambda: landing(peer))
            beats = len(peer.of("HEARTBEAT"))
            soon(lambda: len(peer.of("HEARTBEAT")) > beats)
        finally:
            stop.set()
            thread.join()
        soon(lambda: drone.over)
        assert "messages a second" in drone.over


# The guard itself.


def test_a_guard_that_was_stopped_lands():
    with playing() as peer, flying(peer) as drone:
        os.kill(drone.process, signal.SIGSTOP)
        time.sleep(process.LOST_S + 0.2)
        os.kill(drone.process, signal.SIGCONT)
        soon(lambda: landing(peer))
        soon(lambda: drone.over)
        assert "stood still" in drone.over


def test_a_guard_that_dies_is_reported():
    with playing() as peer, flying(peer) as drone:
        os.kill(drone.process, signal.SIGKILL)
        soon(lambda: drone._gone)
        with pytest.raises(LinkError, match=r"guard process has ended \(exit code -9\).*FS_GCS_ENABLE"):
            drone.send(FORWARD)
        with pytest.raises(LinkError, match="has ended"):
            drone.close()
        assert drone.camera.closed


def test_after_a_take_over_it_is_silent_orders_nothing_and_outlives_the_pilot_process():
    with playing() as peer:
        with connected(peer, config=SURE) as drone:
            drone.take_off(lambda _: True)
            drone.send(FORWARD)
            peer.part.mode = MODES["LOITER"]
            soon(lambda: drone.over)
            assert "LOITER" in drone.over
            assert f"process {drone.process} stays until it is disarmed" in drone.over
            released = time.monotonic()
            assert not drone.send(FORWARD).any()
            drone.close()
            beats, asked = len(peer.of("HEARTBEAT")), len(peer.of("TIMESYNC"))
            soon(lambda: len(peer.of("TIMESYNC")) >= asked + 8)  # five a second
            assert len(peer.of("HEARTBEAT")) <= beats + 1  # silent, it lets the vehicle's own failsafe act
            assert drone._process.poll() is None
            os.kill(drone.process, signal.SIGHUP)  # a terminal that goes away is no dismissal
            peer.part.mode = MODES["RTL"]  # which a silence of ours would change
            soon(lambda: len(peer.of("HEARTBEAT")) >= beats + 3)
            peer.part.armed = False
            assert drone._process.wait(60) == process.LANDED
        assert peer.setpoints_since(released) == []
        assert peer.orders(since=released) == []


def test_after_a_take_over_the_operator_dismisses_it():
    with playing() as peer, flying(peer) as drone:
        assert drone._process.poll() is None
        peer.part.mode = MODES["LOITER"]
        soon(lambda: drone.over)
        os.kill(drone.process, signal.SIGTERM)
        assert drone._process.wait(60) == process.LEFT


def test_a_link_that_is_cut_is_opened_again_to_land():
    with socket.create_server(("127.0.0.1", 0)) as server, playing() as peer, Router(server, peer) as router:
        drone = SupervisedDrone(f"tcp:127.0.0.1:{server.getsockname()[1]}", StillCamera(), CALM, SURE)
        try:
            drone.take_off(lambda _: True)
            drone.send(FORWARD)
            router.cut()
            soon(lambda: landing(peer))
            with pytest.raises(LinkError, match=r"closed by the other side|was cut"):
                drone.close()
        finally:
            end(drone)


class Router:
    """One TCP client and one vehicle over UDP."""

    def __init__(self, server: socket.socket, peer: Peer) -> None:
        self._server = server
        self._vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle.connect(("127.0.0.1", peer.port))
        self._vehicle.settimeout(0.01)
        self._client: socket.socket | None = None
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=each) for each in (self._up, self._down)]

    def __enter__(self) -> Router:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self.cut()
        self._vehicle.close()

    def cut(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def _up(self) -> None:
        self._server.settimeout(0.05)
        while not self._stop.is_set():
            with suppress(OSError), self._server.accept()[0] as client:
                client.settimeout(0.05)
                self._client = client
                while not self._stop.is_set():
                    with suppress(TimeoutError):
                        if not (data := client.recv(4096)):
                            break
                        self._vehicle.send(data)

    def _down(self) -> None:
        while not self._stop.is_set():
            with suppress(OSError):
                data = self._vehicle.recv(4096)
                if self._client is not None:
                    self._client.sendall(data)


# Logs.


@pytest.mark.parametrize("disk", ["full", "too slow"])
def test_a_full_or_slow_disk_costs_the_log_and_nothing_else(disk, tmp_path, monkeypatch):
    reader, writer = os.pipe()  # nobody reads it: what writes waits for ever
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    files: dict[str, str | int] = {"full": "/dev/full", "too slow": writer}
    monkeypatch.setattr(transport, "create", lambda *_: open(files[disk], "wb", buffering=0))  # noqa: PTH123, SIM115
    with playing() as peer:
        with flying(peer, config=replace(SURE, tlog=tmp_path / "flight.tlog")) as drone:
            before = time.monotonic()
            for _ in range(10):
                drone.observe()
                assert drone.send(FORWARD)[0] > 0
            soon(lambda: len(peer.setpoints_since(before)) >= 10)
            assert drone.over is None
            beats = len(peer.of("HEARTBEAT"))
            soon(lambda: len(peer.of("HEARTBEAT")) > beats + 1)
        assert landing(peer)
    reason = {"full": "No space left on device", "too slow": "the disk was too slow"}
    assert f"packets are not in the log: {reason[disk]}" in drone.log_trouble
    os.close(reader)


def test_a_stream_whose_reader_has_stopped_drops_whole_packets():
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = open_transport(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        with server.accept()[0] as reader:
            packet = bytes(range(250))
            began = time.monotonic()
            while link.dropped < 10:
                link.write(packet)
            assert time.monotonic() - began < 60
            got = b""
            reader.settimeout(0.2)
            with suppress(TimeoutError):
                while data := reader.recv(1 << 20):
                    got += data
            assert len(link._backlog) <= LARGEST_BACKLOG
            assert got.startswith(packet * (len(got) // len(packet)))
        link.close()


# Messages.

NOW = 10**12


def setpoint(sequence: int, **changes: object) -> bytes:
    values: dict[str, object] = {"deadline_ns": NOW + 10**8, "frame_age_s": 0.1, "command": FORWARD} | changes
    return pack(Kind.SETPOINT, sequence, values.pop("sent_ns", NOW), **values)  # type: ignore[arg-type]


def test_a_message_is_read_as_it_was_written():
    message = Inbox().read(setpoint(7), NOW)
    assert isinstance(message, Message)
    assert (message.kind, message.sequence, message.sent_s) == (Kind.SETPOINT, 7, 1000.0)
    assert message.deadline_s == pytest.approx(1000.1)
    assert message.command == pytest.approx(FORWARD)


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\x01", "size"),
        (setpoint(7)[:-1], "size"),
        (setpoint(7) + b"\0", "size"),
        (b"\0" * MESSAGE_BYTES, "format"),
        (setpoint(5), "sequence"),
        (setpoint(7, sent_ns=NOW + 10**9), "time"),
        (setpoint(7, deadline_ns=NOW - 1), "late"),
        (setpoint(7, frame_age_s=-1.0), "number"),
        (setpoint(7, command=np.array([0, 0, np.nan, 0])), "number"),
        (setpoint(7, command=np.array([0, 0, 0, np.inf])), "number"),
    ],
)
def test_what_is_wrong_with_a_message_is_counted(data, kind):
    inbox = Inbox()
    assert isinstance(inbox.read(setpoint(5), NOW), Message)
    found = inbox.read(data, NOW)
    assert isinstance(found, Fault)
    assert (found.kind, dict(inbox.faults)) == (kind, {kind: 1})


def test_more_messages_than_any_pilot_sends_are_a_flood_until_it_ends():
    inbox = Inbox()
    found = [inbox.read(setpoint(n + 1), NOW) for n in range(LARGEST_RATE + 5)]
    assert [isinstance(each, Message) for each in found] == [True] * LARGEST_RATE + [False] * 5
    later = NOW + 2 * 10**9
    assert isinstance(inbox.read(setpoint(10_000, deadline_ns=later), later), Message)


@given(st.lists(st.binary(max_size=2 * MESSAGE_BYTES) | st.binary(min_size=MESSAGE_BYTES, max_size=MESSAGE_BYTES)))
def test_nothing_that_arrives_raises(packets):
    inbox = Inbox()
    for packet in packets:
        inbox.read(packet, NOW)
        # The same behind a good head, so that the numbers are reached.
        head = setpoint(inbox.sequence + 1)[:20]
        inbox.read((head + packet.ljust(MESSAGE_BYTES, b"\xff"))[:MESSAGE_BYTES], NOW)


def test_a_vehicle_whose_heartbeats_are_gone_is_lost_whatever_else_comes(monkeypatch):
    """Also in a flood of texts, which proves the link and nothing of the vehicle."""
    monkeypatch.setattr(process, "GONE_S", 0.3)
    pilot, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with playing() as peer, pilot, other:
        pilot.setblocking(False)
        guard = process.GuardProcess(
            MessageSocket(pilot, framed=False),
            f"udpout:127.0.0.1:{peer.port}",
            SafetyConfig(),
            SURE,
            PacketLog(None),
            watched=-1,
        )
        core = guard._core
        while core.link.vehicle is None:
            core.link.step()
        core.phase, guard._leaving = "flying", True
        assert guard._code() is None
        peer.part.quiet = frozenset({"HEARTBEAT"})
        began = time.monotonic()
        core.link._watch = lambda: None
        while guard._code() is None or core.telemetry.received_at < began:
            core.link.step()
            assert time.monotonic() < began + 60
        assert guard._code() == process.LOST
        core.link.close()
        guard._wake.close()
        guard._woken.close()
