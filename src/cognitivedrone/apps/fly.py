"""The command `fly`: one flight with vehicle, pilot, keyboard, view and log, from checklist to landing."""

from __future__ import annotations

import functools
import math
import statistics
import sys
from collections.abc import Callable, Collection, Sequence
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
from cognitivedrone.apps.log import FlightLog, check_free, film_flight
from cognitivedrone.apps.mission import UNKEPT, Mission, Recorder, kept_by_none
from cognitivedrone.apps.orders import Keyboard, Orders, ending_on_signals, landing_on_interrupt, readable
from cognitivedrone.apps.understanding.evidence import Evidence, taught_names
from cognitivedrone.apps.understanding.request import Understanding
from cognitivedrone.apps.understanding.scene import (
    ChosenScene,
    check_evidence,
    choose_scene,
    own_names,
    plain_instruction,
)
from cognitivedrone.apps.values import Ending, Page, SteeredDrone, Summary
from cognitivedrone.apps.view import Instruments, Printer, say
from cognitivedrone.apps.watchdog import HUNG, Watchdog
from cognitivedrone.control.async_reasoner import AsyncReasoner, SimulatedReasoner, ThreadedReasoner
from cognitivedrone.control.closer_look import CloserLook
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import fly
from cognitivedrone.control.passage import Passage, WatchedDrone
from cognitivedrone.control.planning import Plans, plans_with
from cognitivedrone.data.formats.mcap import Ros
from cognitivedrone.envs.track_runner import TrackConfig, episode_rng
from cognitivedrone.errors import GroundTruthError, NotUnderstood, ReasonerError
from cognitivedrone.film.frame import Scene, scenes_of
from cognitivedrone.interfaces import Drone
from cognitivedrone.labels import load_pack
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.pilot import Pilot, open_pilot
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.tasks.missions import is_mission, lands, parts_of, read, sub_goals, told
from cognitivedrone.types import CONTROL_HZ, Event, SubGoal
from cognitivedrone.vehicles import check_vehicle, open_vehicle
from cognitivedrone.vehicles.checklist import Checklist
from cognitivedrone.vehicles.contract import ClockedDrone, Pace, Request, Vehicle

CONFIRMATION = "arm"
REDRAWN_HZ = 5
STOP_S, HOVER_M_S = 3.0, 0.2
"""After the last gate it has so long to stop; slower than this is a hover."""
NO_PADS = "pads are landed on with --link sim only; say 'then land', and it lands where it is"


def fly_mission(
    plan: FlyPlan,
    *,
    console: Console | None = None,
    keyboard: TextIO | None = None,
    orders: Orders | None = None,
    pace: Pace = "wall",
    page: Page | None = None,
    pilot: Pilot | None = None,
    scene: ChosenScene | None = None,
) -> Summary:
    """Fly according to the plan, and land; everything is recorded in `plan.out`.

    `keyboard` supplies the confirmation and instructions, standard input by default; they come to the pilot through
    `orders`. With the pace `lockstep`, in simulation, time stands still while the pilot thinks: the flight is the same
    on every machine. A `page` shows the flight and may steer it. A `pilot` that is given stays open, and a `scene` that
    is given is flown instead of one chosen for the instruction. Raises one of the package's errors if it cannot fly
    (before anything else `RunError` if the keyboard cannot be read); a drone in the air is landed first.
    """
    console, keyboard = console or terminal.console(), readable(keyboard or sys.stdin)
    out = plan.out or Path("flights") / datetime.now().strftime("%Y-%m-%d-%H%M%S")
    check_free(out)
    orders, scenes = orders or Orders(), tuple[Scene, ...]()
    with ExitStack() as stack:
        stack.enter_context(ending_on_signals())
        watchdog = stack.enter_context(Watchdog())
        pilot = pilot or stack.enter_context(open_pilot(plan.pilot))
        ros = Ros() if plan.record == "mcap" else None
        understanding = Understanding(own_names(plan.scenario.labels), _words_of(pilot), _taught(pilot))
        evidence = Evidence.of(understanding, pilot)
        if scene is None:
            plan, scene = _scene(plan, evidence, console, keyboard)
        else:
            check_evidence(evidence, scene, plan.instruction.strip())
        plans = _planned(plan, pilot, scene)
        log, summary, error = None, None, ""
        try:
            with closing(_open(plan, out, pace, down=pilot.policy.needs_down_camera)) as vehicle:
                if scene is not None:
                    vehicle.begin(scene.track, episode_rng(scene.suite.digest, scene.episode, plan.scenario.seed))
                    say(console, scene.summary)
                mission = plan.instruction.strip() or (scene and scene.track[0].mission) or ""
                if is_mission(goals := plans(mission)):
                    steps = "; ".join(f"{number}. {told(goal)}" for number, goal in enumerate(goals, 1))
                    say(console, f"understood as: {steps}")
                log = FlightLog(out, _about(plan, scene), ros, pilot.reasoner)
                with watchdog.over(vehicle, partial(log.close, None)):
                    plain = functools.cache(partial(plain_instruction, evidence, scene))
                    refused = functools.cache(evidence.refused)
                    summary = _fly(
                        plan, vehicle, pilot, log, orders, console, keyboard, plain, refused, pace, page, plans, goals
                    )
                if vehicle.track_runner is not None:
                    scenes = scenes_of(vehicle.track_runner)
        except BaseException as stop:
            error = str(stop) or type(stop).__name__
            raise
        finally:
            if log is not None:
                log.close(summary, error)
            watchdog.leaving(HUNG if summary is None else summary.exit_code)
    if plan.film:
        film_flight(plan, log, scenes, summary, console)
    return summary


def _words_of(pilot: Pilot) -> Collection[str]:
    """The words that a pilot knows: they are no typing errors."""
    model = getattr(pilot.policy, "model", None)
    return model.words if isinstance(model, SmallModel) else frozenset()


def _taught(pilot: Pilot) -> frozenset[str]:
    """The names that a pilot was taught besides the packaged ones."""
    found: set[str] = set()
    if isinstance(model := getattr(pilot.policy, "model", None), SmallModel):
        found.update(model.description.attributes)
    if isinstance(pilot.reasoner, SmallReasoner):
        found.update(pilot.reasoner.attributes.names)
    return taught_names(found)


def _scene(plan: FlyPlan, evidence: Evidence, console: Console, keyboard: TextIO) -> tuple[FlyPlan, ChosenScene | None]:
    """The scene, and the plan with its instruction: at a terminal, one that names nothing is asked for again."""
    while True:
        try:
            scene = None
            _check_mission(plan.instruction, pads=plan.vehicle.kind != "mavlink")
            if plan.vehicle.kind != "mavlink":
                scene = choose_scene(plan, evidence)
            check_evidence(evidence, scene, plan.instruction.strip())
            return plan, scene
        except NotUnderstood as error:
            if not keyboard.isatty():
                raise
            say(console, f"{error}\nsay it in other words; an empty line ends:")
            if not (typed := keyboard.readline().strip()):
                raise
            plan = plan.changed(instruction=typed)


def _check_mission(mission: str, *, pads: bool) -> None:
    """Raise `NotUnderstood` for a mission that was not understood whole, or lands on pads that there are not."""
    reading = read(mission)
    if reading.problem:
        raise NotUnderstood(f"the mission {reading.problem}")
    if not pads and any(lands(goal.instruction)[1] for goal in parts_of(reading.goals)):
        raise NotUnderstood(NO_PADS)


def _planned(plan: FlyPlan, pilot: Pilot, scene: ChosenScene | None) -> Plans:
    """The sub-goals of what is asked for before take-off: the reasoner's own, if it plans and this is a mission."""
    of_scene = None if scene is None else scene.track[0].mission
    mission = plan.instruction or of_scene or ""
    if plan.vehicle.kind != "sim" and scene is not None and any(task.landing for task in scene.track):
        raise NotUnderstood(NO_PADS)  # the floor of the vehicle's fence is above them
    _check_mission(mission, pads=True)
    if not mission or not (mission == of_scene or is_mission(sub_goals(mission))):
        return sub_goals
    if pilot.reasoner is None and any(map(kept_by_none, sub_goals(mission))):
        raise NotUnderstood(UNKEPT)
    try:
        return plans_with(pilot.reasoner, mission)
    except ReasonerError as error:
        raise NotUnderstood(f"the mission was not planned: {error}; say it in other words") from None


def _open(plan: FlyPlan, out: Path, pace: Pace, *, down: bool) -> Vehicle:
    """The vehicle of a plan; its scene has no time limit, since a person ends the flight."""
    scenario = plan.scenario
    check_vehicle(plan.vehicle, scenario)
    return open_vehicle(
        Request(
            plan.vehicle,
            load_pack(scenario.labels),
            find_airframe(scenario.airframe),
            TrackConfig.of(scenario, time_limit_s=math.inf),
            pace=pace,
            safety=plan.safety,
            folder=out,
            down=down,
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
    plain: Callable[[str], str | None],
    refused: Callable[[str], frozenset[str]],
    pace: Pace,
    page: Page | None,
    plans: Plans,
    goals: Sequence[SubGoal],
) -> Summary:
    """Take off, fly and land."""
    for kind, part in (("policy", pilot.policy), ("reasoner", pilot.reasoner)):
        if vehicle.track_runner is None and part is not None and part.needs_ground_truth:
            raise GroundTruthError(f"this {kind} uses privileged state, which a vehicle over MAVLink does not have")
    if plan.vehicle.kind != "sim":
        console.print("connected; waiting until the vehicle is ready (ctrl-C stops)", highlight=False)
    drone = vehicle.take_off(lambda checklist: _confirm(checklist, vehicle, console, keyboard))
    look = CloserLook.of(plan.pilot.look)
    passage = Passage() if vehicle.track_runner is None else None
    flown: Drone = drone if page is None else SteeredDrone(drone, page)
    if page is not None:
        page.begin(vehicle, pilot, goals if is_mission(goals) else ())
    if passage is not None:
        flown = WatchedDrone(flown, passage)
    mission = Mission(plan, vehicle, orders, drone.now, look, passage, plain, refused, plans)
    timed = TimedPolicy(pilot.policy)
    with ExitStack() as stack:
        stack.enter_context(landing_on_interrupt(orders, at_once=vehicle.track_runner is not None))
        keys = stack.enter_context(Keyboard(keyboard, orders.say))
        shown: Instruments | Printer = Printer(console)
        if plan.view and console.is_terminal:
            names = plan.pilot.shown
            shown = Instruments(f"{names.policy} + {names.reasoner} on {plan.vehicle.link}", lambda: keys.typed)
            stack.enter_context(Live(shown, console=console, refresh_per_second=REDRAWN_HZ))
        instruments = (log, shown) if page is None else (log, shown, page)
        recorder = Recorder(instruments, mission, vehicle, timed)
        async_reasoner: AsyncReasoner | None = None
        if pilot.reasoner is not None:
            asynchronous = ThreadedReasoner if pace == "wall" else SimulatedReasoner
            async_reasoner = asynchronous(pilot.reasoner)
        try:
            steps = fly(
                flown,
                timed,
                drone,
                mission,
                reasoner=async_reasoner,
                look=look,
                recorder=recorder,
                real_time=pace == "wall",
            )
            ending, seconds = mission.ending or Ending("ordered", ""), drone.now()
            if ending.kind in ("passed", "flown") and plan.vehicle.kind != "sim":
                _stop(drone)
            recorder.note(Event(seconds, "over", ending.reason))
            if vehicle.land():
                recorder.note(Event(drone.now(), "landed"))
        finally:
            if async_reasoner is not None:
                async_reasoner.close()
    track = vehicle.track_runner
    return Summary(
        ending, steps, seconds, recorder.late, _spread_ms(timed.took_s), _spread_ms(recorder.answers_s), log.out,
        track=track.track if track else (), results=tuple(track.results) if track else (),
    )  # fmt: skip


def _stop(drone: ClockedDrone) -> None:
    """Hover: command no velocity until there is none left, or the time for it is over."""
    deadline = drone.now() + STOP_S
    while drone.now() < deadline and np.linalg.norm(drone.observe().velocity) > HOVER_M_S:
        drone.send(np.zeros(4, dtype=np.float32))
        drone.sleep_until(drone.now() + 1 / CONTROL_HZ)


def _confirm(checklist: Checklist, vehicle: Vehicle, console: Console, keyboard: TextIO) -> bool:
    """Show the checklist; for what may be a real drone, a person must confirm it."""
    say(console, str(checklist))
    if vehicle.simulated:
        return True
    console.print(f"type {CONFIRMATION!r} to arm and take off, anything else to stop: ", end="", highlight=False)
    try:
        typed = keyboard.readline()
    except UnicodeDecodeError:  # bytes that are no text
        typed = ""
    if not typed.endswith("\n"):
        console.print()
    return typed.strip() == CONFIRMATION


def _about(plan: FlyPlan, scene: ChosenScene | None) -> dict[str, object]:
    """The log's description of how the flight was made."""
    about: dict[str, object] = {"config": plan.values()}
    if scene is not None:
        about["scene"] = {"suite": scene.suite.name, "episode": scene.episode, "summary": scene.summary}
    return about | {"began": datetime.now().isoformat()}


def _spread_ms(samples_s: Sequence[float]) -> tuple[float, float]:
    """Median and 95th percentile, ms."""
    if not samples_s:
        return (float("nan"), float("nan"))
    return statistics.median(samples_s) * 1e3, float(np.percentile(samples_s, 95)) * 1e3
