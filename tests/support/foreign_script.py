"""What is run on a foreign system, one after the other in one interpreter: `foreign_script.py PORT LINE ...`.

A line is a command, or the name of a function below. Standard output gets a line of JSON for each: how it ended.
"""

import json
import os
import signal
import socket
import sys
import threading
import time
from contextlib import redirect_stdout, suppress

from cognitivedrone.cli import main


def command(line: str) -> int:
    """Run a command; its exit code."""
    sys.argv = ["cognitivedrone", *line.split()]
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def evaluate() -> None:
    """Score a policy from Python."""
    import cognitivedrone

    assert len(cognitivedrone.evaluate("oracle", episodes=1, workers=0, progress=False).results.episodes) == 1


def make_vec() -> None:
    """Step two worlds."""
    import gymnasium

    import cognitivedrone.envs as envs

    assert envs
    worlds = gymnasium.make_vec("CognitiveDrone-v1", num_envs=2, suite="open-v1:smoke")
    worlds.reset(seed=0)
    worlds.step(worlds.action_space.sample())
    worlds.close()


def serve() -> int:
    """Serve a policy, fly it as a client, and end the server by Ctrl-C."""
    codes = []

    def fly() -> None:
        while True:
            with suppress(OSError), socket.create_connection(("127.0.0.1", PORT), 1):
                break
            time.sleep(0.05)
        client = f"bench --policy remote:ws://127.0.0.1:{PORT} --workers 0 --episodes 1 --clips 0 --out remote"
        codes.append(command(client))
        os.kill(os.getpid(), signal.SIGINT)

    client = threading.Thread(target=fly)
    client.start()
    served = command(f"serve --policy colour_seeker --port {PORT}")
    client.join()
    return codes[0] or (0 if served in (0, 130) else served)


if __name__ == "__main__":
    PORT, said = int(sys.argv[1]), sys.stdout
    for each in sys.argv[2:]:
        began = time.perf_counter()
        with redirect_stdout(sys.stderr):
            code = globals()[each]() or 0 if each in ("evaluate", "make_vec", "serve") else command(each)
        print(json.dumps([each, code, time.perf_counter() - began]), file=said, flush=True)
