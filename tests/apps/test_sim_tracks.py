"""The simulator as a vehicle in a track: the next stage is behind the gate that it flies through."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from cognitivedrone.apps.vehicle import leading
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import load_suite
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig
from cognitivedrone.world.geometry import gate_centers, gate_yaws

MISSION = load_suite("open-v3:missions").tracks[5]
"""A gate, then a landing."""


def test_it_leads_through_a_mission_and_judges_nothing_else():
    simulator = Simulator(1, render=False)
    runner = TrackRunner(simulator.world(0), load_pack(), TrackConfig(time_limit_s=math.inf))
    runner.begin(MISSION, np.random.default_rng(0))
    with SimulatedVehicle(simulator, VehicleConfig(links=("tcpin:127.0.0.1:0",)), leading(runner)) as vehicle:
        vehicle.step(20)
        assert runner.index == 0, "it stands on the floor, which ends no stage"
        center, yaw = gate_centers(runner.stage)[2], float(gate_yaws(runner.stage)[2])
        for before_m in (-0.3, 0.05):
            assert runner.index == 0
            simulator.flight.reset(0, center + before_m * np.array([math.cos(yaw), math.sin(yaw), 0.0]), yaw)
            vehicle.step()
        assert runner.index == 1
        assert runner.stage.landing
        vehicle.step(500)
        assert vehicle.state().position[2] < 0.3
    simulator.close()
    assert not runner.finished, "the last stage goes on"
