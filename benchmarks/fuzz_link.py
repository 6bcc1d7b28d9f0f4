"""Feed a connection with packets that are none of its vehicle's, and see that nothing but counters change.

    python benchmarks/fuzz_link.py [PACKETS] [SEED]

Random bytes, broken and cut packets, unknown messages, other systems, and somebody who sends as the vehicle from
elsewhere; every twentieth packet is a heartbeat of the vehicle itself. The tests do the same with fewer.
"""

from __future__ import annotations

import random
import resource
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "vehicles"))

from fuzz import BEAT, VEHICLE, connected, packed, strangers
from test_fuzz import held_true


def main(packets: int, seed: int) -> None:
    link, transport = connected()
    before, memory = held_true(link), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.monotonic()
    for number, (packet, peer) in enumerate(strangers(random.Random(seed), packets)):
        if number % 20 == 0:
            transport.feed(packed(BEAT), VEHICLE)
            link.step(0.0)
        transport.feed(packet, peer)
        link.step(0.0)
    link.check()
    same = held_true(link) == before
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
    print(f"{packets} packets in {time.monotonic() - began:.0f} s: {'nothing' if same else 'SOMETHING'} else changed;")
    print(f"{link.traffic.broken} broken, {link.traffic.ignored} of others, memory {grown / 1024:+.1f} MiB")
    link.close()
    sys.exit(not same)


if __name__ == "__main__":
    given = [int(value) for value in sys.argv[1:]]
    main(*given, *(100_000, 0)[len(given) :])
