"""Landing on a pad: by the camera in the loop, and by the oracle; wrong pads and the bare floor are told apart."""

import numpy as np
import pytest

from cognitivedrone.control.planning import Lander, pad_in
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner
from cognitivedrone.envs.worlds import SimulatedDrone
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.gate_monitor import judge
from cognitivedrone.sim.simulator import Simulator, Start
from cognitivedrone.tasks.families.mission_tasks import landing_task
from cognitivedrone.types import Color, Observation, Stage
from cognitivedrone.world import geometry

COLORS: tuple[Color, Color, Color] = ("red", "blue", "green")


@pytest.fixture(scope="module")
def simulator():
    made = Simulator(1)
    yield made
    made.close()


def runner_of(simulator, target, appearance="plain"):
    runner = TrackRunner(simulator.world(0), load_pack(None), TrackConfig(appearance=appearance))
    task = landing_task(COLORS[target], target, COLORS, "x/1")
    runner.begin((task,), np.random.default_rng(target), Start((-1.0, 0.3, 1.4), 0.1))
    return runner, task


@pytest.mark.parametrize("appearance", ["plain", "varied"])
@pytest.mark.parametrize("target", [0, 1, 2])
def test_it_lands_on_the_pad_of_its_colour(simulator, target, appearance):
    runner, task = runner_of(simulator, target, appearance)
    drone, lander = SimulatedDrone(runner), Lander()
    while not runner.finished:
        drone.send(lander.act(drone.observe(), task.gates[target].color))
        drone.sleep_until(drone.now() + 0.1)
    (result,) = runner.results
    assert (result.outcome, result.chosen) == ("passed", target)
    assert result.clearance_m > 0.15


def test_the_place_of_a_pad_is_found_in_the_image(simulator):
    runner, task = runner_of(simulator, 1)
    observation = SimulatedDrone(runner).observe()
    state, centers = runner.world.state(), geometry.gate_centers(runner.stage)
    for index, gate in enumerate(task.gates):
        away = centers[index, :2] - state.position[:2]
        forward = np.array([[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]]) @ away
        assert pad_in(observation.image, observation.height, gate.color) == pytest.approx(forward, abs=0.25)
    nearest = pad_in(observation.image, observation.height, None)
    assert np.hypot(*nearest) == pytest.approx(np.hypot(*(centers[:, :2] - state.position[:2]).T).min(), abs=0.3)


def test_without_a_pad_in_view_it_turns_on_the_spot():
    image = np.full((256, 256, 3), 180, np.uint8)
    seen = Observation(image, "Land on the red pad", np.zeros(3, np.float32), 1.0, 0.0, 0.1)
    command = Lander().act(seen, "red")
    assert command[:3].tolist() == [0, 0, 0]
    assert command[3] > 0


def test_the_floor_beside_a_pad_is_a_collision():
    task = landing_task("red", 0, COLORS, "x/1")
    stage = Stage(task.gates, task.labels, landing=True)
    (x, y), *_ = geometry.PAD_XY
    for place, kind, gate in (((x, y), "gate", 0), ((x + 0.6, y), "collision", None), ((4.2, 0.2), "gate", 1)):
        path = np.array([[*place, 0.5], [*place, 0.05]])
        found = judge(stage, path, 0.15, (1.0, 1.0, 1.0))
        assert (found.kind, found.gate) == (kind, gate)
