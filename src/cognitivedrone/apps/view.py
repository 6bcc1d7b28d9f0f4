"""The live view of a flight in the terminal: current state and last events.

`Instruments` collects the state and renders itself, for rich's `Live`; without a terminal, `Printer` writes one line
per event.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Callable, Sequence
from typing import get_args

from rich.console import Console, Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from cognitivedrone.apps.values import Step, Summary
from cognitivedrone.choices import AnswerKind, DecisionKind, EventKind, ReasonerFault
from cognitivedrone.control.async_reasoner import ANSWER_S
from cognitivedrone.control.loop import LATE_S
from cognitivedrone.film.movie import FILM_FILE, PAGE_FILE
from cognitivedrone.text.printable import visible
from cognitivedrone.types import Event, FloatArray

EVENTS_SHOWN = 6
WINDOW = 50
"""Number of control steps over which rates and latencies are averaged."""
GOOD_FRAME_S, GOOD_LINK_S = 0.5, 0.15
"""Older data are shown in yellow; the safety rules hold the drone at the same ages."""
SILENT: frozenset[EventKind] = frozenset({"asked", "agreed", "late"})
"""Kinds of events that are logged and counted but not shown."""
_ANSWERS = frozenset((*get_args(AnswerKind), *get_args(ReasonerFault)))
"""Kinds of events that are the reasoner's answers, twice a second."""
_STYLES: dict[DecisionKind, str] = {
    "fly": "green",
    "hold": "yellow",
    "brake": "bold yellow",
    "land": "bold red",
    "hands_off": "bold red",
}


class Instruments:
    """The current state of a flight. Written by the control loop, rendered by rich's thread."""

    def __init__(self, title: str, typed: Callable[[], str] = lambda: "") -> None:
        self.title = title
        self._typed = typed
        self._step: Step | None = None
        self._times: deque[float] = deque(maxlen=WINDOW)
        self._policy_s: deque[float] = deque(maxlen=WINDOW)
        self._reasoner_s: float | None = None
        self._late = 0
        self._unaided = ""
        """That the reasoner is too late to be of use; empty otherwise."""
        self._hold = ""
        """Why it hovers; empty otherwise."""
        self._events: deque[Event] = deque(maxlen=EVENTS_SHOWN)

    def step(self, step: Step) -> None:
        """Show a control step."""
        self._step = step
        self._times.append(step.time)
        if step.policy_s is not None:
            self._policy_s.append(step.policy_s)

    def event(self, event: Event) -> None:
        """Show an event."""
        if event.kind in ("adopted", "agreed", "kept"):
            self._reasoner_s = event.age_s
            if event.age_s is not None and event.age_s <= ANSWER_S:
                self._unaided = ""
        if event.kind == "unaided":
            self._unaided = event.text
        if event.kind in ("hold", "sure", "segment"):
            self._hold = event.text if event.kind == "hold" else ""
        self._late += event.kind == "late"
        if event.kind not in SILENT:
            self._events.append(event)

    def __rich__(self) -> Panel:
        lines = Table.grid(padding=(0, 2))
        lines.add_column(style="dim", justify="right")
        lines.add_column(overflow="fold")
        step = self._step
        if step is None:
            lines.add_row("", "waiting for the first command")
        else:
            self._fill(lines, step)
        events = [Text(visible(event_line(event)), overflow="ellipsis", no_wrap=True) for event in list(self._events)]
        prompt = Text.assemble(("> ", "bold"), visible(self._typed()), ("_", "blink"))
        hint = "type a new instruction or land; ctrl-C lands"
        return Panel(Group(lines, Text(), *events, Text(), prompt), title=Text(visible(self.title)), subtitle=hint)

    def _fill(self, lines: Table, step: Step) -> None:
        status, seen, guidance = step.status, step.observation, step.guidance
        lines.add_row("time", f"{step.time:.1f} s, {_rate(list(self._times))} Hz, {self._late} late")
        lines.add_row("instruction", _literal(step.instruction))
        if guidance is not None:
            text = f"{guidance.directive} ({guidance.confidence:.0%} sure, frame {guidance.age:.1f} s old)"
            lines.add_row("directive", _literal(text))
        if self._unaided:
            lines.add_row("reasoner", Text(visible(self._unaided), style="bold yellow"))
        if self._hold:
            lines.add_row("pilot", Text(visible(self._hold), style="bold yellow"))
        lines.add_row("action", f"{_velocity(step.sent[:3])} m/s, turn {step.sent[3]:+.2f} rad/s")
        lines.add_row("velocity", f"{_velocity(seen.velocity)} m/s, turn {seen.yaw_rate:+.2f} rad/s")
        where = "not known" if status.position is None else "{:+.2f} {:+.2f} {:+.2f} m".format(*status.position)
        heading = "" if math.isnan(status.yaw) else f", heading {math.degrees(status.yaw):+.0f} deg"
        lines.add_row("position", f"{where}{heading}, height {seen.height:.2f} m")
        battery = "not reported" if status.battery is None else f"{status.battery:.0%}"
        armed = "armed" if status.armed else "not armed"
        lines.add_row("vehicle", _literal(f"{status.mode}, {armed}, battery {battery}"))
        lines.add_row("frame age", _age(status.frame_age_s, GOOD_FRAME_S))
        lines.add_row("link age", _age(status.link_age_s, GOOD_LINK_S))
        thinking = _milliseconds(statistics.median(self._policy_s)) if self._policy_s else "-"
        answering = "-" if self._reasoner_s is None else _milliseconds(self._reasoner_s)
        lines.add_row("latency", f"policy {thinking}, reasoner {answering}")
        decision = Text(status.decision, style=_STYLES.get(status.decision, ""))
        lines.add_row("guard", decision.append(visible(f": {status.reason}") if status.reason else ""))


class Printer:
    """Writes events line by line, where there is no terminal to draw on; an answer like the last one is left out."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._answer: tuple[str, str] = ("", "")

    def step(self, step: Step) -> None:
        """Do nothing: ten lines a second are of no use."""

    def event(self, event: Event) -> None:
        """Write a line."""
        if event.kind in SILENT:
            return
        if event.kind in _ANSWERS or event.kind in ("segment", "corrected"):
            before, self._answer = self._answer, (event.kind, event.text)
            if event.kind in _ANSWERS and before == self._answer:
                return
        say(self._console, visible(event_line(event)))


def say(console: Console, text: str) -> None:
    """Print lines: broken between words by a terminal's width, and not at all in a file."""
    console.print(text, markup=False, highlight=False, soft_wrap=not console.is_terminal)


def summary_table(summary: Summary) -> Table:
    """The table shown after the flight."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", justify="right")
    table.add_column(overflow="fold")
    kind, reason = summary.ending.kind, summary.ending.reason
    table.add_row("ended", _literal(reason if kind == "flown" else f"{kind}: {reason}"))
    late = f"{summary.late} of them more than {LATE_S * 1000:.0f} ms late"
    table.add_row("flown", f"{summary.seconds:.1f} s, {summary.steps} commands, {late}")
    for who, (median, p95) in (("policy", summary.policy_ms), ("reasoner", summary.reasoner_ms)):
        if not math.isnan(median):
            table.add_row(who, f"{median:.0f} ms (median), {p95:.0f} ms (95 %)")
    table.add_row("log", _literal(str(summary.out)))
    for name, file in (("film", FILM_FILE), ("page", PAGE_FILE)):
        if (made := summary.out / file).is_file():
            table.add_row(name, _literal(str(made)))
    return table


def event_line(event: Event) -> str:
    """An event in one line."""
    age = "" if event.age_s is None else f" ({_milliseconds(event.age_s)})"
    return f"{event.time:6.1f} s  {event.kind:<9} {event.text}{age}"


def _rate(times: Sequence[float]) -> str:
    """Rate of steps at these times."""
    if len(times) < 2 or times[-1] <= times[0]:
        return "-"
    return f"{(len(times) - 1) / (times[-1] - times[0]):.1f}"


def _velocity(vector: FloatArray) -> str:
    """A velocity (3,) in the heading frame, m/s, as text."""
    x, y, z = vector
    return f"forward {x:+.2f}, left {y:+.2f}, up {z:+.2f}"


def _literal(text: str) -> Text:
    """Text from people, models and vehicles, shown literally: no markup, no control characters."""
    return Text(visible(text))


def _age(seconds: float, good: float) -> Text:
    return Text(_milliseconds(seconds), style="" if seconds <= good else "yellow")


def _milliseconds(seconds: float) -> str:
    return f"{seconds * 1000:.0f} ms"
