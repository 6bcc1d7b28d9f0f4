"""Every command of the program, run for real and small, in one folder, in an order in which later ones read the files
of earlier ones. Processes start as the installed command does: with the folder of a script on the path.
"""

import os
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from waiting import free_port, soon

ROOT = Path(__file__).resolve().parents[2]
SMALL = "--suite open-v1:smoke --policy hover --workers 1 --episodes 2"
COMMANDS = f"""
--version
--help
bench --help
data
nonsense
bench --nonsense 1
list
bench {SMALL} --clips 1 --out a
bench {SMALL} --clips 0 --reasoner small --policy small --out b
bench --suite open-v1:smoke --policy hover --workers 2 --shard 1/30 --out part-1
merge part-1 --out whole
compare a b
view --out view.png
film a --episode 1
submit a --name mine --by me --out mine.json
verify {ROOT}/leaderboard/race.json --sample 1
reason --suite open-v1:smoke --reasoner small --episodes 2 --out reason
sweep {SMALL} --ms 0 --out sweep
doctor --policy small
audit --suite open-v1:smoke --policy hover --episodes 1 --only wind --workers 1 --out audit
fly --policy hover --reasoner none --suite open-v1:smoke --episode 0 --time-limit 1 --out fly
fly --link mavlink:udp:127.0.0.1:9 "Fly through the red gate"
sim --mavlink --links tcpin:127.0.0.1:PORT
gazebo export --task open-v1:smoke/0000 --out world
gazebo check world/nothing.sdf
predict --flights nowhere
serve --policy small --port PORT
play --port PORT --no-browser --out play
collect --recipe debug --episodes 2 --workers 1 --out set
data show set
data report set --out card.html
data verify set
data export set --to lerobot --out lerobot
data import lerobot --from lerobot --out again
data replay set 0
hub push set me/set --dry-run
hub pull me/set pulled
train-openvla --base nowhere --data set --out 7b
""".strip().splitlines()
TRAIN = "train --recipe debug --steps 1 --out trained"
LIMIT_S = 3600.0  # of a machine that is busy with other things


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    line: str
    code: int
    output: str

    @property
    def clean(self) -> bool:
        """Whether it ended as it should, and not in a traceback."""
        return self.code in (0, 1, 2, 130) and "Traceback" not in self.output


def run_all(
    folder: Path, environment: Mapping[str, str], *, lines: list[str], redirect: str = "", before: tuple[str, ...] = ()
) -> list[Ended]:
    """Run commands in the folder; `redirect` as in a shell; `before` is put before each. Output goes to a file."""
    start = folder.parent / f"{folder.name}-script" / "cognitivedrone"
    start.parent.mkdir(exist_ok=True)
    start.write_text("from cognitivedrone.cli import main\nif __name__ == '__main__':\n    main()\n")
    return [_run([*before, sys.executable, str(start)], line, folder, environment, redirect) for line in lines]


def _run(start: list[str], line: str, folder: Path, environment: Mapping[str, str], redirect: str) -> Ended:
    port = free_port()
    words = [*start, *shlex.split(line.replace("PORT", str(port)))]
    output = folder.parent / f"{folder.name}-said"
    with output.open("wb") as file:
        process = subprocess.Popen(
            ["/bin/sh", "-c", f'exec "$@" {redirect}', "sh", *words],
            cwd=folder, env=dict(environment), stdin=subprocess.DEVNULL, stdout=file, stderr=file,
            start_new_session=True,
        )  # fmt: skip
        if "PORT" in line:
            soon(lambda: process.poll() is not None or _answers(port), LIMIT_S)
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
        code = process.wait(LIMIT_S)
    return Ended(line, code, output.read_text(encoding="utf-8", errors="replace"))


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1).close()
    except OSError:
        return False
    return True


def environment_of(home: Path, **more: str) -> dict[str, str]:
    """A plain environment with a home of its own, as cron starts programs with."""
    kept = {name: os.environ[name] for name in ("PATH", "TMPDIR", "LD_LIBRARY_PATH") if name in os.environ}
    return {**kept, "HOME": str(home), "ARDUCOPTER": "", "HF_ENDPOINT": "http://127.0.0.1:9", **more}
