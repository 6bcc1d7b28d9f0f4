"""The log of a training run: a row of measures every so often: JSON lines, TensorBoard, curves and words."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from cognitivedrone.files import replace_file
from cognitivedrone.training.common.training_task import Row

METRICS = "metrics.jsonl"
CURVES = "curves.png"
DIMENSIONS = ("vx", "vy", "vz", "yaw_rate")
"""Of an action, as measures name them."""


class RunLog:
    """Writes metrics.jsonl, curves.png and tensorboard/ into the folder of a training run, and a line for people."""

    def __init__(self, out: Path, report: Callable[[str], None], rate: str, headlines: Mapping[str, str]) -> None:
        self._out, self._report = out, report
        self._rate, self._headlines = rate, headlines
        self._board = SummaryWriter(str(out / "tensorboard"))

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
        if "l1" in row:
            draw_curves([each for each in rows if "l1" in each], self._out / CURVES)


def read_rows(path: Path) -> list[Row]:
    """The rows of a metrics file, one JSON object per line; a truncated line is skipped."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def draw_curves(rows: Sequence[Row], path: Path) -> None:
    """Plot the rows of a training run into a PNG."""
    import matplotlib as mpl  # takes a second to import

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    panels: tuple[tuple[str, str, str | None], ...] = (
        ("L1 error, m/s and rad/s", "l1", "baseline l1"),
        ("action accuracy (256 tokens)", "accuracy", "baseline accuracy"),
        ("cross-entropy of actions", "cross-entropy", None),
        ("right gate, panels legible", "choice accuracy", None),
        ("losses", "losses", None),
        ("closed-loop success", "success", None),
    )
    if not any(row.get("cross-entropy") is not None for row in rows):  # a regression head has no tokens
        panels = tuple(panel for panel in panels if panel[1] not in ("accuracy", "cross-entropy"))
    columns = len(panels) // 2
    figure, axes = plt.subplots(2, columns, figsize=(5 * columns, 8), constrained_layout=True)
    for axis, (title, name, baseline) in zip(axes.flat, panels, strict=True):
        axis.set_title(title)
        axis.set_xlabel("step")
        axis.grid(alpha=0.3)
        if name == "losses":
            for part in ("heat", "place", "looks", "attributes", "panel_crops", "choice", "text", "action"):
                _line(axis, rows, part, part)
            axis.set_yscale("log")
        elif name == "success":
            for key in sorted({key for row in rows for key in row if key.startswith("success")}):
                _line(axis, rows, key, key.removeprefix("success ") or "all", width=2.5 if key == "success" else 1)
            axis.set_ylim(0, 1.02)
        else:
            _line(axis, rows, name, "overall", width=2.5)
            for dimension in DIMENSIONS:
                _line(axis, rows, f"{name} {dimension}", dimension)
        if name == "choice accuracy":
            _line(axis, rows, "text accuracy", "from ground-truth panels")
        if baseline:
            _line(axis, rows, baseline, "majority token", style="k--")
        if axis.lines:
            axis.legend(fontsize=8)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _line(axis: Any, rows: Sequence[Row], key: str, label: str, *, style: str = "-", width: float = 1) -> None:
    points = [(row["step"], row[key]) for row in rows if row.get(key) is not None]
    if points:
        alone = "o" if len(points) == 1 else None  # a line needs two
        axis.plot(*zip(*points, strict=True), style, label=label, linewidth=width, marker=alone)
