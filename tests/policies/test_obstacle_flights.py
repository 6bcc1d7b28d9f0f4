"""The packaged policy flies around obstacles that it sees; the same policy without its eye flies into them."""

import numpy as np
import pytest

from cognitivedrone.envs.track_runner import TrackConfig, draw_start
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.labels import load_pack
from cognitivedrone.policies.small import Small
from cognitivedrone.sim.airframe import RACER
from cognitivedrone.tasks import train_task
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.tasks.families.clutter import KINDS, cluttered
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.types import CONTROL_HZ, Observation

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
