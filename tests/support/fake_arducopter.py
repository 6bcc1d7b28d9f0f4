"""Plays an ArduCopter binary: our own vehicle and autopilot, on physics that it asks for step by step over UDP."""

import argparse
import json
import os
import socket
import struct
import sys
from pathlib import Path

import numpy as np

from cognitivedrone.frames import enu_to_ned, flu_to_frd, ned_quaternion
from cognitivedrone.sim.airframe import IRIS
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig, serve
from cognitivedrone.vehicles.sitl.json_interface import LINEAR_THRUST, PWM_HIGH, PWM_LOW

LEAST_SPEED = 6


class Remote(BatchedFlight):
    """Our autopilot at the controls of physics in another process."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(1.0)
        self._port = port
        self._frame = 0
        super().__init__(1, IRIS)

    def _step(self, ticks: int) -> None:
        rates = self._state[10:].copy()
        for _ in range(ticks):
            output = self._ask(pwm(self._autopilot.stabilise(rates)[:, 0] / IRIS.max_thrust))
            rates[:, 0] = flu_to_frd(np.array(output["imu"]["gyro"]))
        self._state[:3, 0] = enu_to_ned(np.array(output["position"]))
        self._state[3:7, 0] = ned_quaternion(np.array(output["quaternion"]))
        self._state[7:10, 0] = enu_to_ned(np.array(output["velocity"]))
        self._state[10:] = rates

    def _ask(self, outputs: list[int]) -> dict:
        self._frame += 1
        packet = struct.pack("<HHI16H", 18458, round(1 / self.TICK_S), self._frame, *outputs, *[0] * 12)
        for _ in range(20):
            self._socket.sendto(packet, ("127.0.0.1", self._port))
            try:
                return json.loads(self._socket.recv(4096))
            except OSError:
                continue
        os._exit(3)


def pwm(share: np.ndarray) -> list[int]:
    """Motor commands, us, for shares of the largest thrust: the plant's curve, backwards."""
    curved = 1 - LINEAR_THRUST
    u = (np.sqrt(LINEAR_THRUST**2 + 4 * curved * share) - LINEAR_THRUST) / (2 * curved)
    return [round(PWM_LOW + (PWM_HIGH - PWM_LOW) * float(command)) for command in u]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    for name in ("model", "instance", "speedup", "defaults"):
        parser.add_argument(f"--{name}")
    options = parser.parse_args()
    if options.model != "JSON:127.0.0.1" or "AHRS_EKF_TYPE 3" not in Path(options.defaults).read_text():
        sys.exit("not started as ArduCopter is")
    print("parameters read", flush=True)
    instance = int(options.instance)
    links = (f"tcpin:127.0.0.1:{5760 + 10 * instance}",)
    simulator = Simulator(airframe=IRIS, render=False)
    simulator.flight = Remote(9002 + 10 * instance)
    with SimulatedVehicle(simulator, VehicleConfig(links=links)) as vehicle:
        serve(vehicle, lambda: False, speed=max(LEAST_SPEED, float(options.speedup)))
