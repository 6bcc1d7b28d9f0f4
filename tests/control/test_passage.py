"""How a stage ends: the pilot's own estimate of having passed a gate, and landing on the right pad."""

from dataclasses import replace

import numpy as np
import pytest

from cognitivedrone.control.passage import Passage, WatchedDrone, approach
from cognitivedrone.control.planning import Lander, pad_in
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner
from cognitivedrone.envs.worlds import SimulatedDrone
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.drawing.views import FOCAL_PX
from cognitivedrone.sim.gate_monitor import judge
from cognitivedrone.sim.simulator import Simulator, Start
from cognitivedrone.tasks.families.mission_tasks import landing_task
from cognitivedrone.types import IMAGE_SIZE, Color, Image, Observation, Stage
from cognitivedrone.world import geometry

RED, BLUE = (230, 10, 10), (10, 10, 230)
BAR_M = 0.15


def ring(distance_m: float, opening_m: float, colour=RED, aside_m: float = 0.0) -> Image:
    """What a level camera sees of a square gate straight ahead, or `aside_m` to the left; nothing behind it."""
    image = np.full((IMAGE_SIZE, IMAGE_SIZE, 3), 200, np.uint8)
    if distance_m <= 0.05:
        return image
    rows, columns = np.mgrid[:IMAGE_SIZE, :IMAGE_SIZE] - (IMAGE_SIZE - 1) / 2
    beside = np.maximum(np.abs(columns * distance_m / FOCAL_PX + aside_m), np.abs(rows * distance_m / FOCAL_PX))
    image[(beside > opening_m / 2) & (beside < opening_m / 2 + BAR_M)] = colour
    return image


def observation(image: Image, time_s: float, forward_m_s: float) -> Observation:
    return Observation(image, "go", np.array([forward_m_s, 0.0, 0.0], np.float32), 1.0, 0.0, time_s)


def fly(passage: Passage, path_m: np.ndarray, plane_m: float, opening_m: float, **look) -> list[float]:
    """Fly along x at 10 Hz; the places, beyond the plane, at which a passage was noticed."""
    noticed = []
    for step, place in enumerate(path_m):
        speed = (place - path_m[max(step - 1, 0)]) / 0.1
        if passage.update(observation(ring(plane_m - place, opening_m, **look), step / 10, speed)):
            noticed.append(float(place - plane_m))
    return noticed


@pytest.mark.parametrize("opening_m", [0.75, 1.5])
@pytest.mark.parametrize("speed", [0.5, 1.0, 1.7, 3.0])
def test_a_gate_that_is_flown_through_is_noticed_once_just_behind_it(opening_m, speed):
    passage = Passage()
    noticed = fly(passage, np.arange(0, 9, speed / 10), 5.0, opening_m)
    assert len(noticed) == passage.gates == 1
    assert 0.1 < noticed[0] < 0.5 + speed / 10


def test_nothing_is_noticed_of_a_gate_that_is_not_reached_or_turned_away_from():
    approach = np.arange(0, 4.5, 0.15)
    passage = Passage()
    assert fly(passage, np.concatenate([approach, np.full(30, approach[-1]), approach[::-1]]), 5.0, 1.5) == []
    for step in range(100):  # having turned to somewhere else, it flies on
        passage.update(observation(ring(-1, 1.5), 20 + step / 10, 1.5))
    assert passage.gates == 0


def test_a_gate_that_is_turned_away_from_is_forgotten():
    passage = Passage()
    fly(passage, np.arange(0, 4.2, 0.15), 5.0, 1.5)
    for step in range(80):
        seen = observation(ring(-1, 1.5), 3 + step / 10, 1.5 if step > 10 else 0.0)
        passage.update(replace(seen, yaw_rate=1.0 if step <= 10 else 0.0))
    assert passage.gates == 0


def test_a_gate_that_stands_aside_of_the_way_is_not_flown_through():
    assert fly(Passage(), np.arange(0, 9, 0.15), 5.0, 0.75, aside_m=1.5) == []


def test_gates_of_every_colour_one_after_the_other_are_counted():
    passage = Passage()
    for colour in (RED, BLUE, BLUE):
        passage_before = passage.gates
        path = np.arange(0, 6, 0.16)
        for place in path:
            time = 0.0 if passage._time is None else passage._time + 0.1
            passage.update(observation(ring(4.0 - place, 1.5, colour=colour), time, 1.6))
        assert passage.gates == passage_before + 1


def test_the_plane_is_where_one_over_the_width_reaches_zero():
    flown = np.linspace(0, 3, 10)
    assert approach(np.column_stack([flown, 100 / (4.5 - flown)])) == pytest.approx((4.5, 100.0))
    assert approach(np.column_stack([flown, 100 / (4.5 + flown)])) is None
    assert approach(np.column_stack([np.ones(5), np.full(5, 80.0)])) is None
    assert approach(np.array([[0.0, 10.0], [1.0, 20.0]])) is None


def test_a_gate_that_leaves_the_view_sideways_before_it_is_reached_is_not_passed():
    passage = Passage()
    for step, place in enumerate(np.arange(0, 9, 0.15)):
        aside = 0.0 if place < 3.6 else 1.4  # it veers off 1.4 m before the gate
        passage.update(observation(ring(5.0 - place, 0.75, aside_m=aside), step / 10, 1.5))
    assert passage.gates == 0


def test_a_watched_drone_shows_what_it_observes():
    frames = iter(observation(ring(3.0 - 0.15 * step, 1.5), step / 10, 1.5) for step in range(60))

    class Seen:
        def observe(self):
            return next(frames)

        def send(self, action):
            return action

        def close(self):
            pass

    passage = Passage()
    drone = WatchedDrone(Seen(), passage)
    observed = [drone.observe() for _ in range(40)]
    assert len(observed) == 40
    assert passage.gates == 1
    assert drone.send(np.ones(4, np.float32)).tolist() == [1, 1, 1, 1]


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


@pytest.mark.parametrize(("target", "appearance"), [(0, "plain"), (1, "plain"), (2, "plain"), (1, "varied")])
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
