"""How fast ArduPilot SITL flies on our physics: the server alone, and a real ArduCopter where ARDUCOPTER names one.

python benchmarks/sitl_speed.py [--out results/sitl_speed.json]

The server alone is asked in lock-step over a loopback socket, at 1200 Hz. ArduCopter is flown by a command ten times a
second of its time, as a benchmark flies it, without rendering and with a 256x256 frame at every command.
"""

from __future__ import annotations

import argparse
import os
import socket
import statistics
import struct
import time
from pathlib import Path

import numpy as np

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.airframe import IRIS
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import CONTROL_HZ
from cognitivedrone.vehicles.simulated import ExternalWorld
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE
from cognitivedrone.vehicles.sitl.flight import SitlFlight
from cognitivedrone.vehicles.sitl.json_interface import SitlServer
from cognitivedrone.vehicles.sitl.session import RenderedView

RATE_HZ = 1200
FRAMES = 4000
ROUNDS = 5
FLOWN_S = 20.0
PACKET = struct.Struct("<HHI16H")
HOVER = (1500,) * 4 + (0,) * 12


def main() -> None:
    """Print the medians."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    out = parser.parse_args().out
    ratio, busy_us = server_alone()
    print(f"the server alone: {ratio:.1f} times real time at {RATE_HZ} Hz")
    print(f"the server alone: {busy_us:.0f} us of CPU a frame, the asking side included")
    binary = os.environ.get(BINARY_VARIABLE)
    if not binary:
        print(f"ArduCopter: not measured; set {BINARY_VARIABLE} to its binary")
        return
    rows = []
    for render, what in ((False, "no rendering"), (True, "a 256x256 frame at every command")):
        rows.append({"what": f"ArduCopter, {what}", "real_time": arducopter(Path(binary), render)})
        print(f"{rows[-1]['what']}: {rows[-1]['real_time']:.1f} times")
    alone = f"the server alone at {RATE_HZ} Hz, over UDP, queried by the same process: {busy_us:.0f} us of CPU a frame"
    keep(
        out,
        "How fast ArduPilot SITL flies on our physics, medians",
        [*rows, {"what": alone, "real_time": ratio}],
        variables=(BINARY_VARIABLE,),
    )


def server_alone() -> tuple[float, float]:
    """How many times real time, and CPU time a frame in us."""
    wall, busy = [], []
    with SitlServer(port=0) as server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.connect(server.address)
        for _ in range(ROUNDS):
            began, used = time.perf_counter(), time.process_time()
            for frame in range(FRAMES):
                autopilot.send(PACKET.pack(18458, RATE_HZ, frame, *HOVER))
                server.poll(1.0)
                autopilot.recv(2048)
            wall.append((time.perf_counter() - began) / FRAMES)
            busy.append((time.process_time() - used) / FRAMES)
    return 1 / (RATE_HZ * statistics.median(wall)), statistics.median(busy) * 1e6


def arducopter(binary: Path, render: bool) -> float:
    """How many times real time an ArduCopter flies to and fro: the median of rounds of `FLOWN_S`."""
    suite = load_suite("open-v1:smoke")
    flight = SitlFlight(binary)
    cameras = Cameras(1)
    world = ExternalWorld(flight, RenderedView(cameras), IRIS.hull_radius)
    try:
        track_runner = TrackRunner(world, load_pack("open-v1"), TrackConfig())
        track_runner.begin(suite.tracks[0], episode_rng(suite.digest, 0, 0))
        ratios = []
        for _ in range(ROUNDS):
            began = time.perf_counter()
            for step in range(round(FLOWN_S * CONTROL_HZ)):
                if render:
                    world.frame()
                world.command(np.array([np.sin(step / 10), 0.0, 0.0, 0.0]))
                world.advance()
            ratios.append(FLOWN_S / (time.perf_counter() - began))
        if flight.report.lost or flight.diverged:
            raise SystemExit(f"not a fair flight: {flight.report}, {flight.trouble}")
        return statistics.median(ratios)
    finally:
        cameras.close()
        flight.close()


if __name__ == "__main__":
    main()
