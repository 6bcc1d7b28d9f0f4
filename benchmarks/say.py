"""How often `fly` does what a person says: sentences of every kind, each with what a sensible drone does.

Run: python benchmarks/say.py [--only TEXT] [--kind KIND] [--seeds 1] [--out results/say.json]

Flies every sentence of `spoken_sentences.csv` with the packaged pilot, as `fly` does, in simulated time, and prints how
many ended as expected, how many that should have been flown were declined or refused with a reason, and what went
wrong. The kinds from `pilots` on were written by habits other than those that the program was made with, before any of
them was flown. The columns: `said`, what is typed; `then`, what is typed 1.5 s into
the flight, if anything; `outcome`, one of

    fly       through the gate whose panel shows one of `shows`, or, where that is empty, that looks like `gate`
    decline   no gate is flown through: it says that none fits, or that it is unsure, and ends by itself
    refuse    nothing is flown: the command says what it did not understand and ends with exit code 3

`kind` groups the sentences. A sentence that hovers to the time limit never ends as expected.
"""

from __future__ import annotations

import csv
import io
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from cognitivedrone.apps import fly as flying
from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.orders import Orders
from cognitivedrone.apps.values import Summary
from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.errors import NotUnderstood
from cognitivedrone.types import CONTROL_HZ

SENTENCES = Path(__file__).with_name("spoken_sentences.csv")
LIMIT_S = 45.0
TYPED_S = 1.5


@dataclass(frozen=True)
class Config:
    """What to say."""

    only: str = ""
    """Fly only the sentences that contain this."""
    kind: str = ""
    """Fly only the sentences of this kind."""
    seed: int = 0
    seeds: int = 1
    """Number of scenes for each sentence, with seeds from `seed` on."""
    verbose: bool = False
    out: Path | None = None
    """File for the figures."""


class Scripted(Orders):
    """Types a line after so many control steps."""

    def __init__(self, line: str) -> None:
        super().__init__()
        self._line, self._steps = line, 0

    @property
    def given(self) -> tuple[int, str]:
        """As `Orders.given`, which the loop reads at every step."""
        self._steps += 1
        if self._line and self._steps == round(TYPED_S * CONTROL_HZ):
            self.say(self._line)
        return self._given


def happened(row: dict[str, str], seed: int) -> tuple[str, str]:
    """What a sentence led to, as an outcome and in words."""
    shown = io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        plan = FlyPlan.of(
            film=False, instruction=row["said"], seed=seed, out=Path(folder) / "flight", time_limit=LIMIT_S, view=False
        )
        try:
            summary = flying.fly_mission(
                plan, console=Console(file=shown, width=200), keyboard=io.StringIO(), orders=Scripted(row["then"]),
                pace="lockstep",
            )  # fmt: skip
        except NotUnderstood as error:
            return "refuse", str(error)
    scene = next((line for line in shown.getvalue().splitlines() if line.startswith("scene:")), "")
    return _outcome(row, summary), f"{summary.ending.reason} [{summary.seconds:.0f} s; {scene}]"


def _outcome(row: dict[str, str], summary: Summary) -> str:
    """The outcome of a flight; `time` if it hovered or wandered until the end, `crash` for any other end."""
    if summary.ending.kind in ("unsure", "ordered"):
        return "decline" if summary.seconds < LIMIT_S else "time"
    if not summary.results:
        return "time"
    result, task = summary.results[-1], summary.track[len(summary.results) - 1]
    if result.outcome in ("false_alarm", "hesitated") or (result.outcome == "passed" and result.chosen is None):
        return "decline"
    if result.outcome not in ("passed", "wrong_gate") or result.chosen is None:
        return "crash"
    label, gate = task.labels[result.chosen], task.gates[result.chosen]
    shows = row["shows"].split("|")
    looks = {gate.size, gate.color, gate.shape, ("left", "middle", "right")[result.chosen]}
    return "fly" if any(name in label for name in shows) and set(row["gate"].split()) <= looks else "wrong"


def main(config: Config) -> None:
    with SENTENCES.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if config.only in row["said"] and config.kind in ("", row["kind"])]
    good, declined, total = Counter[str](), Counter[str](), Counter[str]()
    for row in rows:
        for seed in range(config.seed, config.seed + config.seeds):
            outcome, words = happened(row, seed)
            ok = outcome == row["outcome"]
            total[row["kind"]] += 1
            good[row["kind"]] += ok
            declined[row["kind"]] += not ok and outcome in ("decline", "refuse")
            if not ok or config.verbose:
                said = " then ".join(repr(row[name]) for name in ("said", "then") if row[name])
                print(f"{'ok' if ok else 'WRONG':6s}{said}: {outcome}, expected {row['outcome']}: {words}", flush=True)
    for kind, count in total.items():
        print(f"{kind:12s} {good[kind]:3d} of {count:3d}, declined {declined[kind]}")
    shares = f"{good.total():3d} of {total.total():3d}, declined {declined.total()}"
    print(f"all          {shares}, {good.total() / max(1, total.total()):.0%}")
    figures: list[dict[str, Any]] = [
        {"kind": kind, "right": good[kind], "declined": declined[kind], "of": count} for kind, count in total.items()
    ]
    keep(config.out, "Sentences that end as expected", figures, seed=config.seed)


if __name__ == "__main__":
    main(tyro.cli(Config))
