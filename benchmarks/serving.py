"""What serving costs: round trips, the server's overhead, batches against one by one, and memory under load.

Run: python benchmarks/serving.py [--out results/serving.json]
         round trips, overhead and throughput
     python benchmarks/serving.py --load 3600 [--out results/serving_load.json]
         load by 8 clients for so many seconds, or --requests of them

Round trips are those of one 256x256 image over loopback to a server in a process of its own, less the policy's time
as the server tells it. They are taken with one client, and with 8 that fly at 10 Hz. The overhead is what the server
needs of its processor for a request, which does not depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import numpy as np
from served import cpu_s, memory_mb, server_process
from websockets.sync.client import connect

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.policies.small import Small
from cognitivedrone.remote.messages import LARGEST_BYTES, pack, unpack
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, EpisodeContext, Observation

CLIENTS, SESSIONS = 8, 16
TEXT = "Fly through the gate with the number equal to 3 * 3"
REPORTED = 20
"""Lines of memory that a load prints."""


def message(seed: int = 0) -> bytes:
    """An observation as openpi's client sends it."""
    image = np.random.default_rng(seed).integers(0, 256, (IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
    return pack({"observation/image": image, "observation/state": np.zeros(5, np.float32), "prompt": TEXT})


def fly(port: int, requests: int, hz: float, seed: int) -> list[tuple[float, float, float]]:
    """Some requests of one client: round trip, the policy's own time, and the server's for the previous one, ms.

    `hz` 0 sends each as soon as the last is answered.
    """
    data, measured = message(seed), []
    with connect(f"ws://127.0.0.1:{port}", compression=None, max_size=LARGEST_BYTES, proxy=None) as socket:
        socket.recv()
        begin = time.perf_counter() + seed / CLIENTS / CONTROL_HZ
        for request in range(requests):
            if hz:
                time.sleep(max(0.0, begin + request / hz - time.perf_counter()))
            sent = time.perf_counter()
            socket.send(data)
            answer = unpack(bytes(socket.recv(decode=False)))
            took = 1e3 * (time.perf_counter() - sent)
            timing = answer["server_timing"]
            own = timing["infer_ms"] + timing["wait_ms"]
            measured.append((took, own, timing.get("prev_total_ms", np.nan)))
    return measured


def round_trips(pool: Pool, policy: str, clients: int, requests: int) -> dict[str, Any]:
    """The round trips of some clients at the control rate, and the server's processor time, also printed."""
    with server_process("--policy", policy) as (port, process):
        fly(port, 20, 0, 0)
        before = cpu_s(process.pid)
        jobs = [pool.apply_async(fly, (port, requests, CONTROL_HZ, seed)) for seed in range(clients)]
        found = [job.get() for job in jobs]
        used_ms = 1e3 * (cpu_s(process.pid) - before) / (clients * requests)
    took, own, _ = np.concatenate([np.array(each)[5:] for each in found]).T
    # The server tells the time of a request in the answer to the next.
    inside = np.concatenate([np.array(each)[6:, 2] - np.array(each)[5:-1, 1] for each in found])
    beyond_ms = np.percentile(took - own, [50, 99])
    inside_ms = float(np.median(inside))
    print(
        f"{policy:8} {clients} client{'s' if clients > 1 else ' '}  over the policy's own time"
        f" {beyond_ms[0]:6.2f} ms p50 {beyond_ms[1]:7.2f} ms p99;"
        f"  in the server {inside_ms:5.2f} ms p50;  its processor {used_ms:5.2f} ms per request"
    )
    return {
        "policy": policy,
        "clients": clients,
        "requests": clients * requests,
        "beyond_ms": [round(float(each), 3) for each in beyond_ms],
        "server_ms": round(inside_ms, 3),
        "cpu_ms": round(used_ms, 3),
    }


def throughput(repetitions: int) -> list[dict[str, Any]]:
    """Frames per second of 16 sessions one by one, together to the bit, and stacked, also printed."""
    rng = np.random.default_rng(0)
    seen = [
        Observation(frame, TEXT, np.zeros(3, np.float32), 0.8, 0.0, 0.0)
        for frame in rng.integers(0, 256, (SESSIONS, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
    ]
    exact, stacked = Small(), Small(stack=SESSIONS)
    forks = [exact.fork() for _ in seen]
    for fork in forks:
        fork.reset(EpisodeContext(TEXT))
    ways: dict[str, Callable[[], Any]] = {
        "one by one, one core": lambda: [fork.act(one) for fork, one in zip(forks, seen, strict=True)],
        "act_batch, to the bit": lambda: exact.act_batch(forks, seen),
        f"act_batch, stack={SESSIONS}": lambda: stacked.act_batch(forks, seen),
    }
    # The ways take turns, so that whatever else the machine does is the same for all.
    times: dict[str, list[float]] = {name: [] for name in ways}
    for repetition in range(repetitions + 1):
        for name, run in ways.items():
            begin = time.perf_counter()
            run()
            if repetition:
                times[name].append(time.perf_counter() - begin)
    first = np.array(times["one by one, one core"])
    rows = []
    for name, taken in times.items():
        rate, ratio = float(SESSIONS / np.median(taken)), float(np.median(first / np.array(taken)))
        print(f"small, {SESSIONS} sessions: {name:24} {rate:7.1f} frames/s  {ratio:5.2f} x")
        rows.append({"sessions": SESSIONS, "way": name, "frames_per_s": round(rate, 1), "ratio": round(ratio, 2)})
    exact.close()
    stacked.close()
    return rows


def load(pool: Pool, policy: str, seconds: float, requests: int) -> dict[str, Any]:
    """The server's memory while clients send as fast as they can, also printed."""
    batch = 500
    with server_process("--policy", policy, "--rate", "100000") as (port, process):
        begin, sent, marks = time.monotonic(), 0, list[tuple[int, float]]()
        share = max(seconds / REPORTED, 1.0)
        while (passed := time.monotonic() - begin) < seconds and sent < requests:
            for job in [pool.apply_async(fly, (port, batch, 0, seed)) for seed in range(CLIENTS)]:
                sent += len(job.get())
            if not marks or passed >= len(marks) * share or sent >= requests:
                marks.append((sent, memory_mb(process.pid)))
                print(f"{passed:7.0f} s {sent:9d} requests  {marks[-1][1]:7.1f} MB", flush=True)
        took = time.monotonic() - begin
    tenth = next(memory for count, memory in marks if count >= sent / 10)
    grown = marks[-1][1] / tenth - 1
    print(f"{sent} requests in {took:.0f} s, {sent / took:.0f} per second; memory {grown:+.1%} since the first tenth")
    return {
        "policy": policy,
        "clients": CLIENTS,
        "minutes": round(took / 60, 1),
        "requests": sent,
        "per_s": round(sent / took, 1),
        "memory_mb": round(marks[-1][1], 1),
        "grown": round(grown, 4),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--load", type=float, default=0.0, metavar="SECONDS")
    parser.add_argument("--requests", type=int, default=1_000_000)
    parser.add_argument("--policy", default="hover", help="of the load")
    parser.add_argument("--samples", type=int, default=300, help="requests of each client")
    parser.add_argument("--repetitions", type=int, default=20)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    arguments = parser.parse_args()
    print(f"{len(os.sched_getaffinity(0))} cores, load average {os.getloadavg()[0]:.1f}")
    with multiprocessing.get_context("spawn").Pool(CLIENTS) as pool:
        if arguments.load:
            row = load(pool, arguments.policy, arguments.load, arguments.requests)
            keep(arguments.out, "A policy server under load, over loopback", [row], seed=0)
            return
        rows = [
            round_trips(pool, policy, clients, arguments.samples)
            for policy in ("hover", "small")
            for clients in (1, CLIENTS)
        ]
    rows += throughput(arguments.repetitions)
    keep(arguments.out, "What serving costs, over loopback, 256x256 images", rows, seed=0)


if __name__ == "__main__":
    main()
