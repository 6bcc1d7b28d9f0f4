"""Flights under the real packages of vla-eval and LeRobot, compared with the same flights of `cognitivedrone bench`.

Usage: python benchmarks/harnesses.py [--only vla-eval|lerobot] [--out results/harnesses.json]

Equal flights have the same outcomes, times and path lengths to the last bit; where any differ, the exit status is 1.
A package that is not there is left out. The two may need environments of their own: run it in each with the same
--out, which keeps the rows of the other. Live flights depend on the clock, and are not compared.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import harness_lerobot
import harness_vla_eval

from cognitivedrone import checkout
from cognitivedrone.benchmark.measurements import OUT_HELP, keep, read_measurement

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Part:
    """The checks of one harness."""

    modules: tuple[str, ...]
    """That must be installed."""
    install: str
    rows: Callable[[Path], Iterator[dict[str, Any]]]
    """Measures, with a folder for its files."""

    @property
    def missing(self) -> str | None:
        """The first module that is not installed."""
        return next((module for module in self.modules if find_spec(module) is None), None)


PARTS: Final = {
    "vla-eval": Part(("vla_eval", "uvicorn"), "pip install -e '.[vla-eval,serve]'", harness_vla_eval.rows),
    "lerobot": Part(
        ("lerobot", "lerobot_env_cognitivedrone", "uvicorn"),
        "pip install -e '.[lerobot,serve]' -e lerobot_env_cognitivedrone",
        harness_lerobot.rows,
    ),
}


def chosen(only: str | None, parts: Mapping[str, Part] = PARTS) -> list[str]:
    """The parts that can be measured here; ends the program if there is none, or not the one that is asked for."""
    found = []
    for name in [only] if only else parts:
        if (module := parts[name].missing) is None:
            found.append(name)
        else:
            print(f"{name} is left out: {module} is not installed; {parts[name].install}", file=sys.stderr)
    return found or sys.exit("nothing can be measured here; see above")


def merged(before: Iterable[Row], measured: Sequence[Row], names: Iterable[str]) -> list[Row]:
    """The measured rows of the parts `names`, and those from before of the other parts, in the order of `PARTS`."""
    names = {*names}
    others = [row for row in before if row.get("part") in {*PARTS} - names]
    return sorted([*measured, *others], key=lambda row: [*PARTS].index(row["part"]))


def differ(rows: Iterable[Row]) -> list[str]:
    """What was run in the rows whose flights are not all equal."""
    return [row["what"] for row in rows if row.get("equal", row.get("flights")) != row.get("flights")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    names, measured = chosen(options.only), []
    before = read_measurement(options.out).rows if options.out and options.out.exists() else ()
    facts = {"date": datetime.now(UTC).date().isoformat(), "commit": checkout.commit()}
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            for row in PARTS[name].rows(Path(folder)):
                measured.append({"part": name, **row, **facts})
                print(measured[-1], flush=True)
    what = "Flights under the real packages of vla-eval and LeRobot beside those of bench"
    keep(options.out, what, merged(before, measured, names), seed=0)
    if unequal := differ(measured):
        sys.exit("not equal: " + "; ".join(unequal))


if __name__ == "__main__":
    main()
