"""The command `fly`: one flight with vehicle, pilot, keyboard, view and log, from checklist to landing."""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TextIO

import numpy as np
from rich.console import Console
from rich.live import Live

from cognitivedrone import terminal
from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.ending import ending_of, flown_by_estimate, out_of_time
from cognitivedrone.apps.log import FlightLog, check_free
from cognitivedrone.apps.orders import Keyboard, Orders, ending_on_signals, landing_on_interrupt
from cognitivedrone.apps.scene import ChosenScene, choose_scene
from cognitivedrone.apps.values import Ending, Instrument, Step, Summary
from cognitivedrone.apps.view import Instruments, Printer
from cognitivedrone.apps.watchdog import HUNG, Watchdog
from cognitivedrone.control.async_reasoner import ThreadedReasoner
from cognitivedrone.control.hold import HeldDrone, Hold, HoldAwareReasoner, HoldRule
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.control.passage import Passage, WatchedDrone
from cognitivedrone.data.formats.bags import Ros
from cognitivedrone.envs.track_runner import TrackConfig, episode_rng
from cognitivedrone.errors import GroundTruthError
from cognitivedrone.labels import load_pack
from cognitivedrone.pilot import Pilot, open_pilot
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.types import CONTROL_HZ, Action, Event, Guidance, Observation
from cognitivedrone.vehicles import check_vehicle, open_vehicle
from cognitivedrone.vehicles.contract import ClockedDrone, Request, Vehicle
from cognitivedrone.vehicles.mavlink.client.preflight import Checklist

CONFIRMATION = "arm"
REDRAWN_HZ = 5
STOP_S, HOVER_M_S = 3.0, 0.2
"""After the last gate it has so long to stop; slower than this is a hover."""


def fly_mission(plan: FlyPlan, *, console: Console | None = None, keyboard: TextIO | None = None) -> Summary:
    """Fly according to the plan, and land; everything is recorded in `plan.out`.

    `keyboard` supplies the confirmation and instructions, standard input by default. Raises one of the package's errors
    if it cannot fly; a drone in the air is landed first.
    """
    console, keyboard = console or terminal.console(), keyboard or sys.stdin
    out = plan.out or Path("flights") / datetime.now().strftime("%Y-%m-%d-%H%M%S")
    orders = Orders()
    with ExitStack() as stack:
        stack.enter_context(ending_on_signals())
        watchdog = stack.enter_context(Watchdog())
        pilot = stack.enter_context(open_pilot(plan.pilot))
        ros = Ros() if plan.record == "mcap" else None
        check_free(out)
        scene = None if plan.vehicle.kind == "mavlink" else choose_scene(plan)
        log, summary, error = None, None, ""
        try:
            with closing(_open(plan, out)) as vehicle:
                if scene is not None:
                    vehicle.begin(scene.track, episode_rng(scene.suite.digest, scene.episode, plan.scenario.seed))
                    console.print(scene.told, markup=False, highlight=False, soft_wrap=True)
                log = FlightLog(out, _about(plan, scene), ros)
                with watchdog.over(vehicle, partial(log.close, None)):
                    summary = _fly(plan, vehicle, pilot, log, orders, console, keyboard)
        except BaseException as stop:
            error = str(stop) or type(stop).__name__
            raise
        finally:
            if log is not None:
                log.close(summary, error)
            watchdog.leaving(HUNG if summary is None else summary.exit_code)
    return summary


def _open(plan: FlyPlan, out: Path) -> Vehicle:
    """The vehicle of a plan; its scene has no time limit, since a person ends the flight."""
    scenario = plan.scenario
    check_vehicle(plan.vehicle, scenario)
    return open_vehicle(
        Request(
            plan.vehicle,
            load_pack(scenario.labels),
            find_airframe(scenario.airframe),
            TrackConfig.of(scenario, time_limit_s=math.inf),
            pace="wall",
            safety=plan.safety,
            folder=out,
        )
    )


def _fly(
    plan: FlyPlan,
    vehicle: Vehicle,
    pilot: Pilot,
    log: FlightLog,
    orders: Orders,
    console: Console,
    keyboard: TextIO,
) -> Summary:
    """Take off, fly and land."""
    _check_truth(vehicle, pilot)
    if plan.vehicle.kind != "sim":
        console.print("connected; waiting until the vehicle is ready (ctrl-C stops)", highlight=False)
    drone = vehicle.take_off(lambda checklist: _confirm(checklist, vehicle, console, keyboard))
    hold = Hold(HoldRule(below=plan.hold_below))
    passage = Passage() if vehicle.track_runner is None else None
    mission = _Mission(plan, vehicle, orders, drone.now, hold, passage)
    timed = TimedPolicy(pilot.policy)
    with ExitStack() as stack:
        stack.enter_context(landing_on_interrupt(orders))
        keys = stack.enter_context(Keyboard(keyboard, orders.say))
        shown: Instruments | Printer = Printer(console)
        if plan.view and console.is_terminal:
            shown = Instruments(
                f"{plan.pilot.policy} + {plan.pilot.reasoner} on {plan.vehicle.link}", lambda: keys.typed
            )
            stack.enter_context(Live(shown, console=console, refresh_per_second=REDRAWN_HZ))
        recorder = _Recorder((log, shown), mission, vehicle, timed, hold)
        async_reasoner = (
            HoldAwareReasoner(ThreadedReasoner(pilot.reasoner), hold) if pilot.reasoner is not None else None
        )
        try:
            flown = HeldDrone(drone if passage is None else WatchedDrone(drone, passage), hold)
            steps = fly(flown, timed, drone, mission, reasoner=async_reasoner, recorder=recorder, real_time=True)
            ending, seconds = mission.ending or Ending("told", ""), drone.now()
            if ending.kind in ("passed", "flown") and plan.vehicle.kind != "sim":
                _stop(drone)
            recorder.note(Event(seconds, "over", ending.reason))
            if vehicle.land():
                recorder.note(Event(drone.now(), "landed"))
        finally:
            if async_reasoner is not None:
                async_reasoner.close()
    return Summary(
        ending, steps, seconds, recorder.late, _spread_ms(timed.took_s), _spread_ms(recorder.answers_s), log.out
    )


def _stop(drone: ClockedDrone) -> None:
    """Hover: command no velocity until there is none left, or the time for it is over."""
    deadline = drone.now() + STOP_S
    while drone.now() < deadline and np.linalg.norm(drone.observe().velocity) > HOVER_M_S:
        drone.send(np.zeros(4, dtype=np.float32))
        drone.sleep_until(drone.now() + 1 / CONTROL_HZ)


class _Mission:
    """The current segment: the latest typed instruction, else the command's, else the scene's."""

    def __init__(
        self,
        plan: FlyPlan,
        vehicle: Vehicle,
        orders: Orders,
        now: Callable[[], float],
        hold: Hold,
        passage: Passage | None,
    ) -> None:
        self.segment: Segment | None = None
        self.ending: Ending | None = None
        self._plan, self._vehicle, self._orders, self._now, self._hold = plan, vehicle, orders, now, hold
        self._passage = passage

    def __call__(self) -> Segment | None:
        count, typed = self._orders.given
        instruction = typed or self._plan.instruction
        gates = self._passage.gates if self._passage is not None else 0
        self.ending = (
            self._orders.ending
            or ending_of(self._vehicle, instruction.strip())
            or flown_by_estimate(gates, self._plan.gates)
        )
        if self.ending is None and self._now() >= self._plan.time_limit:
            self.ending = out_of_time(self._vehicle, self._plan.time_limit)
            if self._hold.active:
                self.ending = Ending("unsure", f"{self.ending.reason}; it hovered, only {_doubt(self._hold)}")
        if self.ending is not None:
            return None
        track = self._vehicle.track_runner
        index, truth = (track.index, track.truth()) if track is not None else (gates, None)
        of_scene = truth.task.instruction if truth is not None else ""
        self._hold.begin(index + count)
        self.segment = Segment(index + count, instruction or of_scene, truth)
        return self.segment


class _Recorder:
    """Combines the loop's reports with the vehicle's status, and passes them to the instruments."""

    def __init__(
        self, instruments: Sequence[Instrument], mission: _Mission, vehicle: Vehicle, timed: TimedPolicy, hold: Hold
    ) -> None:
        self.late = 0
        self.answers_s: list[float] = []
        self._instruments, self._mission, self._vehicle, self._timed = instruments, mission, vehicle, timed
        self._decisions = 0
        self._decision = "fly"
        self._hold, self._held = hold, False

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        segment, status = self._mission.segment, self._vehicle.status()
        if segment is None:
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
        step = Step(
            observation.time, segment.index, segment.instruction, observation, action, guidance, thought, status
        )
        for instrument in self._instruments:
            instrument.step(step)

    def note(self, event: Event) -> None:
        self.late += event.kind == "late"
        track = self._vehicle.track_runner
        if event.kind in ("declined", "resumed") and track is not None:
            track.decline(event.kind == "declined")
        if event.kind in ("adopted", "agreed", "kept") and event.age_s is not None:
            self.answers_s.append(event.age_s)
        for instrument in self._instruments:
            instrument.event(event)


def _check_truth(vehicle: Vehicle, pilot: Pilot) -> None:
    for kind, part in (("policy", pilot.policy), ("reasoner", pilot.reasoner)):
        if vehicle.track_runner is None and part is not None and part.needs_ground_truth:
            raise GroundTruthError(f"this {kind} uses privileged state, which a vehicle over MAVLink does not have")


def _confirm(checklist: Checklist, vehicle: Vehicle, console: Console, keyboard: TextIO) -> bool:
    """Show the checklist; for what may be a real drone, a person must confirm it."""
    console.print(str(checklist), markup=False, highlight=False, soft_wrap=True)
    if vehicle.simulated:
        return True
    console.print(f"type {CONFIRMATION!r} to arm and take off, anything else to stop: ", end="", highlight=False)
    return keyboard.readline().strip() == CONFIRMATION


def _doubt(hold: Hold) -> str:
    """The pilot's certainty, as text."""
    return f"{hold.sure:.0%} sure that the scene shows what is asked for"


def _about(plan: FlyPlan, scene: ChosenScene | None) -> dict[str, object]:
    """The log's description of how the flight was made."""
    about: dict[str, object] = {"config": plan.values()}
    if scene is not None:
        about["scene"] = {"suite": scene.suite.name, "episode": scene.episode, "told": scene.told}
    return about | {"began": datetime.now().isoformat()}


def _spread_ms(samples_s: Sequence[float]) -> tuple[float, float]:
    """Median and 95th percentile, ms."""
    if not samples_s:
        return (float("nan"), float("nan"))
    return statistics.median(samples_s) * 1e3, float(np.percentile(samples_s, 95)) * 1e3
