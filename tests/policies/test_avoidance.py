"""Commands are turned away from obstacles that are seen, or were seen; and the packaged policy flies around them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.envs.track_runner import TrackConfig, draw_start
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.labels import load_pack
from cognitivedrone.models.eyes.obstacle_eye import PARTS
from cognitivedrone.policies.avoidance import Avoidance, AvoidanceConfig
from cognitivedrone.policies.small import Small
from cognitivedrone.sim.airframe import RACER
from cognitivedrone.tasks import train_task
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.tasks.families.clutter import KINDS, cluttered
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.types import CONTROL_HZ, Observation

AHEAD = np.array([1.5, 0.0, 0.0, 0.2], np.float32)
STILL = np.zeros(3)
NOTHING = np.zeros((PARTS, PARTS), np.float32)
FAR = np.full((PARTS, PARTS), 5.0, np.float32)


def seen(rows: slice, columns: slice, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """What an eye sees of a thing in these parts of the frame."""
    occupied, far = NOTHING.copy(), FAR.copy()
    occupied[rows, columns] = 0.9
    far[rows, columns] = depth
    return occupied, far


PILLAR = (slice(None), slice(6, 8))  # a little to the left of the middle


def look(avoidance, occupied, depth, velocity, yaw_rate, time):
    avoidance.move(velocity, yaw_rate, time)
    avoidance.see(occupied, depth)


def test_where_nothing_is_seen_commands_stay_as_they_are():
    avoidance = Avoidance()
    look(avoidance, NOTHING, FAR, STILL, 0.0, 0.0)
    assert avoidance.around(AHEAD, STILL, 1.0) is AHEAD


@pytest.mark.parametrize(
    ("columns", "side"), [(slice(5, 8), -1), (slice(8, 11), 1)], ids=["left of the way", "right of the way"]
)
def test_a_pillar_is_passed_on_the_nearer_side(columns, side):
    avoidance = Avoidance()
    look(avoidance, *seen(slice(None), columns, 1.5), STILL, 0.0, 0.0)
    vx, vy, vz, turning = avoidance.around(AHEAD, STILL, 1.0)
    assert vy * side > 0.2
    assert vx > 0.5
    assert abs(vz) < abs(vy)
    assert turning == AHEAD[3]


def test_a_low_wall_across_the_view_is_flown_over():
    avoidance = Avoidance()
    look(avoidance, *seen(slice(9, None), slice(None), 1.5), STILL, 0.0, 0.0)
    assert avoidance.around(AHEAD, STILL, 0.9)[2] > 0.2


def test_what_is_far_away_or_doubtful_does_not_matter():
    avoidance = Avoidance()
    occupied, depth = seen(*PILLAR, 5.0)
    look(avoidance, occupied, depth, STILL, 0.0, 0.0)
    assert avoidance.around(AHEAD, STILL, 1.0) is AHEAD
    look(avoidance, np.minimum(occupied, 0.4), np.minimum(depth, 1.5), STILL, 0.0, 0.1)
    assert avoidance.around(AHEAD, STILL, 1.0) is AHEAD


def test_an_obstacle_beside_the_drone_is_remembered_for_a_while():
    """Seen ahead to the left, then passed: a command to the left would lead into it."""
    config = AvoidanceConfig()
    avoidance, velocity = Avoidance(config), np.array([1.0, 0.0, 0.0])
    look(avoidance, *seen(slice(None), slice(1, 4), 1.0), velocity, 0.0, 0.0)
    for step in range(1, 10):
        look(avoidance, NOTHING, FAR, velocity, 0.0, step / 10)
    left = np.array([0.3, 1.2, 0.0, 0.0], np.float32)
    flown = avoidance.around(left, velocity, 1.0)
    assert flown[1] / flown[0] < left[1] / left[0]  # farther ahead, around it
    look(avoidance, NOTHING, FAR, STILL, 0.0, 0.9 + config.memory_s)
    assert avoidance.around(left, STILL, 1.0) is left


def test_what_is_remembered_turns_with_the_drone():
    """At the right edge of the view first; after a quarter of a turn to the left, to the right and behind."""
    avoidance, turning = Avoidance(), np.pi / 2
    look(avoidance, *seen(slice(None), slice(15, 16), 1.0), STILL, turning, 0.0)
    for step in range(1, 11):
        look(avoidance, NOTHING, FAR, STILL, turning, step / 10)
    there, elsewhere = np.array([-1.0, -1.0, 0.0, 0.0], np.float32), np.array([1.0, -1.0, 0.0, 0.0], np.float32)
    assert avoidance.around(elsewhere, STILL, 1.0) is elsewhere
    assert avoidance.around(there, STILL, 1.0) is not there


def test_a_newer_frame_knows_better_than_memory():
    avoidance = Avoidance()
    look(avoidance, *seen(*PILLAR, 1.5), STILL, 0.0, 0.0)
    look(avoidance, NOTHING, FAR, STILL, 0.0, 0.1)
    assert avoidance.around(AHEAD, STILL, 1.0) is AHEAD


def test_time_that_goes_backwards_is_another_flight():
    avoidance = Avoidance()
    look(avoidance, *seen(slice(None), slice(0, 2), 0.5), STILL, 0.0, 9.0)
    look(avoidance, NOTHING, FAR, STILL, 0.0, 0.0)
    left = np.array([0.0, 1.0, 0.0, 0.0], np.float32)
    assert avoidance.around(left, STILL, 1.0) is left


def test_hovering_stays_hovering():
    avoidance, hover = Avoidance(), np.zeros(4, np.float32)
    look(avoidance, *seen(slice(None), slice(None), 0.5), STILL, 0.0, 0.0)
    assert avoidance.around(hover, STILL, 1.0) is hover


commands = st.lists(st.floats(-2, 2, width=32), min_size=4, max_size=4)


@given(command=commands, height=st.floats(0.1, 3), seed=st.integers(0, 10_000), motion=commands)
def test_whatever_is_seen_no_command_becomes_faster_or_turns_otherwise(command, height, seed, motion):
    rng = np.random.default_rng(seed)
    avoidance = Avoidance()
    for step in range(3):
        occupied, depth = rng.random((PARTS, PARTS)) ** 4, rng.uniform(0.3, 6, (PARTS, PARTS))
        look(avoidance, occupied, depth, np.array(motion[:3]), motion[3], step / 10)
        action = np.array(command, np.float32)
        flown = avoidance.around(action, np.array(motion[:3]), height)
        assert np.isfinite(flown).all()
        assert np.linalg.norm(flown[:3]) <= np.linalg.norm(action[:3]) + 1e-5
        assert flown[3] == action[3]


FLIGHTS = 8


def hits(policy: Small) -> int:
    """How many of the flights touch an obstacle."""
    rng = np.random.default_rng(4)
    touched = 0
    with Worlds(FLIGHTS, load_pack(), TrackConfig(time_limit_s=15.0)) as worlds:
        for world, runner in enumerate(worlds.runners):
            task = cluttered(rng, train_task(int(rng.integers(2**31)), 0), KINDS[world % len(KINDS)], 4)
            runner.begin((task,), rng, draw_start(rng, RACER.hull_radius))
        forks = [policy.fork() for _ in worlds.runners]
        texts = [write_directive(each.stage.gates[right_gate(each.track[0])]) for each in worlds.runners]
        step = 0
        while flying := worlds.flying:
            seen = worlds.observe()
            observations = [
                Observation(
                    seen["image"][world],
                    texts[world],
                    seen["velocity"][world],
                    float(seen["height"][world, 0]),
                    float(seen["yaw_rate"][world, 0]),
                    step / CONTROL_HZ,
                )
                for world in flying
            ]
            answers = policy.act_batch([forks[world] for world in flying], observations)
            worlds.command(np.stack([np.asarray(answer)[0] for answer in answers]), flying)
            touched += sum(result is not None and result.obstacle_m == 0 for result in worlds.advance())
            step += 1
    policy.close()
    return touched


def test_obstacles_are_seen_and_flown_around() -> None:
    assert hits(Small()) <= 1


@pytest.mark.slow
def test_without_its_eye_it_flies_into_them() -> None:
    assert hits(Small(avoid=False)) >= 3
