"""How fast the physics server answers: frames of 1200 Hz in lock-step over a loopback socket, without rendering.

python benchmarks/sitl_speed.py
"""

from __future__ import annotations

import socket
import statistics
import struct
import time

from cognitivedrone.links.sitl import SitlServer

RATE_HZ = 1200
FRAMES = 4000
ROUNDS = 5
PACKET = struct.Struct("<HHI16H")
HOVER = (1500,) * 4 + (0,) * 12


def main() -> None:
    """Print the medians."""
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
    print(f"{1 / (RATE_HZ * statistics.median(wall)):.1f} times real time at {RATE_HZ} Hz")
    print(f"{statistics.median(busy) * 1e6:.0f} us of CPU a frame, the asking side included")


if __name__ == "__main__":
    main()
