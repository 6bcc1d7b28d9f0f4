"""Plays an ArduCopter binary: asks for physics in lock-step, and answers MAVLink at the port of its instance."""

from __future__ import annotations

import argparse
import socket
import struct
import sys
import threading
from pathlib import Path

from cognitivedrone.links.vehicle import SimulatedVehicle, VehicleConfig, serve
from cognitivedrone.sim.simulator import Simulator

RATE_HZ, SPEED = 200, 6


def ask_for_physics(instance: int) -> None:
    stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stream.settimeout(1.0)
    pace = threading.Event()
    for frame in range(1, 1_000_000):
        stream.sendto(struct.pack("<HHI16H", 18458, RATE_HZ, frame, *[1000] * 16), ("127.0.0.1", 9002 + 10 * instance))
        try:
            stream.recv(4096)
        except OSError:
            return
        pace.wait(1 / RATE_HZ / SPEED)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    for name in ("model", "instance", "defaults"):
        parser.add_argument(f"--{name}")
    options = parser.parse_args()
    if options.model != "JSON:127.0.0.1" or "AHRS_EKF_TYPE 3" not in Path(options.defaults).read_text():
        sys.exit("not started as ArduCopter is")
    print("parameters read", flush=True)
    instance = int(options.instance)
    threading.Thread(target=ask_for_physics, args=(instance,), daemon=True).start()
    links = (f"tcpin:127.0.0.1:{5760 + 10 * instance}",)
    with SimulatedVehicle(Simulator(render=False), VehicleConfig(links=links)) as vehicle:
        serve(vehicle, lambda: False, speed=SPEED)
