"""Runs one drone through the tasks of a track: the current stage, its place in the world, and the results.

The bridge between tasks and the simulator: it combines an event at a gate ("through gate 2") with the task ("which
gate is right?").
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import get_args

import numpy as np

from cognitivedrone.choices import AppearanceName
from cognitivedrone.errors import AppearanceError, SimulationError, did_you_mean
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.plan import Scenario
from cognitivedrone.sim.gate_monitor import GateEvent
from cognitivedrone.sim.simulator import DroneWorld, Scenery, Start
from cognitivedrone.tasks.missions import forbidden, shuts
from cognitivedrone.types import CONTROL_HZ, GroundTruth, Outcome, Stage, StageResult, Task, Track
from cognitivedrone.world import geometry, places
from cognitivedrone.world.appearance import PLAIN, Appearance, photo_appearance, varied_appearance

APPEARANCES: tuple[AppearanceName, ...] = get_args(AppearanceName)
DECLINED_S = 3.0
"""A stage ends once the pilot has declined for this long without interruption, s."""
FORBIDDEN_M = 1.0
"""Nearer than this to the centre of a gate that the mission forbids, the drone is in a forbidden zone."""
FLOOR_ROOM_M = 0.05
"""Distance between hull and floor at the lowest start."""


@dataclass(frozen=True, slots=True)
class TrackConfig:
    """The conditions of a flight. Raises `SimulationError` if they cannot be simulated."""

    appearance: AppearanceName = "plain"
    """`plain` as published, `varied`: floor, walls, light, colours and camera noise drawn from the seed, or `photo`: a
    place of `places`, with its light, and a camera drawn from the seed."""
    time_limit_s: float = 30.0
    """Time limit for each stage."""
    wind_m_s: float = 0.0
    """Speed of a steady wind; the seed draws its direction."""
    place: str = "training"
    """With `photo`: a set of places, a place's name, or a panorama's file (`world.places`)."""

    @classmethod
    def of(cls, scenario: Scenario, time_limit_s: float = 30.0) -> TrackConfig:
        """The conditions of a scenario."""
        return cls(scenario.appearance, time_limit_s, scenario.wind, scenario.place or "training")

    def draw(self, rng: np.random.Generator) -> Appearance:
        """The appearance of an episode."""
        if self.appearance == "varied":
            return varied_appearance(rng)
        return photo_appearance(rng, places.choices(self.place)) if self.appearance == "photo" else PLAIN

    def __post_init__(self) -> None:
        if self.appearance not in APPEARANCES:
            raise AppearanceError(
                f"unknown appearance {self.appearance!r}; {did_you_mean(str(self.appearance), APPEARANCES)}"
            )
        if self.appearance == "photo":
            places.choices(self.place)
        if not self.time_limit_s > 0:
            raise SimulationError(f"time_limit_s is {self.time_limit_s}; it is a time in seconds, more than 0")


def episode_rng(suite_digest: str, episode: int, seed: int) -> np.random.Generator:
    """The only source of randomness of an episode: the same three numbers give the same flight conditions anywhere."""
    digest = hashlib.sha256(suite_digest.encode()).digest()
    return np.random.default_rng([int.from_bytes(digest[:8], "big"), episode, seed])


def stage_of(task: Task, origin: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0) -> Stage:
    """The task's gates and panels, placed in the world."""
    return Stage(
        task.gates, task.labels, task.board, origin, yaw, only=task.only, layout=task.layout, landing=task.landing,
        obstacles=task.obstacles, landmark=task.landmark, missing=task.missing,
    )  # fmt: skip


def next_place(stage: Stage, task: Task) -> tuple[tuple[float, float], float]:
    """Origin (x, y), m, and yaw, rad, of the stage after the right end of this one: behind its right gate, or here."""
    return (stage.origin, stage.yaw) if task.target is None else geometry.next_stage_origin(stage, task.target)


def scenery_of(stage: Stage, labels: LabelPack, appearance: Appearance) -> Scenery:
    """The pictures of a stage."""
    first, second, third = (labels.image(reference) for reference in stage.labels)
    more = geometry.board_label(stage)
    return Scenery((first, second, third), labels.image(more) if more else None, appearance)


def draw_start(rng: np.random.Generator, hull_radius: float, wind_m_s: float = 0.0) -> Start:
    """The published start: uniformly within 1 m of (-1, 0, 0.75) m on each axis, facing along x.

    Never below 0.2 m, and never closer to the floor than a large hull allows.
    """
    x, y, z = geometry.START + rng.uniform(-geometry.START_HALF_EXTENT, geometry.START_HALF_EXTENT, 3)
    direction = rng.uniform(-np.pi, np.pi)
    wind = (wind_m_s * float(np.cos(direction)), wind_m_s * float(np.sin(direction)), 0.0)
    lowest = max(geometry.START_MIN_HEIGHT, hull_radius + FLOOR_ROOM_M)
    return Start((float(x), float(y), max(float(z), lowest)), 0.0, wind)


class TrackRunner:
    """Leads the drone of one world through a track.

    A stage that is passed, or left through a wrong gate, leads to the next one behind that gate; anything else ends
    the flight, and the stages that were not reached count as such.

    The pilot may decline (`decline`): it reports that no gate matches the instruction. It is right where the task has
    no target; the stage is then passed, and the next one, if any, is at the same place.
    """

    def __init__(self, world: DroneWorld, labels: LabelPack, config: TrackConfig) -> None:
        self.world = world
        self.labels = labels
        self.config = config
        self.track: Track = ()
        self.results: list[StageResult] = []
        self.stages: list[Stage] = []
        self.appearance = PLAIN
        self.start = Start((0.0, 0.0, 0.0))
        self._declined_at: float | None = None

    def begin(
        self, track: Track, rng: np.random.Generator, start: Start | None = None, appearance: Appearance | None = None
    ) -> None:
        """Start a new flight at the first stage; `rng` draws what is not given: a published start, and the appearance
        that the conditions ask for.
        """
        self.track = track
        self.results = []
        self.stages = [stage_of(track[0])]
        self.appearance = appearance or self.config.draw(rng)
        self.start = start or draw_start(rng, self.world.hull_radius, self.config.wind_m_s)
        scenery = scenery_of(self.stages[0], self.labels, self.appearance)
        self.world.begin(self.stages[0], scenery, self.start)
        self._stage_start_s = 0.0
        self._forbidden_s = 0.0
        self._declined_at = None

    @property
    def finished(self) -> bool:
        """Whether the flight is over."""
        return len(self.results) == len(self.track)

    @property
    def index(self) -> int:
        """Index of the current stage, from 0."""
        return len(self.results)

    @property
    def task(self) -> Task:
        """The current task; after the end, the last one."""
        return self.track[min(self.index, len(self.track) - 1)]

    @property
    def instruction(self) -> str:
        """What a pilot is told at this stage: the sentence of the whole mission, or else the task's instruction."""
        return self.task.mission or self.task.instruction

    @property
    def stage(self) -> Stage:
        """The current stage; after the end, the last one."""
        return self.stages[-1]

    @property
    def shows_pads_next(self) -> bool:
        """Whether pads are shown once the pilot has hovered here: no gate is right, and the next stage is a landing."""
        return self.task.target is None and self.index + 1 < len(self.track) and self.track[self.index + 1].landing

    def truth(self) -> GroundTruth:
        """Ground truth of the current stage."""
        return GroundTruth(self.task, self.stage, self.world.state, self.world.hull_radius, self.world.time)

    def decline(self, declined: bool) -> None:
        """Note that the pilot begins or ceases to report that no gate matches the instruction."""
        if not declined:
            self._declined_at = None
        elif self._declined_at is None:
            self._declined_at = self.world.time()

    def update(self, gate_event: GateEvent | None) -> StageResult | None:
        """Process the event of the last control period; returns the result if it ended the stage."""
        if self.world.diverged:
            return self.end("invalid")
        if self.task.mission is not None:
            self._watch_forbidden()
        if gate_event is not None:
            return self._judged(gate_event)
        now, since = self.world.time(), self._declined_at
        if since is not None and now - since >= DECLINED_S - 1e-9:
            return self._declined()
        if now - self._stage_start_s >= self.config.time_limit_s - 1e-9:
            if since is not None:
                return self._declined()
            return self.end("timeout" if self.task.target is not None else "hesitated")
        return None

    def end(self, outcome: Outcome, *, chosen: int | None = None, clearance_m: float | None = None) -> StageResult:
        """End the flight here; remaining stages are recorded as not reached."""
        if chosen is None and outcome not in ("invalid", "policy_error"):
            chosen = self.world.gate_monitor.favoured()
        result = self._result(outcome, chosen, clearance_m)
        self.results.append(result)
        for task in self.track[len(self.results) :]:
            self.results.append(unflown(task, "not_reached"))
        return result

    def _watch_forbidden(self) -> None:
        """Count the last control period, if it ended near a gate that the mission forbids."""
        gates = forbidden_gates(self.task)
        if gates:
            away = self.world.gate_monitor.centers[list(gates)] - self.world.state().position
            self._forbidden_s += (np.linalg.norm(away, axis=1) < FORBIDDEN_M).any() / CONTROL_HZ

    def _declined(self) -> StageResult:
        """The end of a stage in which the pilot has declined."""
        if self.task.target is not None:
            return self.end("false_alarm")
        result = self._result("passed", None, None)
        self.results.append(result)
        if not self.finished:
            self._place(self.stage.origin, self.stage.yaw)
        return result

    def _place(self, origin: tuple[float, float], yaw: float) -> None:
        """Show the next stage."""
        self.stages.append(stage_of(self.track[self.index], origin, yaw))
        self.world.place(self.stage, scenery_of(self.stage, self.labels, self.appearance))
        self._stage_start_s = self.world.time()
        self._forbidden_s = 0.0
        self._declined_at = None

    def _judged(self, gate_event: GateEvent) -> StageResult:
        if gate_event.kind != "gate":
            return self.end(gate_event.kind, chosen=gate_event.gate)
        passed = gate_event.gate == self.task.target
        outcome: Outcome = "passed" if passed else "wrong_gate"
        result = self._result(outcome, gate_event.gate, gate_event.clearance_m)
        self.results.append(result)
        if not self.finished and gate_event.gate is not None:
            self._place(*geometry.next_stage_origin(self.stage, gate_event.gate))
        return result

    def _result(self, outcome: Outcome, chosen: int | None, clearance_m: float | None) -> StageResult:
        gate_monitor = self.world.gate_monitor
        task = self.task
        ratio = None
        if outcome in ("passed", "wrong_gate") and chosen is not None:
            straight = float(np.linalg.norm(gate_monitor.centers[chosen] - gate_monitor.start))
            ratio = gate_monitor.path_m / straight
        return StageResult(
            task_id=task.id,
            category=task.category,
            family=task.family,
            target=task.target,
            outcome=outcome,
            chosen=chosen,
            time_s=self.world.time() - self._stage_start_s,
            path_m=gate_monitor.path_m,
            path_ratio=ratio,
            clearance_m=clearance_m,
            gate_distance_m=None if task.target is None else float(gate_monitor.closest_m[task.target]),
            obstacle_m=gate_monitor.obstacle_m,
            forbidden_s=None if task.mission is None else round(self._forbidden_s, 6),
        )


def forbidden_gates(task: Task) -> tuple[int, ...]:
    """The gates of a stage, 0 to 2, that its mission forbids to fly through."""
    if task.mission is None or task.landing:
        return ()
    avoid = forbidden(task.mission)
    return tuple(number for number, gate in enumerate(task.gates) if shuts(avoid, (gate.color, gate.shape, gate.size)))


def unflown(task: Task, outcome: Outcome) -> StageResult:
    """The result of a stage without any flight."""
    return StageResult(
        task_id=task.id,
        category=task.category,
        family=task.family,
        target=task.target,
        outcome=outcome,
        chosen=None,
        time_s=0.0,
        path_m=0.0,
        path_ratio=None,
        clearance_m=None,
        gate_distance_m=None,
        forbidden_s=None if task.mission is None else 0.0,
    )
