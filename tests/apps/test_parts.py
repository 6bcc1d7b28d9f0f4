"""The parts of `fly`, each alone: view, keyboard, orders, frame server, log."""

import http.client
import json
import os
import pty
import signal
import termios
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
import pytest
from app_fakes import camera
from rich.console import Console
from waiting import soon

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.log import FlightLog
from cognitivedrone.apps.orders import Keyboard, Orders, landing_on_interrupt
from cognitivedrone.apps.values import Ending, Status, Step, Summary
from cognitivedrone.apps.vehicle import MOST_VIEWERS, FrameServer
from cognitivedrone.apps.view import EVENTS_SHOWN, Instruments, Printer, summary_table
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.cli.scoring import ViewPlan
from cognitivedrone.errors import CameraError, LinkError, RunError
from cognitivedrone.play.config import PlayPlan
from cognitivedrone.system.interrupts import until_asked
from cognitivedrone.types import Event, EventKind, Guidance, Observation
from cognitivedrone.vehicles import check_vehicle
from cognitivedrone.vehicles.camera import open_camera

ACTION = np.array([1.25, -0.5, 0.25, 0.4], dtype=np.float32)


def test_what_people_watch_is_in_places_and_the_benchmark_stays_plain() -> None:
    assert FlyPlan().scenario.appearance == PlayPlan().scenario.appearance == "photo"
    assert FlyPlan.of(link="sitl").scenario.appearance == "photo"
    assert FlyPlan.of(appearance="plain").scenario.appearance == "plain"
    assert FlyPlan.of(place="hall").scenario.place == "hall"
    assert Plan().scenario.appearance == ViewPlan().scenario.appearance == "plain"


def test_a_vehicle_with_surroundings_of_its_own_asks_for_none() -> None:
    plan = FlyPlan.of(link="gazebo", airframe="iris")
    assert plan.scenario.appearance == "plain"
    check_vehicle(plan.vehicle, plan.scenario)
    asked = FlyPlan.of(link="gazebo", airframe="iris", place="hall")
    with pytest.raises(RunError, match="Gazebo worlds have no photographed places"):
        check_vehicle(asked.vehicle, asked.scenario)
    real = FlyPlan.of(instruction="x", link="mavlink:udp:127.0.0.1:14550", camera="/dev/video0")
    assert real.scenario.appearance == "plain"


def step(time_s: float, **status: object) -> Step:
    seen = Observation(
        np.zeros((256, 256, 3), np.uint8), "Fly through the red gate", np.array([1.0, 0.2, -0.1], np.float32),
        0.87, -0.3, time_s,
    )  # fmt: skip
    known = {
        "position": np.array([1.5, -2.5, 0.75]), "yaw": np.pi / 2, "mode": "GUIDED", "battery": 0.62,
        "frame_age_s": 0.034, "link_age_s": 0.012,
    }  # fmt: skip
    guidance = Guidance("Fly through the red gate", 1, 0.8, 0.3)
    return Step(time_s, 1, "Find the cat", seen, ACTION, guidance, 0.021, Status(**(known | status)))  # type: ignore[arg-type]


def drawn(view: object) -> str:
    console = Console(record=True, width=110, file=open(os.devnull, "w"))  # noqa: PTH123, SIM115
    with console.file:
        console.print(view)
    return console.export_text()


def test_the_view_shows_everything():
    view = Instruments("small + small on sim", lambda: "go le")
    assert "waiting for the first command" in drawn(view)
    view.event(Event(0.0, "segment", "Find the cat"))
    for i in range(11):
        view.step(step(12.0 + i / 10, decision="hold", reason="no new camera frame for 0.60 s"))
    view.event(Event(13.0, "adopted", "Fly through the red gate", 0.31))
    view.event(Event(13.1, "late", age_s=0.05))
    text = drawn(view)
    for message in (
        "small + small on sim", "13.0 s, 10.0 Hz, 1 late", "Find the cat", "Fly through the red gate (80% sure",
        "frame 0.3 s old",
        "forward +1.25, left -0.50, up +0.25 m/s, turn +0.40 rad/s", "forward +1.00, left +0.20, up -0.10",
        "+1.50 -2.50 +0.75 m, heading +90 deg, height 0.87 m", "GUIDED, armed, battery 62%", "34 ms", "12 ms",
        "policy 21 ms, reasoner 310 ms", "hold: no new camera frame for 0.60 s", "adopted", "> go le", "ctrl-C lands",
    ):  # fmt: skip
        assert message in text, message


def test_the_view_says_that_the_reasoner_is_too_late_until_it_is_not():
    view, says = Instruments("R1 on sim"), "the last 40 answers of the reasoner were late: the policy flies without it"
    view.step(step(30.0))
    view.event(Event(29.0, "unaided", says, 0.9))
    for number in range(10):
        view.event(Event(29.5 + number, "adopted", "Fly through the red gate", 0.9))
    assert says in drawn(view)
    view.event(Event(45.0, "agreed", "Fly through the red gate", 0.4))
    assert says not in drawn(view)


def test_the_view_says_what_is_not_known_and_forgets_old_events():
    view = Instruments("x")
    view.step(step(0.0, position=None, yaw=float("nan"), battery=None))
    for i in range(EVENTS_SHOWN + 1):
        view.event(Event(float(i), "kept", f"answer {i}"))
    text = drawn(view)
    assert "position  not known, height" in text
    assert "battery not reported" in text
    assert "answer 0" not in text
    assert f"answer {EVENTS_SHOWN}" in text


def printed(*events: Event) -> list[str]:
    """The lines where there is no terminal."""
    console = Console(record=True, width=40, file=open(os.devnull, "w"))  # noqa: PTH123, SIM115
    printer = Printer(console)
    with console.file:
        for event in events:
            printer.event(event)
    return console.export_text().splitlines()


def test_without_a_terminal_there_is_a_line_for_each_event_that_matters():
    far = Event(1.0, "segment", "[red]go[/red] " + "far " * 20)
    assert printed(far, Event(1.1, "asked", "quiet"), Event(2.0, "guard", "brake: why", 0.5)) == [
        "   1.0 s  segment   [red]go[/red] " + "far " * 20, "   2.0 s  guard     brake: why (500 ms)"
    ]  # fmt: skip


def test_without_a_terminal_an_answer_is_a_line_only_when_it_changes():
    events: tuple[tuple[float, EventKind, str], ...] = (
        (0.0, "segment", "to the cat"), (0.1, "unsure", "I see a dog"), (0.6, "unsure", "I see a dog"),
        (0.7, "hold", "hovering"), (1.1, "unsure", "I see a dog"), (1.6, "unsure", "I see a cat"),
        (2.1, "adopted", "Fly left"), (2.6, "unsure", "I see a cat"), (3.0, "segment", "to the cat"),
        (3.0, "segment", "to the cat"), (3.1, "unsure", "I see a cat"),
    )  # fmt: skip
    lines = printed(*(Event(time_s, kind, output, time_s / 100) for time_s, kind, output in events))
    assert [line.split()[0] for line in lines] == ["0.0", "0.1", "0.7", "1.6", "2.1", "2.6", "3.0", "3.0", "3.1"]


def test_the_summary_leaves_out_who_never_thought():
    nan = float("nan")
    text = drawn(summary_table(Summary(Ending("time", "over"), 7, 0.7, 2, (20.4, 31.0), (nan, nan), Path("f"))))
    assert "7 commands, 2 of them more than 10 ms late" in text
    assert "20 ms (median), 31 ms (95 %)" in text
    assert "reasoner" not in text


def test_the_summary_names_the_film_that_was_written(tmp_path):
    ending, nan = Ending("flown", "flew through gate 2 (cat; you judge), after 4.0 s"), float("nan")
    summary = Summary(ending, 7, 0.7, 2, (20.4, 31.0), (nan, nan), tmp_path)
    assert "film" not in drawn(summary_table(summary))
    (tmp_path / "flight.mp4").touch()
    assert f"film{tmp_path}/flight.mp4" in "".join(drawn(summary_table(summary)).split())


def test_what_is_typed():
    orders = Orders()
    assert orders.given == (0, "")
    for line in ("  ", "fly  to the\tred gate ", "x" * 1000):
        orders.say(line)
    assert orders.given == (2, "x" * 500)
    assert orders.ending is None
    orders.say(" Land ")
    orders.land(Ending("interrupted", "later"))
    assert orders.ending == Ending("ordered", "'Land' was typed")


def test_ctrl_c_asks_to_land_first_and_stops_at_the_second():
    before = signal.getsignal(signal.SIGINT)
    orders = Orders()
    with landing_on_interrupt(orders):
        signal.raise_signal(signal.SIGTERM)
        assert orders.ending == Ending("interrupted", "asked to terminate")
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == before
    with until_asked() as stop:
        assert not stop()
        signal.raise_signal(signal.SIGINT)
        assert stop()
    assert signal.getsignal(signal.SIGINT) == before


def test_a_terminal_is_read_key_by_key_and_put_back():
    ours, theirs = pty.openpty()
    before, heard = termios.tcgetattr(theirs), []
    with os.fdopen(theirs) as stream, Keyboard(stream, heard.append) as keyboard:
        os.write(ours, b"fly \x1bleftt\x7f")
        soon(lambda: keyboard.typed == "fly left")
        assert not termios.tcgetattr(theirs)[3] & termios.ECHO
        os.write(ours, " über\n\nlan".encode())
        soon(lambda: keyboard.typed == "lan")
        assert heard == ["fly left über"]
        keyboard.__exit__()
        assert termios.tcgetattr(theirs) == before
    os.close(ours)


def test_a_pipe_is_read_to_its_end():
    reading, writing = os.pipe()
    os.write(writing, b"one\ntwo")
    os.close(writing)
    heard: list[str] = []
    with os.fdopen(reading) as stream, Keyboard(stream, heard.append):
        soon(lambda: len(heard) == 2)
    assert heard == ["one", "two"]


def test_a_camera_reads_what_the_frame_server_shows():
    picture = np.zeros((256, 256, 3), np.uint8)
    picture[:128] = (200, 30, 60)
    with camera(picture) as url:
        eye = open_camera(url)
        assert eye.read().image[20, 10] == pytest.approx([200, 30, 60], abs=8)
        assert eye.read().image[200, 10].max() < 20
        first = eye.read().time
        soon(lambda: eye.read().time > first)
        eye.close()
        with pytest.raises(CameraError, match="cannot serve frames at port"):
            FrameServer(int(url.rstrip("/").rpartition(":")[2]))


def test_the_frame_server_has_limits():
    with FrameServer(0) as frames:
        port = int(frames.url.rstrip("/").rpartition(":")[2])

        def ask(path: str) -> tuple[http.client.HTTPConnection, int]:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            connection.request("GET", path)
            return connection, connection.getresponse().status

        asked = [ask("/etc/passwd")] + [ask("/") for _ in range(MOST_VIEWERS + 1)]
        assert [status for _, status in asked] == [404, *[200] * MOST_VIEWERS, 503]
        for connection, _ in asked:
            connection.close()

        def none_left() -> bool:
            frames.show(np.zeros((256, 256, 3), np.uint8))
            return not frames.wait_for_viewer(0.0)

        soon(none_left)


def test_the_login_of_a_camera_is_not_in_the_log(tmp_path):
    log = FlightLog(tmp_path / "f", {"config": {"safety": {"camera": "rtsp://user:a secret@10.0.0.5/live?t=secret"}}})
    assert "secret" not in (tmp_path / "f" / "flight.json").read_text()  # also of a flight that was killed
    log.event(Event(0.0, "guard", "cannot read rtsp://user:secret@10.0.0.5/live"))
    assert log.events[0].text == "cannot read rtsp://***@10.0.0.5/live"  # which the film's page shows
    log.close(None, "rtsp://user:secret@10.0.0.5/live gave no frame")
    assert "secret" not in (tmp_path / "f" / "flight.json").read_text()
    about = json.loads((tmp_path / "f" / "flight.json").read_text())
    assert about["config"]["safety"]["camera"] == "rtsp://***@10.0.0.5/live?t=***"
    assert about["end"]["error"].startswith("rtsp://***@10.0.0.5")
    assert pq.read_table(tmp_path / "f" / "events.parquet")["text"].to_pylist() == [
        "cannot read rtsp://***@10.0.0.5/live"
    ]


def test_the_film_can_be_seen_where_the_flight_was_cut_short(tmp_path):
    log = FlightLog(tmp_path / "f", {})
    for i in range(40):
        log.step(step(i / 10))
    cut = tmp_path / "cut.mp4"

    def readable() -> bool:
        film_so_far = tmp_path / "f" / "camera.mp4"
        if not film_so_far.exists():
            return False
        cut.write_bytes(film_so_far.read_bytes())
        try:
            with av.open(str(cut)) as film:
                return sum(1 for _ in film.decode(video=0)) >= 10
        except av.error.FFmpegError:
            return False

    soon(readable)
    log.close(error="cut")


def test_what_is_typed_said_and_told_is_no_markup() -> None:
    evil, shown = "[/f] [bold]x \x1b[2J\u202e", r"[/f] [bold]x \x1b[2J\u202e"
    view = Instruments(evil, lambda: evil)
    one = step(0.1, mode=evil, reason=evil)
    view.step(replace(one, instruction=evil, guidance=Guidance(evil, 1, 0.8, 0.3)))
    view.event(Event(0.1, "adopted", evil, 0.1))
    page = drawn(view)
    assert page.count(shown) == 7  # title, instruction, directive, mode, reason, event, typed
    assert "\x1b" not in page
    summary = Summary(Ending("ordered", evil), 3, 0.3, 0, (1.0, 2.0), (1.0, 2.0), Path(evil))
    assert drawn(summary_table(summary)).count(shown) == 2


@pytest.mark.parametrize("evil", ["red\x1b[2J", "red\ud800", "red\u202e"])
def test_an_instruction_is_a_text_that_can_be_shown_and_written(evil: str) -> None:
    with pytest.raises(LinkError, match=r"the instruction contains the .*; leave that out"):
        FlyPlan.of(instruction=evil)


def test_a_log_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    log = FlightLog(tmp_path, {})
    (tmp_path / "steps.parquet").mkdir()
    with pytest.raises(RunError, match=r"cannot write .*; make room there or give another place") as message:
        log.close()
    assert "\n" not in str(message.value)
