"""Checks the Gazebo and the ArduPilot that run on a track of ours, and prints what was measured.

    cognitivedrone gazebo export --suite open-v1:track --track 0 --out t

Start both as steps 5 and 6 of docs/gazebo.md say, on t/stage_1.sdf; then, with the Python of step 3,

    python tests/external/check_gazebo.py t

It exits with an error at the first thing that is not as gazebo.md, beside this file, asks. Times are Gazebo's.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree as ET

import numpy as np

from cognitivedrone.envs.track_runner import scenery_of
from cognitivedrone.errors import GazeboError
from cognitivedrone.frames import wrap_angle, yaw_of
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.simulator import TICKS_PER_CONTROL, Start
from cognitivedrone.tasks import open_suite
from cognitivedrone.types import CONTROL_HZ, DroneState, Stage
from cognitivedrone.vehicles.gazebo.flight import URL, GazeboFlight, open_gazebo
from cognitivedrone.vehicles.gazebo.live import GazeboWorld, LiveConfig
from cognitivedrone.vehicles.gazebo.worlds.export import check, stages_of
from cognitivedrone.vehicles.gazebo.worlds.vehicle import NAME
from cognitivedrone.world.appearance import PLAIN

HOVER = (0.0, 0.0, 0.0, 0.0)


def fly(flight: GazeboFlight, seconds: float, action: tuple[float, float, float, float]) -> list[DroneState]:
    states = []
    for _ in range(round(seconds * CONTROL_HZ)):
        flight.command(np.array(action))
        flight.advance(TICKS_PER_CONTROL)
        assert not flight.diverged, flight.trouble
        states.append(flight.state())
    return states


def turned(states: list[DroneState]) -> float:
    return abs(float(wrap_angle(yaw_of(states[-1].quaternion) - yaw_of(states[0].quaternion))))


def check_files(folder: Path) -> None:
    files = sorted(folder.glob("*.sdf"))
    try:
        print(f"parser: {len(files)} worlds pass {check(files)}")
    except GazeboError as error:
        if "not on this machine" not in str(error):
            raise
        print(f"parser: {error}")


def check_places(world: GazeboWorld, file: Path) -> None:
    """Every model is where the file says; the vehicle may have sunk into its place."""
    found = world.places()
    for model in ET.parse(file).getroot().iterfind("world/model"):  # noqa: S314 - our own file
        name = model.get("name", "")
        wanted = [float(number) for number in (model.findtext("pose") or "0 0 0 0 0 0").split()]
        off = float(np.linalg.norm(found[name][0] - wanted[:3]))
        away = abs(float(wrap_angle(yaw_of(found[name][1]) - wanted[5])))
        assert off < (0.02 if name == NAME else 1e-3), (name, off)
        assert away < np.radians(1.0 if name == NAME else 0.1), (name, away)
    print("places: every model within 1 mm, the vehicle within 2 cm")


def check_clock(world: GazeboWorld) -> None:
    path = world.path()
    stamps = np.array([sample.time for sample in path.until(path.newest().time + 3.0)])
    path.close()
    rate = (len(stamps) - 1) / (stamps[-1] - stamps[0])
    assert rate > 54, rate
    assert (np.diff(stamps) > 0).all()
    print(f"clock: {rate:.1f} poses a second, none twice")


def check_stages(world: GazeboWorld, stages: tuple[Stage, ...]) -> None:
    """Each replaces the one before in time; the vehicle's camera sees it as our renderer does."""
    path, camera, pack = world.path(), world.camera(), load_pack()
    with Cameras() as cameras:
        for number, stage in enumerate((*stages[1:], stages[0]), start=2):
            began = path.newest().time
            world.show(stage, pack)
            took = path.newest().time - began
            path.until(path.newest().time + 0.5)
            scenery, state = scenery_of(stage, pack, PLAIN), world.state()
            cameras.set_stage(0, stage, scenery.panels, scenery.board)
            ours = cameras.first_person(state.position[None], state.quaternion[None])[0].astype(float)
            differs = float(np.abs(camera.read().image - ours).mean())
            assert took < 0.5, (number, took)
            assert differs < 24, (number, differs)
            print(f"stages: complete after {took:.2f} s, the picture differs by {differs:.1f} of 255")
    path.close()
    camera.close()


def check_flight(flight: GazeboFlight) -> None:
    flight.begin(Start((0.0, 0.0, 1.0)))
    states = fly(flight, 5.0, HOVER)
    moved = float(np.linalg.norm(states[-1].position - states[0].position))
    assert max(moved, abs(states[-1].position[2] - 1.0)) < 0.15, moved
    assert turned(states) < np.radians(5)
    print(f"hover: moves {moved:.2f} m, turns {np.degrees(turned(states)):.1f} degrees in 5 s")
    states = fly(flight, 3.0, (1.0, 0.0, 0.0, 0.0))
    speed = float(np.mean([np.linalg.norm(state.velocity[:2]) for state in states[-CONTROL_HZ:]]))
    half = 1 + next(i for i, state in enumerate(states) if np.linalg.norm(state.velocity[:2]) > 0.5)
    assert abs(speed - 1.0) < 0.1, speed
    assert abs(half / CONTROL_HZ - 0.59) < 0.25, half
    print(f"velocity: {speed:.2f} of 1 m/s, half of it after {half / CONTROL_HZ:.1f} s")
    fly(flight, 2.0, HOVER)
    rate = turned(fly(flight, 3.0, (0.0, 0.0, 0.0, 0.5))[-CONTROL_HZ - 1 :])
    assert abs(rate - 0.5) < 0.05, rate
    print(f"yaw rate: {rate:.2f} of 0.5 rad/s")


def main() -> None:
    folder, url = Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else URL
    stages = stages_of(open_suite("open-v1:track").tracks[0])
    check_files(folder)
    with TemporaryDirectory() as spawned, GazeboWorld(Path(spawned), LiveConfig()) as world:
        check_places(world, folder / "stage_1.sdf")
        check_clock(world)
        check_stages(world, stages)
        with open_gazebo(url) as flight:
            check_flight(flight)
        print(f"landing: {world.state().position[2]:.2f} m above the ground")


if __name__ == "__main__":
    main()
