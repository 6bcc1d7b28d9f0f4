"""The log of one flight: every control step and event, and a recording of the camera.

| file | |
|---|---|
| `steps.parquet` | one row per control step: state, command, latency, decision (`STEP_COLUMNS`) |
| `events.parquet` | segments, answers of the reasoner, missed deadlines, decisions of the guard (`EVENT_COLUMNS`) |
| `camera.mp4` | the frames at the times when they were used; readable even if it is incomplete |
| `flight.tlog` | for a MAVLink vehicle: everything received and sent, for ground stations |
| `bag/` | on request: a ROS 2 bag (`apps/bag.py`) |
| `flight.json` | the options of the flight and how it ended |

The film and the page of a flight, made from its log once it is over.
"""

from __future__ import annotations

import json
import queue
import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console

from cognitivedrone.apps.bag import BagLog
from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.values import EndKind, Step, Summary
from cognitivedrone.apps.view import SILENT, say
from cognitivedrone.data.formats.mcap import Ros
from cognitivedrone.errors import CognitiveDroneError, RunError
from cognitivedrone.files import create, replace_file, replacing, writing
from cognitivedrone.film.frame import Film, FilmFrame, Scene, Verdict
from cognitivedrone.film.movie import read_mp4, write_flight
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.tasks.missions import is_mission, sub_goals
from cognitivedrone.terminal import console as stderr_console
from cognitivedrone.terminal.progress import counted
from cognitivedrone.text.printable import shown_address, without_secrets
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, Event, Image, SeenPanel

STEPS_FILE, EVENTS_FILE, CAMERA_FILE, BAG_FOLDER, ABOUT_FILE = (
    "steps.parquet", "events.parquet", "camera.mp4", "bag", "flight.json"
)  # fmt: skip
_NUMBERS = (
    "time_s", "x_m", "y_m", "z_m", "yaw_rad", "vx_m_s", "vy_m_s", "vz_m_s", "height_m", "yaw_rate_rad_s",
    "sent_vx_m_s", "sent_vy_m_s", "sent_vz_m_s", "sent_yaw_rate_rad_s", "directive_age_s", "confidence",
    "frame_age_s", "link_age_s", "policy_s", "battery",
)  # fmt: skip
STEP_COLUMNS = pa.schema(
    [
        *((name, pa.float64()) for name in _NUMBERS),
        ("segment", pa.int32()),
        ("armed", pa.bool_()),
        *((name, pa.string()) for name in ("instruction", "directive", "mode", "decision", "reason")),
    ]
)
"""Position ENU, m; velocities in the heading frame; null where unknown."""
EVENT_COLUMNS = pa.schema(
    [("time_s", pa.float64()), ("kind", pa.string()), ("text", pa.string()), ("age_s", pa.float64())]
)
_WHOLE_ADDRESS = re.compile(r"[\w.:+-]+://")
_TICKS_PER_S = 1000
_NO_IMAGE = np.empty((0, 0, 3), np.uint8)
_QUEUED = 5 * CONTROL_HZ


class FlightLog:
    """Writes to a new folder. Always call `close`: the tables are written then.

    A thread encodes the film: a slow disk drops frames (`dropped`) but never delays a command. With `ros`, a bag is
    written as well; what the `reasoner` reads goes into the film. Raises `RunError` if the folder cannot be written or
    already contains a flight.
    """

    def __init__(
        self, out: Path, about: Mapping[str, Any], ros: Ros | None = None, reasoner: Reasoner | None = None
    ) -> None:
        self.out = out
        self._reasoner = reasoner
        self.dropped = 0
        """Number of frames missing from the film because the disk was too slow or full."""
        self._about: dict[str, Any] = _shown(dict(about))
        self.events: list[Event] = []
        self._steps: list[dict[str, Any]] = []
        self._filmed: list[FilmFrame] = []
        """The steps whose frames are in the recording, without images."""
        check_free(out)
        _make(out)
        with writing(out, RunError, "give another folder with --out"):
            text = json.dumps(self._about, indent=2, default=str)
            replace_file(out / ABOUT_FILE, f"{text}\n".encode("utf-8", "backslashreplace"))
            self._bag = None if ros is None else BagLog(out / BAG_FOLDER, ros, self._about)
            self._film = _Film(out / CAMERA_FILE)

    def step(self, step: Step) -> None:
        """Record a control step."""
        self._steps.append(_row(step))
        if self._film.add(step.time, step.observation.image):
            self._filmed.append(_film_frame(step, () if self._reasoner is None else self._reasoner.seen))
        else:
            self.dropped += 1
        if self._bag is not None:
            self._bag.step(step)

    def event(self, event: Event) -> None:
        """Record an event; its text goes into tables, the bag and the page of the film."""
        event = replace(event, text=without_secrets(event.text))
        self.events.append(event)
        if self._bag is not None:
            self._bag.event(event)

    def frames(self) -> Iterator[FilmFrame]:
        """The flight for a film, after `close`; the images are read from the recording."""
        for frame, image in zip(self._filmed, read_mp4(self.out / CAMERA_FILE), strict=False):
            yield replace(frame, image=image)

    def close(self, summary: Summary | None = None, error: str = "") -> None:
        """Write everything, and how the flight ended, if known."""
        self._film.close()
        if self._bag is not None:
            self._bag.close()
        with writing(self.out, RunError):
            self._write_tables(summary, error)

    def _write_tables(self, summary: Summary | None, error: str) -> None:
        with replacing(self.out / STEPS_FILE) as steps:
            pq.write_table(pa.Table.from_pylist(self._steps, STEP_COLUMNS), steps)
        events = [{"time_s": e.time, "kind": e.kind, "text": e.text, "age_s": e.age_s} for e in self.events]
        with replacing(self.out / EVENTS_FILE) as table:
            pq.write_table(pa.Table.from_pylist(events, EVENT_COLUMNS), table)
        ended: dict[str, Any] = {"steps": len(self._steps), "frames_dropped": self.dropped, "error": error or None}
        if self._bag is not None:
            ended["dropped_from_bag"] = self._bag.dropped
        if summary is not None:
            ended |= {
                "ending": summary.ending.kind,
                "reason": summary.ending.reason,
                "seconds": round(summary.seconds, 3),
                "late": summary.late,
            }
        text = json.dumps({**self._about, "end": _shown(ended)}, indent=2, default=str)
        replace_file(self.out / ABOUT_FILE, f"{text}\n".encode("utf-8", "backslashreplace"))


def _shown(value: Any) -> Any:
    """JSON values of which every address is without its secrets: logs are given to others."""
    if isinstance(value, Mapping):
        return {name: _shown(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_shown(each) for each in value]
    if not isinstance(value, str):
        return value
    return shown_address(value) if _WHOLE_ADDRESS.match(value) else without_secrets(value)


def _film_frame(step: Step, seen_panels: Sequence[SeenPanel]) -> FilmFrame:
    status, seen = step.status, step.observation
    attitude = status.quaternion
    if attitude is None and not np.isnan(status.yaw):
        attitude = quaternion_from_yaw(status.yaw)
    return FilmFrame(
        _NO_IMAGE, seen.instruction, step.guidance, step.sent, step.time, step.stage, step.instruction,
        status.position, attitude, tuple(seen_panels),
    )  # fmt: skip


def check_free(out: Path) -> None:
    """Raise `RunError` if a folder already contains a flight, or is a file."""
    if out.exists() and not out.is_dir():
        raise RunError(f"{out} is a file; give a folder with --out")
    if (out / ABOUT_FILE).exists():
        raise RunError(f"{out} already contains a flight; give another folder with --out")


def _make(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"cannot write the log to {out}: {error.strerror}; give another folder with --out") from None


def _row(step: Step) -> dict[str, Any]:
    status, seen, guidance = step.status, step.observation, step.guidance
    position = [None] * 3 if status.position is None else status.position.tolist()
    numbers = (
        step.time, *position, None if np.isnan(status.yaw) else status.yaw, *seen.velocity.tolist(), seen.height,
        seen.yaw_rate, *step.sent.tolist(), guidance.age if guidance else None,
        guidance.confidence if guidance else None, status.frame_age_s, status.link_age_s, step.policy_s, status.battery,
    )  # fmt: skip
    return dict(zip(_NUMBERS, numbers, strict=True)) | {
        "segment": step.segment,
        "armed": status.armed,
        "instruction": step.instruction,
        "directive": guidance.directive if guidance else None,
        "mode": status.mode,
        "decision": status.decision,
        "reason": status.reason,
    }


class _Film:
    """A fragmented MP4, which is readable even if its end is missing."""

    def __init__(self, path: Path) -> None:
        options = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}
        create(path).close()
        self._container = av.open(str(path), "w", format="mp4", options=options)
        encoding = {"crf": "20", "preset": "veryfast", "tune": "zerolatency", "g": str(CONTROL_HZ), "threads": "1"}
        self._stream = self._container.add_stream("libx264", rate=CONTROL_HZ, options=encoding)
        self._stream.width = self._stream.height = IMAGE_SIZE
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = Fraction(1, _TICKS_PER_S)
        self._last = -1
        self._broken = False
        self._waiting: queue.Queue[tuple[int, Image] | None] = queue.Queue(_QUEUED)
        self._thread = threading.Thread(target=self._run, name="film", daemon=True)
        self._thread.start()

    def add(self, time_s: float, image: Image) -> bool:
        """Queue a frame (256, 256, 3); false if it was dropped."""
        at = max(round(time_s * _TICKS_PER_S), self._last + 1)
        try:
            self._waiting.put_nowait((at, image.copy()))
        except queue.Full:
            return False
        self._last = at
        return not self._broken

    def close(self) -> None:
        """Encode the pending frames."""
        self._waiting.put(None)
        self._thread.join()
        with suppress(av.error.FFmpegError, OSError):
            self._container.close()

    def _run(self) -> None:
        while (item := self._waiting.get()) is not None:
            self._encode(item)
        self._encode(None)

    def _encode(self, item: tuple[int, Image] | None) -> None:
        """Write a frame, or flush the encoder; a full disk ends the film, not the flight."""
        if self._broken:
            return
        frame = None
        if item is not None:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(item[1]), format="rgb24")
            frame.pts, frame.time_base = item[0], Fraction(1, _TICKS_PER_S)
        try:
            self._container.mux(self._stream.encode(frame))
        except (av.error.FFmpegError, OSError):
            self._broken = True


_HEADLINES: dict[EndKind, str] = {
    "passed": "Passed", "flown": "Flown: you judge", "missed": "Failed", "unsure": "Unsure: it hovered",
    "ordered": "Landed by order", "time": "Out of time", "vehicle": "Ended by the vehicle",
    "interrupted": "Interrupted",
}  # fmt: skip


def verdict_of_flight(summary: Summary) -> Verdict:
    """How a flight ended, in a few words."""
    kind, reason = summary.ending.kind, summary.ending.reason
    rating: Literal["good", "bad", "open"] = "open"
    if kind in ("passed", "missed", "unsure", "vehicle"):
        rating = "good" if kind == "passed" else "bad"
    lines = tuple(filter(None, (reason, f"{summary.seconds:.1f} s flown")))
    return Verdict(rating, _HEADLINES[kind], lines)


def film_flight(plan: FlyPlan, log: FlightLog, scenes: Sequence[Scene], summary: Summary, console: Console) -> None:
    """Write flight.mp4 and flight.html beside the log. A failure is reported, and the flight counts without them."""
    pilot = plan.pilot.shown
    film = Film(
        f"{pilot.policy} + {pilot.reasoner} on {plan.vehicle.link}"
        + (f": {plan.instruction}" if is_mission(sub_goals(plan.instruction)) else ""),
        iter(counted(log.frames(), "filming", summary.steps, show=stderr_console(stderr=True).is_terminal)),
        scenes,
        verdict_of_flight(summary),
        [event for event in log.events if event.kind not in SILENT],
    )
    try:
        write_flight(log.out, film, find_airframe(plan.scenario.airframe))
    except (CognitiveDroneError, av.error.FFmpegError) as error:
        say(console, f"no film: {error}")
    except KeyboardInterrupt:
        say(console, "no film: stopped")
