"""The log of a training run: a row of measures every so often, as JSON lines, TensorBoard, curves and words; and where
its time goes.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from numpy.typing import ArrayLike
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from cognitivedrone.files import read_regular, replace_file
from cognitivedrone.text.json_text import NotJSON, parse_json
from cognitivedrone.training.trainer.training_task import Batch, Row

METRICS = "metrics.jsonl"
CURVES = "curves.png"
BOARD = "tensorboard"
MAX_METRICS_BYTES = 256 * 2**20
DIMENSIONS = ("vx", "vy", "vz", "yaw_rate")
"""Of an action, as measures name them."""


def by_dimension(tables: Mapping[str, ArrayLike | Tensor]) -> Row:
    """Means of measures (..., 4), by dimension and overall."""
    row: Row = {}
    for name, table in tables.items():
        means = torch.as_tensor(table).double().reshape(-1, len(DIMENSIONS)).mean(0)
        row |= {f"{name} {dimension}": float(mean) for dimension, mean in zip(DIMENSIONS, means, strict=True)}
        row[name] = float(means.mean())
    return row


class RunLog:
    """Writes metrics.jsonl, curves.png and tensorboard/ into the folder of a training run, and a line for people."""

    def __init__(self, out: Path, report: Callable[[str], None], rate: str, headlines: Mapping[str, str]) -> None:
        self._out, self._report = out, report
        self._rate, self._headlines = rate, headlines
        self._board = SummaryWriter(str(out / BOARD))

    def write(self, row: Row) -> None:
        """Take in the measures of row["step"]; rows of that step and later ones, left by a kill, are dropped.

        The line for people has the measure `rate`, such as "steps_per_s", and of `headlines` (names of measures, and
        what to call them) those that are in the row.
        """
        step = row["step"]
        rows = [old for old in read_rows(self._out / METRICS) if old["step"] < step] + [row]
        replace_file(self._out / METRICS, "".join(json.dumps(each) + "\n" for each in rows).encode())
        for name, value in row.items():
            if name != "step":
                self._board.add_scalar(name.replace(" ", "/", 1), value, step)
        self._board.flush()
        shown = [f"{called} {row[name]:.3f}" for name, called in self._headlines.items() if name in row]
        self._report("  ".join([f"step {step}", f"{row[self._rate]:.2f} {self._rate.replace('_per_s', '/s')}", *shown]))
        draw_curves(rows, self._out / CURVES)


def read_rows(path: Path) -> list[Row]:
    """The rows of a metrics file, one JSON object per line; what is no row, such as a truncated line, is skipped."""
    rows = []
    for line in read_regular(path, MAX_METRICS_BYTES).decode().splitlines() if path.exists() else []:
        with suppress(NotJSON):
            row = parse_json(line, non_finite=True)
            if isinstance(row, dict) and type(row.get("step")) is int:
                rows.append(row)
    return rows


def draw_curves(rows: Sequence[Row], path: Path) -> None:
    """Plot the rows of a training run into a PNG: a panel for every kind of measure that they have."""
    import matplotlib as mpl  # takes a second to import

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import MaxNLocator

    present = dict.fromkeys(name for row in rows for name, value in row.items() if value is not None)
    panels = [(title, lines) for title, lines in _panels(list(present)) if lines]
    columns = 2 if len(panels) == 4 else min(len(panels), 3)
    height = -(-len(panels) // columns)
    figure, axes = plt.subplots(
        height, columns, figsize=(5.2 * columns, 4.4 * height), squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(panels) :]:
        axis.remove()
    for axis, (title, lines) in zip(axes.flat, panels, strict=False):
        axis.set_title(title, loc="left", fontsize=11)
        axis.set_xlabel("step")
        axis.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        for number, (name, label) in enumerate(lines.items()):
            style, width = ("k--", 1.2) if name.startswith("baseline") else ("-", 2.4 if number == 0 else 1.2)
            points = [(row["step"], row[name]) for row in rows if row.get(name) is not None]
            marker = "o" if len(points) < 8 else None  # so few are measurements rather than a line
            axis.plot(*zip(*points, strict=True), style, label=label, linewidth=width, marker=marker, markersize=4)
        if title.startswith("loss"):
            axis.set_yscale("log")
        elif title in _SHARES:
            axis.set_ylim(-0.02, 1.02)
        # Below the panel, where it covers no line.
        axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, frameon=False)
    drawn = BytesIO()
    figure.savefig(drawn, dpi=90)
    plt.close(figure)
    replace_file(path, drawn.getvalue())


_LESSON = "the lesson, understood", "understood in training, old and new"
_SHARES = (*_LESSON, "right gate, panels legible", "closed-loop success", "action accuracy (256 tokens)")
_LOSSES = ("heat", "place", "looks", "attributes", "panel_crops", "choice", "text", "action")


def _panels(names: Sequence[str]) -> list[tuple[str, dict[str, str]]]:
    """Titles, and the measures among `names` that belong there, with what to call them."""

    def of(*wanted: tuple[str, str]) -> dict[str, str]:
        return {name: label for name, label in wanted if name in names}

    def each(name: str) -> dict[str, str]:
        parts = ((f"{name} {dimension}", dimension) for dimension in DIMENSIONS)
        return of((name, "overall"), *parts, (f"baseline {name}", "majority token"))

    lesson = ("pictures read", "policy right", "reasoner right")
    losses = of(("train loss", "total"), *((name, name) for name in _LOSSES))
    successes = sorted(name for name in names if name.startswith("success"))
    return [
        ("loss", losses),
        (_LESSON[0], of(*((name, name) for name in lesson))),
        (_LESSON[1], of(*((f"train {name}", name) for name in lesson))),
        ("L1 error, m/s and rad/s", each("l1")),
        ("action accuracy (256 tokens)", each("accuracy") if "cross-entropy" in names else {}),
        ("cross-entropy of actions", each("cross-entropy")),
        (
            "right gate, panels legible",
            of(("choice accuracy", "overall"), ("text accuracy", "from ground-truth panels")),
        ),
        ("closed-loop success", {name: name.removeprefix("success ") or name for name in successes}),
    ]


class Pace:
    """The pace of steps since the first batch, or since the last `begin`.

    A card is still busy with a step when the host waits for the next batch already, so a card's waits are told by its
    own clock.
    """

    def __init__(self, device: torch.device) -> None:
        self._on_card = device.type == "cuda"
        self._waits: list[tuple[Any, Any]] = []
        """Of each, when all work before it was done, and when the batch was there."""
        self._steps, self._since = 0, time.monotonic()

    def begin(self) -> None:
        """Count anew, from now on."""
        self._waits.clear()
        self._steps, self._since = 0, time.monotonic()

    def over(self, batches: Iterable[Batch]) -> Iterator[Batch]:
        """The batches, each for one step. For the first, everything starts: nothing is counted until it is there."""
        done: Any = None
        for batch in batches:
            if done is None:
                self.begin()
            else:
                self._waits.append((done, self._now()))
            self._steps += 1
            yield batch
            done = self._now()

    def measures(self) -> Row:
        """`steps_per_s`, and as `waiting` the share of the time in which the device waited for batches, 0 to 1."""
        if self._on_card:
            torch.cuda.synchronize()
        seconds = max(time.monotonic() - self._since, 1e-9)  # the clock may not have moved
        waited = sum(map(self._between, *zip(*self._waits, strict=True))) if self._waits else 0.0
        return {"steps_per_s": self._steps / seconds, "waiting": min(waited / seconds, 1.0)}

    def _now(self) -> Any:
        if not self._on_card:
            return time.monotonic()
        event = torch.cuda.Event(enable_timing=True)  # type: ignore[no-untyped-call]
        event.record()
        return event

    def _between(self, earlier: Any, later: Any) -> float:
        """Seconds."""
        return float(earlier.elapsed_time(later) / 1e3 if self._on_card else later - earlier)
