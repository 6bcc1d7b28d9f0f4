"""One flight by one command: link, pilot, keyboard, view and log, from the checklist to the ground."""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from datetime import datetime
from pathlib import Path
from typing import TextIO, TypeVar

import numpy as np
from rich.console import Console
from rich.live import Live

from cognitivedrone import terminal
from cognitivedrone.apps.config import FlyConfig
from cognitivedrone.apps.craft import Craft
from cognitivedrone.apps.log import TLOG_FILE, FlightLog, check_free
from cognitivedrone.apps.opening import open_craft
from cognitivedrone.apps.orders import Keyboard, Orders, landing_on_interrupt
from cognitivedrone.apps.scene import ChosenScene, choose_scene
from cognitivedrone.apps.values import Ending, Instrument, Step, Summary
from cognitivedrone.apps.view import Instruments, Printer
from cognitivedrone.control.async_reasoner import ThreadedReasoner
from cognitivedrone.control.hold import HeldDrone, Hold, HoldAwareReasoner, HoldRule
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.data.formats.bags import Ros
from cognitivedrone.errors import GroundTruthError
from cognitivedrone.interfaces import Checked, Policy, Privileged, Reasoner
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.types import Action, Event, Guidance, Observation
from cognitivedrone.vehicles.mavlink.client.preflight import Checklist

CONFIRMATION = "arm"
REDRAWN_HZ = 5
Part = TypeVar("Part")


def fly_mission(config: FlyConfig, *, console: Console | None = None, keyboard: TextIO | None = None) -> Summary:
    """Fly as the options say, and land; everything is recorded in `config.out`.

    `keyboard` is where confirmation and instructions are typed, standard input by default. Raises what cannot be
    flown as one of the package's errors; a drone that is in the air then is landed first.
    """
    console, keyboard = console or terminal.console(), keyboard or sys.stdin
    out = config.out or Path("flights") / datetime.now().strftime("%Y-%m-%d-%H%M%S")
    orders = Orders()
    with ExitStack() as stack:
        policy = _ready(stack, make_policy(config.policy))
        reasoner = _ready(stack, make_reasoner(config.reasoner))
        ros = Ros() if config.record == "mcap" else None
        check_free(out)
        scene = None if config.is_mavlink else choose_scene(config)
        log, summary, error = None, None, ""
        try:
            craft = open_craft(config, out / TLOG_FILE, scene, lambda: orders.given[1] or config.instruction.strip())
            with closing(craft):
                if scene is not None:
                    console.print(scene.told, markup=False, highlight=False, soft_wrap=True)
                log = FlightLog(out, _about(config, scene), ros)
                summary = _fly(config, craft, policy, reasoner, log, orders, console, keyboard)
        except BaseException as stop:
            error = str(stop) or type(stop).__name__
            raise
        finally:
            if log is not None:
                log.close(summary, error)
    return summary


def _fly(
    config: FlyConfig,
    craft: Craft,
    policy: Policy,
    reasoner: Reasoner | None,
    log: FlightLog,
    orders: Orders,
    console: Console,
    keyboard: TextIO,
) -> Summary:
    """From the ground to the ground."""
    _check_truth(craft, policy, reasoner)
    if config.link != "sim":
        console.print("connected; waiting until the vehicle is ready, ctrl-C stops", highlight=False)
    drone = craft.take_off(lambda checklist: _confirm(checklist, craft, console, keyboard))
    hold = Hold(HoldRule(below=config.hold_below))
    mission = _Mission(config, craft, orders, drone.now, hold)
    timed = TimedPolicy(policy)
    with ExitStack() as stack:
        stack.enter_context(landing_on_interrupt(orders))
        keys = stack.enter_context(Keyboard(keyboard, orders.say))
        shown: Instruments | Printer = Printer(console)
        if config.view and console.is_terminal:
            shown = Instruments(f"{config.policy} + {config.reasoner} on {config.link}", lambda: keys.typed)
            stack.enter_context(Live(shown, console=console, refresh_per_second=REDRAWN_HZ))
        recorder = _Recorder((log, shown), mission, craft, timed, hold)
        mind = HoldAwareReasoner(ThreadedReasoner(reasoner), hold) if reasoner is not None else None
        try:
            steps = fly(HeldDrone(drone, hold), timed, drone, mission, mind=mind, recorder=recorder)
            ending, seconds = mission.ending or Ending("told", ""), drone.now()
            recorder.note(Event(seconds, "over", ending.reason))
            if craft.land():
                recorder.note(Event(drone.now(), "landed"))
        finally:
            if mind is not None:
                mind.close()
    return Summary(
        ending, steps, seconds, recorder.late, _spread_ms(timed.took_s), _spread_ms(recorder.answers_s), log.out
    )


class _Mission:
    """The leg at hand: the newest of what was typed, asked for at the start, or written in the scene."""

    def __init__(self, config: FlyConfig, craft: Craft, orders: Orders, now: Callable[[], float], hold: Hold) -> None:
        self.leg: Segment | None = None
        self.ending: Ending | None = None
        self._config, self._craft, self._orders, self._now, self._hold = config, craft, orders, now, hold

    def __call__(self) -> Segment | None:
        self.ending = self._orders.ending or self._craft.ending()
        if self.ending is None and self._now() >= self._config.time_limit:
            self.ending = self._craft.out_of_time(self._config.time_limit)
            if self._hold.active:
                self.ending = Ending("unsure", f"{self.ending.reason}; it hovered, only {_doubt(self._hold)}")
        if self.ending is not None:
            return None
        scene = self._craft.scene()
        count, typed = self._orders.given
        index, truth = (scene.index, scene.truth) if scene is not None else (0, None)
        of_scene = truth.task.instruction if truth is not None else ""
        self._hold.begin(index + count)
        self.leg = Segment(index + count, typed or self._config.instruction or of_scene, truth)
        return self.leg


class _Recorder:
    """Puts what the loop tells together with how the craft is, and gives it to the instruments."""

    def __init__(
        self, instruments: Sequence[Instrument], mission: _Mission, craft: Craft, timed: TimedPolicy, hold: Hold
    ) -> None:
        self.late = 0
        self.answers_s: list[float] = []
        self._instruments, self._mission, self._craft, self._timed = instruments, mission, craft, timed
        self._decisions = 0
        self._decision = "fly"
        self._hold, self._held = hold, False

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        leg, status = self._mission.leg, self._craft.status()
        if leg is None:
            return
        if status.decision != self._decision:
            self._decision = status.decision
            self.note(Event(observation.time, "guard", f"{status.decision}: {status.reason}".rstrip(": ")))
        if self._hold.active != self._held:
            self._held = self._hold.active
            told = f"{'hovering' if self._held else 'flying on'}, {_doubt(self._hold)}"
            self.note(Event(observation.time, "hold" if self._held else "sure", told))
        thought = self._timed.took_s[-1] if len(self._timed.took_s) > self._decisions else None
        self._decisions = len(self._timed.took_s)
        step = Step(observation.time, leg.index, leg.instruction, observation, action, guidance, thought, status)
        for instrument in self._instruments:
            instrument.step(step)

    def note(self, event: Event) -> None:
        self.late += event.kind == "late"
        if event.kind in ("adopted", "agreed", "kept") and event.age_s is not None:
            self.answers_s.append(event.age_s)
        for instrument in self._instruments:
            instrument.event(event)


def _ready(stack: ExitStack, part: Part) -> Part:
    """A policy or reasoner that could fly now, closed at the end if it can be."""
    close = getattr(part, "close", None)
    if callable(close):
        stack.callback(close)
    if isinstance(part, Checked):
        part.check()
    return part


def _check_truth(craft: Craft, policy: Policy, reasoner: Reasoner | None) -> None:
    for kind, part in (("policy", policy), ("reasoner", reasoner)):
        if craft.scene() is None and isinstance(part, Privileged):
            raise GroundTruthError(
                f"this {kind} must be told the truth about the scene, which only --link sim and sitl know"
            )


def _confirm(checklist: Checklist, craft: Craft, console: Console, keyboard: TextIO) -> bool:
    """Show the checklist; of what may be a real drone, a person must say yes to it."""
    console.print(str(checklist), markup=False, highlight=False, soft_wrap=True)
    if craft.simulated:
        return True
    console.print(f"type {CONFIRMATION!r} to arm and take off, anything else to stop: ", end="", highlight=False)
    return keyboard.readline().strip() == CONFIRMATION


def _doubt(hold: Hold) -> str:
    """How sure the pilot is, in words."""
    return f"{hold.sure:.0%} sure that what is asked is here"


def _about(config: FlyConfig, scene: ChosenScene | None) -> dict[str, object]:
    """What the log says of how it was flown."""
    about: dict[str, object] = {"config": {name: getattr(config, name) for name in config.__slots__}}
    if scene is not None:
        about["scene"] = {"suite": scene.suite.name, "episode": scene.episode, "told": scene.told}
    return about | {"began": datetime.now().isoformat()}


def _spread_ms(samples_s: Sequence[float]) -> tuple[float, float]:
    """Median and 95th percentile of some times, ms."""
    if not samples_s:
        return (float("nan"), float("nan"))
    return statistics.median(samples_s) * 1e3, float(np.percentile(samples_s, 95)) * 1e3
