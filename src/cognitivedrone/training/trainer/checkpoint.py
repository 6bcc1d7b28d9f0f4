"""What a training run leaves in its folder: checkpoints, and a log of measures.

A checkpoint is one file without pickle: tensors as safetensors, the rest as JSON in its header. The log is a row of
measures every so often, as JSON lines, TensorBoard, curves and words, and says where the time goes.
"""

from __future__ import annotations

import json
import mmap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from numpy.typing import ArrayLike
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.utils.tensorboard import SummaryWriter

from cognitivedrone.errors import TrainingError
from cognitivedrone.files import check_regular, open_regular, read_regular, reason_of, replace_file, replacing
from cognitivedrone.files.schema import check_form
from cognitivedrone.models.onnx_file import BLANK, Finding, check, seal
from cognitivedrone.text.json_text import NotJSON, parse_json
from cognitivedrone.text.printable import visible
from cognitivedrone.training.trainer.training_task import Batch, Row

CHECKPOINT = "checkpoint.safetensors"
"""Name of the file in the folder of a run."""
FORMAT = 1
_KEY = "cognitivedrone"
_ANEW = "take an earlier checkpoint, or train anew in another folder"
MOMENTS = {"step": True, "exp_avg": False, "exp_avg_sq": True}
"""What AdamW has of each weight, and whether it is never below 0."""


def save_checkpoint(
    path: Path, network: nn.Module, optimizer: torch.optim.Optimizer | None, facts: dict[str, Any]
) -> None:
    """Write the network, the optimiser's state if given, and `facts` (JSON values), atomically."""
    tensors = {f"network.{name}": tensor for name, tensor in network.state_dict().items()}
    if optimizer is not None:
        for number, state in optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{number}.{name}": value for name, value in state.items()}
    whole = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    with replacing(path) as beside:
        save_file(whole, beside, metadata={_KEY: json.dumps({"format": FORMAT, **facts}), "checksum": BLANK})
        seal(beside)


def read_checkpoint(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """All tensors by name, and the facts.

    Raises `TrainingError` for an incomplete file, one of another format, or one that does not match its checksum; older
    files have no checksum.
    """
    try:
        check_regular(path)
        finding = _finding(path)
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            if finding == "damaged" or (finding == "unknown" and "checksum" in metadata):
                raise TrainingError(
                    f"{path}: not a whole checkpoint (it does not match its checksum); delete it or take an earlier one"
                )
            facts = parse_json(metadata[_KEY])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a mapping)
    except FileNotFoundError:
        raise TrainingError(f"{path}: no such checkpoint") from None
    except OSError as error:
        reason = reason_of(error)
        raise TrainingError(f"{path}: not a whole checkpoint ({reason}); delete it or take an earlier one") from None
    except SafetensorError as error:
        raise TrainingError(f"{path}: not a whole checkpoint ({error}); delete it or take an earlier one") from None
    except (KeyError, TypeError, ValueError):
        raise TrainingError(f"{path}: a safetensors file, but not a checkpoint of this project") from None
    if not isinstance(facts, dict) or facts.get("format") != FORMAT or isinstance(facts["format"], bool):
        found = facts.get("format") if isinstance(facts, dict) else "unknown"
        raise TrainingError(f"{path}: checkpoint of format {found}; this version reads {FORMAT}")
    check_form(_Facts, facts, f"{path}: ", TrainingError)
    return tensors, facts


@dataclass(frozen=True, slots=True)
class _Facts:
    """What every checkpoint says."""

    step: int


def _finding(path: Path) -> Finding:
    if not path.stat().st_size:
        return "unknown"  # safetensors reports the error of an empty file
    with open_regular(path) as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return check(content)


def restore(tensors: dict[str, Tensor], network: nn.Module, optimizer: torch.optim.Optimizer | None) -> None:
    """Restore a network and an AdamW of the same shapes from the result of `read_checkpoint`.

    Raises `TrainingError` for another network, and for a state that such an optimiser cannot have.
    """
    own = {name.removeprefix("network."): value for name, value in tensors.items() if name.startswith("network.")}
    try:
        network.load_state_dict(own)
    except RuntimeError as error:
        raise TrainingError(f"the checkpoint is of another network: {str(error).splitlines()[-1].strip()}") from None
    if optimizer is None:
        return
    weights = [weight for group in optimizer.param_groups for weight in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, number, key = (*name.split(".", 2), "", "")[:3]
            if not (number.isdecimal() and number.isascii() and len(number) < 10 and int(number) < len(weights)):
                raise TrainingError(f"the checkpoint has {visible(name)!r}, which is of no weight; {_ANEW}")
            state.setdefault(int(number), {})[key] = value
    for index, moments in state.items():
        check_moments(f"optimizer.{index}", weights[index], moments)
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
    # Fused optimisers iterate over memory, so moments need the same layout as their weights: channels last, for some.
    for parameter, moments in optimizer.state.items():
        for key, value in moments.items():
            if value.shape == parameter.shape:
                moments[key] = torch.empty_like(parameter, requires_grad=False).copy_(value)


def check_moments(where: str, weight: Tensor, moments: dict[str, Tensor]) -> None:
    """Raise `TrainingError` for what AdamW cannot have of a weight: one step with it would spoil the network."""
    if moments.keys() != MOMENTS.keys():
        found = ", ".join(visible(key) or "a nameless tensor" for key in sorted(moments))
        raise TrainingError(f"the checkpoint's {where} has {found}, not {', '.join(MOMENTS)}; {_ANEW}")
    for key, value in moments.items():
        shape = () if key == "step" else weight.shape
        if value.shape != shape or not value.is_floating_point():
            raise TrainingError(
                f"the checkpoint's {where}.{key} is {tuple(value.shape)} of {value.dtype}, not {tuple(shape)} of"
                f" floats; {_ANEW}"
            )
        if not bool(torch.isfinite(value).all()) or (MOMENTS[key] and bool((value < 0).any())):
            raise TrainingError(f"the checkpoint's {where}.{key} has impossible numbers; {_ANEW}")


def step_of(facts: Mapping[str, Any], last: int) -> int:
    """The step that a checkpoint was written at, at most `last`; raises `TrainingError` if that cannot be."""
    step = facts.get("step")
    if not isinstance(step, int) or isinstance(step, bool) or not 0 <= step <= last:
        raise TrainingError(f"the checkpoint is of step {str(step)[:20]!r}, not one from 0 to {last}; {_ANEW}")
    return step


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
