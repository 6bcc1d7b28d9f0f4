"""The flights of `vla-eval run` with the example's configuration: step by step, and live."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from harness_flights import SERVE, Flight, bench, compared, ends, flight, listening, run, versions_of

RUN = ("vla-eval", "run", "--config", "examples/vla_eval.yaml")
SERVER = ("python", "-m", "cognitivedrone.integrations.vla_eval")
FEW = 4
"""Tracks that are flown through two servers."""


def rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Measured with the policy `small`: in the model server itself, and behind a policy server of ours."""
    ours = bench(folder / "bench", "--policy", "small")
    yield from _flown(folder / "own", "small", "small", ours)
    with listening(folder / "serve.log", *SERVE, "--policy", "small") as address:
        few = ("--benchmark-field", f"max_tasks={FEW}")
        name = f"remote:ws://{address}"
        yield from _flown(folder / "remote", name, "remote:ws://...", ours[:FEW], *few)


def _flown(folder: Path, policy: str, shown: str, ours: Sequence[Flight], *options: str) -> Iterator[dict[str, Any]]:
    """One row for every benchmark of the configuration."""
    folder.mkdir()
    with listening(folder / "server.log", *SERVER, f"--args.policy={policy}", "--address=127.0.0.1:{port}") as address:
        said = run(*RUN, *options, "--server-url", f"ws://{address}", "--output-dir", str(folder))
    behind = " and `cognitivedrone serve --policy small`" if shown != policy else ""
    what = f"`{' '.join([*RUN, *options])}` against `{' '.join(SERVER)} --args.policy={shown}`{behind}"
    paths = sorted(folder.glob("*_aggregate.json"))
    if not paths:
        sys.exit(f"{said[-4000:]}\n{RUN[0]} kept no results; see above")
    for path in paths:
        told = json.loads(path.read_text(encoding="utf-8"))
        theirs = [
            flight(episode["episode"], episode["metrics"].get("stages", ()))
            for task in told["tasks"]
            for episode in task["episodes"]
        ]
        figures = compared(theirs, ours)
        if told["mode"] == "live":
            del figures["equal"]
            held = [int(share) for share in re.findall(r"\bstale=(\d+)%", said)]
            remarks = f"{min(held)} to {max(held)} % of the steps of a flight held" if held else ""
        else:
            remarks = ends(theirs)
        yield {
            "what": f"{what}, mode `{told['mode']}`",
            "versions": versions_of("vla-eval"),
            **figures,
            "remarks": remarks,
        }
