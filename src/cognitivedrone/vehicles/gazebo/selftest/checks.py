"""Checks of a running Gazebo on the ground: each measures one thing and returns a `Finding`.

Times are Gazebo's unless stated to be of the wall clock. The limits are those of tests/external/gazebo.md.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

import numpy as np
from PIL import Image as Pictures

from cognitivedrone.envs.track_runner import scenery_of
from cognitivedrone.errors import GazeboError
from cognitivedrone.frames import quaternion_from_yaw, rotate_yaw, wrap_angle, yaw_of
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.views import first_person_view
from cognitivedrone.sim.drone_world import Scenery
from cognitivedrone.types import DroneState, FloatArray, Image, Stage
from cognitivedrone.vehicles.gazebo.live import PLACE_M, PLACE_RAD, GazeboWorld
from cognitivedrone.vehicles.gazebo.selftest.comparison import Likeness, compare
from cognitivedrone.vehicles.gazebo.sensing import Topic, picture, stamp_of
from cognitivedrone.vehicles.gazebo.server import NO_PLUGIN, GazeboServer
from cognitivedrone.vehicles.gazebo.worlds.export import check, find_checker
from cognitivedrone.vehicles.gazebo.worlds.vehicle import CAMERA_HZ, NAME, camera_stand
from cognitivedrone.world.appearance import PLAIN

POSE_HZ: Final = 60
"""Rate of the true poses: gz-sim sends at most as many in a second of the wall clock, so more in a second of its own
time if that passes more slowly."""
SETTLED_M: Final = 0.02
"""The vehicle may sink by this much into its place on the ground."""
RATE_TOLERANCE: Final = 0.1
"""Relative tolerance of a rate."""
OBSERVED_S: Final = 3.0
"""Time for which clock and camera are watched."""
STAGE_S: Final = 0.5
"""A stage must be complete in this time."""
MOST_DIFFERENT: Final = 12.0
"""Limit of `Likeness.difference`."""
LEAST_GATES, LEAST_PANELS = 0.7, 0.9
"""Limits of `Likeness.gates` and `Likeness.panels`. Gazebo averages light at an edge and we average sRGB values, so its
bars are thinner by half a pixel, which is a quarter of those of a far gate."""
POSES: Final = {"start": (-1.0, 0.0, 0.75, 0.0), "near": (1.0, 0.6, 1.3, -0.15)}
"""Poses of the compared pictures: x, y, z of the vehicle in the stage frame, m, and heading, rad."""
_EXPECTED: Final = re.compile(
    r"(Duplicate input frame|Missed \d+ input frames|Drained n packets: \d+|ArduPilot controller has reset)$"
)
"""What ArduPilot's plugin says of an ArduPilot that starts, and of one that is slow: in lock-step it sends its state
again after 50 ms without an answer, and ArduPilot may then answer twice."""
_STAND, _STAND_TOPIC = "selftest_camera", "/cognitivedrone/selftest"
_FRESH_FRAMES = 3  # after the camera was moved; the first may have been rendered before
_WAIT_S = 60.0  # of the wall clock, for a slow renderer
_LOOK_AGAIN_S = 0.005


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check measured."""

    figure: str
    problem: str = ""
    """Empty if all is well."""
    values: Mapping[str, float] = field(default_factory=dict)
    skipped: str = ""
    """Why nothing could be measured."""


class GazeboScene:
    """What the checks are about: exported worlds, their stages and pictures, and Gazebo once it runs."""

    world: GazeboWorld
    server: GazeboServer

    def __init__(self, out: Path, files: Sequence[Path], stages: Sequence[Stage], labels: LabelPack) -> None:
        self.out = out
        self.files = files
        self.stages = stages
        self.labels = labels
        self.opened = False
        self.complaints_before = 0
        """Number of complaints that a check has already reported."""
        self.shown = 0
        """Index of the stage in Gazebo."""
        self._cameras: Cameras | None = None

    def open(self, world: GazeboWorld, server: GazeboServer) -> None:
        """Gazebo runs."""
        self.world, self.server, self.opened = world, server, True

    def render(self, scenery: Scenery, state: DroneState) -> Image:
        """Our picture of the stage in Gazebo."""
        self._cameras = self._cameras or Cameras()
        self._cameras.set_stage(0, self.stages[self.shown], scenery.panels, scenery.board)
        image: Image = self._cameras.first_person(state.position[None], state.quaternion[None])[0]
        return image

    def close(self) -> None:
        """Free our renderer."""
        if self._cameras is not None:
            self._cameras.close()


def parsing(scene: GazeboScene) -> Finding:
    """Every exported world passes libsdformat."""
    if find_checker() is None:
        return Finding("", skipped="libsdformat is not on this machine")
    return Finding(f"{len(scene.files)} worlds pass {check(scene.files)}", values={"worlds": len(scene.files)})


def loading(scene: GazeboScene) -> Finding:
    """The world loads without a warning or an error; a missing ArduPilot plugin is reported by the checks in flight."""
    path = scene.world.path()
    try:
        path.until(1.0)
    finally:
        path.close()
    complaints = scene.server.complaints()
    scene.complaints_before = len(complaints)
    complaints = [line for line in complaints if NO_PLUGIN not in line and "ArduPilotPlugin" not in line]
    return Finding("loaded, and time passes", _problem(complaints), {"complaints": len(complaints)})


def leftovers(scene: GazeboScene) -> Finding:
    """Gazebo printed no warning or error since it loaded the world, but what a slow ArduPilot makes its plugin say."""
    later = scene.server.complaints()[scene.complaints_before :]
    complaints = [line for line in later if not _EXPECTED.search(line)]
    slow = len(later) - len(complaints)
    figure = f"ArduPilot's plugin says {slow} times that frames were lost or repeated" if slow else "nothing more in it"
    return Finding(figure, _problem(complaints), {"complaints": len(complaints), "frames_lost_or_repeated": slow})


def places(scene: GazeboScene) -> Finding:
    """Everything is where the file says, and the vehicle rests on the ground."""
    wanted = poses_of(scene.files[0])
    found = scene.world.places()
    missing = sorted(wanted.keys() - found.keys())
    if missing:
        return Finding("", f"{', '.join(missing)} of the exported world is missing")
    off: dict[str, tuple[float, float]] = {}
    for name, (position, yaw) in wanted.items():
        place, quaternion = found[name]
        off[name] = float(np.linalg.norm(place - position)), abs(float(wrap_angle(yaw_of(quaternion) - yaw)))
    moved, turned = off.pop(NAME)
    most_m, most_rad = max(m for m, _ in off.values()), max(rad for _, rad in off.values())
    figure = f"{len(off)} models within {1000 * most_m:.2f} mm, {math.degrees(most_rad):.3f} deg; vehicle {moved:.3f} m"
    values = {"models_m": most_m, "models_rad": most_rad, "vehicle_m": moved, "vehicle_rad": turned}
    bad = [name for name, (m, rad) in off.items() if m > PLACE_M or rad > PLACE_RAD]
    bad += [NAME] if moved > SETTLED_M or turned > math.radians(1) else []
    return Finding(figure, f"not in place: {', '.join(bad)}" if bad else "", values)


def clock(scene: GazeboScene) -> Finding:
    """True poses come often enough, none twice; reports how fast time passes."""
    path = scene.world.path()
    try:
        began, wall = path.newest().time, time.monotonic()
        stamps = [sample.time for sample in path.until(began + OBSERVED_S)]
        factor = (path.newest().time - began) / (time.monotonic() - wall)
    finally:
        path.close()
    rate, again = _rate(stamps)
    figure = f"{rate:.1f} poses a second of Gazebo's time, which runs at {factor:.2f} of the wall clock"
    problem = f"{rate:.1f} poses a second, not {POSE_HZ}" if rate < (1 - RATE_TOLERANCE) * POSE_HZ else ""
    if again:
        problem = problem or f"{again} time stamps did not increase"
    return Finding(figure, problem, {"hz": rate, "real_time_factor": factor, "stamps_not_increasing": again})


def camera_rate(scene: GazeboScene) -> Finding:
    """The vehicle's camera sends frames at its rate."""
    stamps: list[float] = []

    def take(message: Any) -> float:
        stamps.append(stamp_of(message))
        return stamps[-1]

    config = scene.world.config
    topic = Topic(scene.world.bindings, config.camera_topic, "Image", take, config.first_s)
    try:
        first = topic.newest(math.inf)[0]
        _wait(lambda: topic.newest(config.silence_s)[0] >= first + OBSERVED_S, "camera frames")
    finally:
        topic.close()
    rate, again = _rate(stamps)
    figure = f"{rate:.1f} frames a second of Gazebo's time"
    off = abs(rate - CAMERA_HZ) > RATE_TOLERANCE * CAMERA_HZ
    problem = f"{rate:.1f} frames a second, not {CAMERA_HZ}" if off else ""
    if again:
        problem = problem or f"{again} time stamps did not increase"
    return Finding(figure, problem, {"hz": rate, "stamps_not_increasing": again})


def pictures(scene: GazeboScene) -> Finding:
    """The first stage looks as in our renderer, from two poses."""
    return _seen(scene, [_look(scene, where) for where in POSES])


def stages(scene: GazeboScene) -> Finding:
    """Every further stage replaces the one before in time, alone, and looks as in our renderer."""
    path = scene.world.path()
    took: list[float] = []
    seen: list[Likeness] = []
    try:
        for index in range(1, len(scene.stages)):
            began = path.newest().time
            scene.world.show(scene.stages[index], scene.labels)
            took.append(path.newest().time - began)
            scene.shown = index
            seen.append(_look(scene, "start"))
    finally:
        path.close()
    if _STAND in scene.world.places():
        scene.world.remove(_STAND)
    found = _seen(scene, seen)
    late = [f"stage {index + 2} took {s:.2f} s" for index, s in enumerate(took) if s > STAGE_S]
    figure = f"{len(took)} stages, complete in {max(took):.2f} s at most; {found.figure}"
    return Finding(figure, ", ".join(late) or found.problem, {"slowest_s": max(took), **found.values})


def poses_of(world: Path) -> dict[str, tuple[FloatArray, float]]:
    """Position (3,) in m and heading in rad of the models of an exported world, by name."""
    models = ET.parse(world).getroot().iterfind("world/model")  # noqa: S314 - our own file
    poses: dict[str, tuple[FloatArray, float]] = {}
    for model in models:
        numbers = [float(number) for number in (model.findtext("pose") or "0 0 0 0 0 0").split()]
        poses[model.get("name", "")] = np.array(numbers[:3]), numbers[5]
    return poses


def _look(scene: GazeboScene, where: str) -> Likeness:
    """Compare Gazebo's picture from one of `POSES` with ours, and save both."""
    stage, world = scene.stages[scene.shown], scene.world
    x, y, z, yaw = POSES[where]
    position = rotate_yaw(np.array([x, y, z]), stage.yaw) + np.array([*stage.origin, 0.0])
    state = DroneState(position, np.zeros(3), quaternion_from_yaw(yaw + stage.yaw), np.zeros(3))
    if _STAND not in world.places():
        world.spawn(_STAND, camera_stand(_STAND, _STAND_TOPIC))
        _wait(lambda: _STAND in world.places(), "the camera that was spawned")
    world.move(_STAND, tuple(position), yaw + stage.yaw)
    theirs = _photograph(world, state)
    scenery = scenery_of(stage, scene.labels, PLAIN)
    ours = scene.render(scenery, state)
    folder = scene.out / "pictures"
    folder.mkdir(exist_ok=True)
    for who, image in (("gazebo", theirs), ("ours", ours)):
        Pictures.fromarray(image).save(folder / f"stage_{scene.shown + 1}_{where}_{who}.png")
    return compare(theirs, ours, stage, scenery.aspects, first_person_view(state))


def _photograph(world: GazeboWorld, state: DroneState) -> Image:
    """A picture of the spawned camera, once it is where it should be."""

    def there() -> bool:
        return bool(np.linalg.norm(world.places()[_STAND][0] - state.position) < PLACE_M)

    _wait(there, "the camera that was moved")
    topic: Topic[Image] = Topic(world.bindings, _STAND_TOPIC, "Image", picture, world.config.first_s)
    try:
        seen: set[float] = set()

        def fresh() -> bool:
            seen.add(topic.newest(world.config.silence_s)[1])
            return len(seen) > _FRESH_FRAMES

        _wait(fresh, "new camera frames")
        return topic.newest(world.config.silence_s)[0]
    finally:
        topic.close()


def _seen(scene: GazeboScene, likenesses: Sequence[Likeness]) -> Finding:
    """The worst of some comparisons."""
    worst = max(each.difference for each in likenesses)
    gates = min(value for each in likenesses for value in each.gates)
    panels = min((value for each in likenesses for value in each.panels), default=1.0)
    figure = f"difference {worst:.1f} of 255, gates overlap {gates:.2f}, panels correlate {panels:.2f}"
    problems = [
        text
        for wrong, text in (
            (worst > MOST_DIFFERENT, f"a picture differs by {worst:.1f} of 255 on average"),
            (gates < LEAST_GATES, f"the pixels of a gate overlap by {gates:.2f} only"),
            (panels < LEAST_PANELS, f"a panel's picture correlates by {panels:.2f} only"),
        )
        if wrong
    ]
    problem = f"{', '.join(problems)}; see {scene.out / 'pictures'}" if problems else ""
    values = {"difference": worst, "gates": gates, "panels": panels}
    values |= {"gamma": likenesses[0].gamma, "gain": likenesses[0].gain}
    return Finding(figure, problem, values)


def _rate(stamps: Sequence[float]) -> tuple[float, int]:
    """Samples a second, and how many stamps were not later than the one before."""
    if len(stamps) < 2 or stamps[-1] <= stamps[0]:
        return 0.0, max(len(stamps) - 1, 0)
    return (len(stamps) - 1) / (stamps[-1] - stamps[0]), int((np.diff(stamps) <= 0).sum())


def _problem(complaints: Sequence[str]) -> str:
    """Gazebo's complaints as a problem; empty without any."""
    more = f" (and {len(complaints) - 1} more lines in gazebo.log)" if len(complaints) > 1 else ""
    return f"Gazebo says: {complaints[0]}{more}" if complaints else ""


def _wait(condition: Any, what: str) -> None:
    """Wait for a condition; raises `GazeboError` if it does not come true."""
    end = time.monotonic() + _WAIT_S
    while not condition():
        if time.monotonic() > end:
            raise GazeboError(f"waited {_WAIT_S:g} s for {what}; is the simulation running?")
        time.sleep(_LOOK_AGAIN_S)
