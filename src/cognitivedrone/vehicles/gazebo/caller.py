"""The program behind `services.ServiceProcess`: calls services of a running Gazebo.

python -m cognitivedrone.vehicles.gazebo.caller harmonic    # a call per line of its input, a reply per line
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator

from cognitivedrone.text.json_text import parse_json
from cognitivedrone.vehicles.gazebo.bindings import load_bindings


def replies(release: str, calls: Iterable[str]) -> Iterator[str]:
    """The reply to each call, as lines of JSON: a message in hexadecimal digits, or null."""
    bindings = load_bindings(release)
    node = bindings.new_node()
    for call in calls:
        service, data, asks, answers, timeout_ms = parse_json(call)
        kind = bindings.message(asks)
        request = kind()
        request.ParseFromString(bytes.fromhex(data))
        delivered, reply = node.request(service, request, kind, bindings.message(answers), timeout_ms)
        yield json.dumps(reply.SerializeToString().hex() if delivered else None)


def main() -> None:
    """Answer calls until the input ends."""
    # gz-transport prints complaints to the standard output; only replies may go there.
    with os.fdopen(os.dup(sys.stdout.fileno()), "w") as out:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        for reply in replies(sys.argv[1], sys.stdin):
            print(reply, file=out, flush=True)


if __name__ == "__main__":
    main()
