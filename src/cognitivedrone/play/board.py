"""What the page shows of a flight: the flight leaves its newest step here, and a thread of the page's own draws it.

The flight only ever replaces values; encoding, drawing and sending happen elsewhere, so that no browser delays it.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cognitivedrone.apps.values import Step
from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.film.frame import Scene, scenes_of
from cognitivedrone.frames import quaternion_from_yaw, rotate_yaw
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.pilot import Pilot
from cognitivedrone.play.chase import ChaseProcess, jpeg
from cognitivedrone.play.server import Channels
from cognitivedrone.policies.small import Small
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.sim.airframe import RACER, Airframe
from cognitivedrone.tasks.missions import longest, told
from cognitivedrone.types import CONTROL_HZ, Action, Event, FloatArray, Image, SeenPanel, SubGoal
from cognitivedrone.vehicles.contract import Vehicle
from cognitivedrone.world import geometry

DRAWN_HZ: Final = 20
CAMERA, CHASE = b"c", b"v"
"""First byte of a message with a JPEG."""
_STALE_S: Final = 0.5  # a stick that says nothing for so long is let go
_EVENTS: Final = 60
_LATENCY_STEPS: Final = 20
_END_S: Final = 5.0  # then the page's thread is left behind: it must not keep a command that was told to end


class Sticks:
    """A person's command, from the page, for as long as they have taken over."""

    def __init__(self) -> None:
        self.taken = False
        self._command: tuple[float, Action] = (0.0, np.zeros(4, np.float32))

    def move(self, command: Action) -> None:
        """Take over with a command (4,) as an action's."""
        self._command, self.taken = (time.monotonic(), np.asarray(command, np.float32)), True

    def steer(self, action: Action) -> Action:
        """The person's command, zero where it is not repeated; the pilot's if nobody has taken over."""
        if not self.taken:
            return action
        at, command = self._command
        return command if time.monotonic() - at < _STALE_S else np.zeros_like(action)


@dataclass(frozen=True, slots=True)
class _Shown:
    """A flight, or the drone that waits for one."""

    track: TrackRunner | None
    scenes: Sequence[Scene]
    reasoner: Reasoner | None
    policy: object
    goals: Sequence[SubGoal] = ()


class LiveBoard:
    """The page of a flight, as the flight sees it (`apps.values.Page`). Call `close` at the end."""

    def __init__(self, channels: Channels, airframe: Airframe = RACER) -> None:
        self.sticks = Sticks()
        self.events: deque[Event] = deque(maxlen=_EVENTS)
        self.hold = ""
        """Why the drone hovers; empty while it flies."""
        self.late = 0
        self._shown: _Shown | None = None
        self._steps: tuple[Step | None, Step | None] = (None, None)
        self._at = 0.0
        self._still: tuple[Image, FloatArray, FloatArray] | None = None
        self._stopping = threading.Event()
        self._painter = _Painter(self, channels, airframe)
        self._thread = threading.Thread(target=self._painter.run, args=(self._stopping,), name="page", daemon=True)
        self._thread.start()

    def begin(self, vehicle: Vehicle, pilot: Pilot, goals: Sequence[SubGoal]) -> None:
        """As `Page`."""
        self._restart(_Shown(vehicle.track_runner, (), pilot.reasoner, pilot.policy, goals))

    def wait_at(
        self, scene: Scene, image: Image, position: FloatArray, quaternion: FloatArray, pilot: Pilot | None
    ) -> None:
        """Show the drone at the start of a scene, before a flight."""
        self._restart(_Shown(None, (scene,), None if pilot is None else pilot.reasoner, pilot and pilot.policy))
        self._still = image, position, quaternion

    def _restart(self, shown: _Shown) -> None:
        self._still, self._steps = None, (None, None)
        self.events.clear()
        self.hold, self.late, self.sticks.taken = "", 0, False
        self._shown = shown

    def steer(self, action: Action) -> Action:
        """As `Page`."""
        return self.sticks.steer(action)

    def step(self, step: Step) -> None:
        """As `Instrument`."""
        self._at = time.monotonic()
        self._steps = self._steps[1], step

    def event(self, event: Event) -> None:
        """As `Instrument`."""
        if event.kind in ("hold", "sure", "segment"):
            self.hold = event.text if event.kind == "hold" else ""
        self.late += event.kind == "late"
        if event.kind not in ("late", "asked"):
            self.events.append(event)

    def close(self) -> None:
        """End the page's thread, which may be waiting for the process that draws, or for one that starts."""
        self._stopping.set()
        self._thread.join(_END_S)


class _Painter:
    """Draws and encodes, in a thread of its own, while anybody looks."""

    def __init__(self, board: LiveBoard, channels: Channels, airframe: Airframe) -> None:
        self._board, self._channels, self._airframe = board, channels, airframe
        self._chase: ChaseProcess | None = None
        self._placed: Scene | None = None
        self._track: tuple[int, int, tuple[Scene, ...]] = (0, 0, ())
        """The track shown, by identity, with the number of its stages so far, and its scenes."""
        self._step: Step | None = None
        self._still: object = None
        self._no_chase = False
        self._took: deque[float] = deque(maxlen=_LATENCY_STEPS)

    def run(self, stopping: threading.Event) -> None:
        """Draw until `stopping`."""
        try:
            next_at = time.monotonic()
            while not stopping.wait(max(0.001, next_at - time.monotonic())):
                next_at = max(next_at + 1 / DRAWN_HZ, time.monotonic())
                if self._channels.viewers:
                    self._draw()
        finally:
            if self._chase is not None:
                self._chase.close()

    def _draw(self) -> None:
        board = self._board
        shown, still, (before, step) = board._shown, board._still, board._steps
        if shown is None:
            return
        scene = self._scene_of(shown, step)
        if still is not None:
            image, position, attitude = still
            if self._still is not still:
                self._still = still
                self._channels.put("camera", CAMERA + jpeg(image))
            self._channels.publish("state", {"time": None, "events": [], **thoughts(shown.policy, shown.reasoner)})
            self._chased(scene, (position, attitude), 0.0)
        elif step is not None:
            if step is not self._step:
                self._step = step
                if step.policy_s is not None:
                    self._took.append(step.policy_s)
                self._channels.put("camera", CAMERA + jpeg(step.observation.image))
                self._channels.publish("state", self._state(shown, step))
            since = time.monotonic() - board._at
            self._chased(scene, pose_between(before, step, since), max(step.time - 1 / CONTROL_HZ, 0.0) + since)

    def _scene_of(self, shown: _Shown, step: Step | None) -> Scene | None:
        """The scene of now; it is sent to the page when it changes."""
        scenes = shown.scenes
        if shown.track is not None:
            key = id(shown.track), len(shown.track.stages)
            if self._track[:2] != key:
                self._track = (*key, scenes_of(shown.track))
            scenes = self._track[2]
        stage = 0 if step is None else step.stage
        scene = scenes[min(stage, len(scenes) - 1)] if scenes else None
        if scene is not None:
            self._channels.publish("scene", scene_table(scene))
        else:
            self._channels.publish("scene", {"gates": []})
        return scene

    def _chased(self, scene: Scene | None, pose: tuple[FloatArray, FloatArray] | None, time_s: float) -> None:
        if scene is None or pose is None or self._no_chase:
            return
        try:
            if self._chase is None:
                self._chase = ChaseProcess(self._airframe)
            if scene is not self._placed:
                self._chase.place(scene)
                self._placed = scene
            self._channels.put("chase", CHASE + self._chase.frame(*pose, 1 / DRAWN_HZ, time_s))
        except CognitiveDroneError as error:  # without OpenGL: the flight's camera is elsewhere
            self._no_chase = True
            self._channels.publish("chase", {"missing": str(error)})

    def _state(self, shown: _Shown, step: Step) -> dict[str, Any]:
        seen, guidance, status = step.observation, step.guidance, step.status
        position = None if status.position is None else _rounded(status.position)
        return {
            "time": round(step.time, 2),
            "stage": step.stage,
            "instruction": step.instruction,
            "directive": None if guidance is None else guidance.directive,
            "confidence": None if guidance is None else round(guidance.confidence, 3),
            "age": None if guidance is None else round(guidance.age, 2),
            "hold": self._board.hold,
            "action": _rounded(step.sent),
            "velocity": _rounded([*seen.velocity, seen.yaw_rate]),
            "position": position,
            "yaw": None if math.isnan(status.yaw) else round(status.yaw, 3),
            "guard": "" if status.decision == "fly" else f"{status.decision}: {status.reason}".rstrip(": "),
            "policy_ms": round(1e3 * float(np.median(self._took)), 1) if self._took else None,
            "late": self._board.late,
            "taken": self._board.sticks.taken,
            "goals": goals_table(shown.goals, step.stage),
            **({"seen": []} if shown.track and shown.track.stage.landing else thoughts(shown.policy, shown.reasoner)),
            "events": [event_table(event) for event in list(self._board.events)],
        }


def goals_table(goals: Sequence[SubGoal], index: int) -> list[list[str]]:
    """Sub-goals, each with its state at a stage: done, doing or to do. A choice is taken for as long as it may be."""
    ends = [longest(goals[: number + 1]) for number in range(len(goals))]
    begins = [0, *ends][:-1]
    return [
        [told(goal), "done" if end <= index else "doing" if begin <= index else "to do"]
        for goal, begin, end in zip(goals, begins, ends, strict=True)
    ]


def thoughts(policy: object, reasoner: Reasoner | None) -> dict[str, Any]:
    """What policy and reasoner make of the picture of now, as far as they say."""
    table: dict[str, Any] = {"seen": [seen_table(panel) for panel in (reasoner.seen if reasoner is not None else ())]}
    if isinstance(reasoner, SmallReasoner) and reasoner.concepts is not None:
        table["heard"] = [[what, round(fit, 2)] for what, fit in reasoner.concepts.heard]
    decision = policy.last if isinstance(policy, Small) else None
    if decision is not None:
        table["choice"] = [
            {"u": round(float(u), 1), "score": round(float(score), 2), "right": round(float(p), 3)}
            for (u, _, score, _), p in zip(decision.gates, decision.choice, strict=False)
        ]
    return table


def seen_table(panel: SeenPanel) -> dict[str, Any]:
    """A reading, for the page."""
    return {
        "color": panel.color,
        "box": None if panel.box is None else _rounded(panel.box),
        "shown": panel.shown,
        "readings": [[name, round(share, 3)] for name, share in panel.readings],
        "right": None if panel.right is None else round(panel.right, 3),
    }


def event_table(event: Event) -> dict[str, Any]:
    """An event, for the page."""
    return {"time": round(event.time, 1), "kind": event.kind, "text": event.text}


def scene_table(scene: Scene) -> dict[str, Any]:
    """A scene from above, in the world, m: gates with number, centre, ends and what they show; outlines of solids."""
    stage = scene.stage
    centers, yaws = geometry.gate_centers(stage), geometry.gate_yaws(stage)
    gates = []
    for index in geometry.choices(stage):
        gate = stage.gates[index]
        half, reach = geometry.half_width(stage, index), geometry.half_way(stage, index)
        left = rotate_yaw(np.array([0.0, 1.0, 0.0]), float(yaws[index]))
        gates.append(
            {
                "number": index + 1,
                "at": _rounded(centers[index]),
                "ends": [_rounded(centers[index] + side * half * left) for side in (1, -1)],
                "way": [_rounded(centers[index] + side * reach * left) for side in (1, -1)] if reach else [],
                "color": gate.color,
                "look": f"{gate.color} pad" if stage.landing else f"{gate.size} {gate.color} {gate.shape}",
                "name": scene.names[index] if scene.names and index in geometry.panelled(stage) else "",
            }
        )
    obstacles = [[_rounded(corner) for corner in outline] for outline in geometry.solids(stage).swept().outlines()]
    return {"gates": gates, "obstacles": obstacles, "origin": list(stage.origin), "yaw": stage.yaw}


def pose_between(before: Step | None, step: Step, since_s: float) -> tuple[FloatArray, FloatArray] | None:
    """Position and attitude between the last two steps, `since_s` after the newer one came: one step behind it."""
    status = step.status
    if status.position is None:
        return None
    attitude = status.quaternion if status.quaternion is not None else quaternion_from_yaw(status.yaw)
    if before is None or before.status.position is None or before.stage != step.stage:
        return status.position, attitude
    share = min(1.0, since_s * CONTROL_HZ)
    position = before.status.position + share * (status.position - before.status.position)
    old = before.status.quaternion if before.status.quaternion is not None else attitude
    mixed = (1 - share) * old + share * attitude * (1.0 if float(np.dot(old, attitude)) >= 0 else -1.0)
    return position, mixed / np.linalg.norm(mixed)


def _rounded(values: Sequence[float] | FloatArray) -> list[float]:
    return [round(float(value), 3) for value in values]
