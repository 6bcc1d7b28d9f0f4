"""The small VLA's file: one ONNX graph with its vocabulary, action statistics and provenance.

Contract of the graph; the batch is a dynamic axis, L the description's `text_length`, k its `chunk`:

- inputs `image` uint8 (batch, 256, 256, 3); `state` float32 (batch, 5): velocity x, y, z in the heading frame, m/s,
  height above ground, m, and yaw rate, rad/s; `tokens` int64 (batch, L), as `Vocabulary.encode` returns them;
- outputs `action` float32 (batch, k, 4): velocity x, y, z in the heading frame, m/s, and yaw rate, rad/s; `choice`
  float32 (batch, 4): probability of each detected gate, and last of none of those in view; `gates` float32
  (batch, 3, 4): each one's centre u, v in pixels, detection score 0 to 1, and distance in m.

The description is JSON, see `onnx_file`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, PolicyError
from cognitivedrone.models.onnx_file import (
    Provenance,
    check_graph,
    count_of,
    field_of,
    open_model,
    provenance_of,
    vocabulary_of,
    write_table,
)
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.types import IMAGE_SIZE, Float32Array

KIND = "small-vla"

Four = tuple[float, float, float, float]
"""One number for each of velocity x, y, z in m/s and yaw rate in rad/s."""


@dataclass(frozen=True, slots=True)
class ActionStatistics:
    """Statistics of the actions in the training data."""

    low: Four
    """Lowest possible action."""
    high: Four
    """Highest possible action."""
    mean: Four
    std: Four
    q01: Four
    """First percentile."""
    q99: Four
    """Last percentile."""


@dataclass(frozen=True, slots=True)
class Description:
    """The description stored in a model file."""

    name: str
    vocabulary: Vocabulary
    text_length: int
    """Number of words of a sentence that are read."""
    chunk: int
    """Control steps per inference."""
    action: ActionStatistics
    config: Mapping[str, Any]
    """Configuration of the network."""
    provenance: Provenance
    image_size: int = IMAGE_SIZE
    """Height and width of the input image, pixels."""

    def table(self) -> dict[str, Any]:
        """The JSON table that is written into the file."""
        return {
            **_table(self),
            "vocabulary": self.vocabulary.words,
            "action": _table(self.action),
            "config": dict(self.config),
            "provenance": {**_table(self.provenance), "scores": dict(self.provenance.scores)},
        }

    @classmethod
    def of(cls, table: Mapping[str, Any], where: str) -> Description:
        """Read back what `table` gave; raises `ModelError` that says where what is wrong."""
        described = cls(
            name=field_of(table, "name", str, where),
            vocabulary=vocabulary_of(field_of(table, "vocabulary", list, where), where),
            text_length=count_of(table, "text_length", where),
            image_size=count_of(table, "image_size", where),
            chunk=count_of(table, "chunk", where),
            action=_statistics(field_of(table, "action", dict, where), where),
            config=field_of(table, "config", dict, where),
            provenance=provenance_of(table, where),
        )
        if described.image_size != IMAGE_SIZE:
            raise ModelError(f"{where} reads images of {described.image_size} pixels; drones send {IMAGE_SIZE}")
        return described


@dataclass(frozen=True, slots=True)
class Output:
    """The network's output for n frames."""

    action: Float32[Float32Array, "images steps 4"]
    """(n, k, 4), heading frame, m/s and rad/s: for the next k control steps."""
    choice: Float32[Float32Array, "images 4"]
    """(n, 4) probability that each detected gate is the right one; last, that none of them is."""
    gates: Float32[Float32Array, "images 3 4"]
    """(n, 3, 4) for each detected gate: centre u, v in pixels, detection score 0 to 1, distance in m."""


def describe(path: str | Path, description: Description) -> None:
    """Write the description and a checksum into an ONNX file, replacing existing ones.

    Raises `MissingExtra` if the `onnx` package is not installed.
    """
    write_table(path, KIND, description.table())


def read_description(path: str | Path) -> Description:
    """What the model in the file says of itself; raises `ModelError` as `SmallModel.load` does."""
    _, table = open_model(Path(path), KIND, threads=1, optimise=False)
    return Description.of(table, str(path))


class SmallModel:
    """The network, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, description: Description) -> None:
        """Wrap an `onnxruntime.InferenceSession`; `load` creates one from a file."""
        self._session = session
        self.description = description

    @classmethod
    def load(cls, path: str | Path, *, threads: int = 1) -> SmallModel:
        """Load a model file, to be run on `threads` cores.

        Raises `ModelError` where the file is missing, too large, damaged, cut short, or does not keep to the contract.
        """
        session, table = open_model(Path(path), KIND, threads=threads, optimise=True)
        description = Description.of(table, str(path))
        _check_graph(session, description, str(path))
        return cls(session, description)

    def run(self, images: NDArray[np.uint8], states: NDArray[np.float32], texts: Sequence[str]) -> Output:
        """Run the network on n frames (n, 256, 256, 3) with states (n, 5), each with its own sentence.

        Raises `PolicyError` for other shapes or types.
        """
        size = IMAGE_SIZE
        _check_input("images", images, np.uint8, (len(texts), size, size, 3))
        _check_input("states", states, np.float32, (len(texts), 5))
        encode, length = self.description.vocabulary.encode, self.description.text_length
        tokens = np.stack([encode(text, length) for text in texts])
        return Output(
            *self._session.run(("action", "choice", "gates"), {"image": images, "state": states, "tokens": tokens})
        )


def _check_input(name: str, array: NDArray[Any], kind: type, shape: tuple[int, ...]) -> None:
    if array.dtype != kind or array.shape != shape:
        raise PolicyError(f"{name} must be {np.dtype(kind)} {shape}, not {array.dtype} {array.shape}")


def _check_graph(session: Any, description: Description, where: str) -> None:
    size = description.image_size
    inputs = {
        "image": ("tensor(uint8)", (size, size, 3)),
        "state": ("tensor(float)", (5,)),
        "tokens": ("tensor(int64)", (description.text_length,)),
    }
    outputs = {
        "action": ("tensor(float)", (description.chunk, 4)),
        "choice": ("tensor(float)", (4,)),
        "gates": ("tensor(float)", (3, 4)),
    }
    check_graph(session, inputs, outputs, where)


def _table(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in fields(value)}


def _statistics(table: Mapping[str, Any], where: str) -> ActionStatistics:
    """Validated action statistics: a model without them would fly at the wrong speed."""
    columns: dict[str, Four] = {}
    for field in fields(ActionStatistics):
        values = field_of(table, field.name, list, f"{where} (action)")
        if len(values) != 4 or not all(isinstance(value, int | float) and math.isfinite(value) for value in values):
            raise ModelError(
                f"action statistics {field.name!r} in {where} are {values!r:.60}; expected 4 finite numbers"
            )
        columns[field.name] = (float(values[0]), float(values[1]), float(values[2]), float(values[3]))
    if any(low >= high for low, high in zip(columns["low"], columns["high"], strict=True)):
        raise ModelError(
            f"action statistics in {where} have low {columns['low']} and high {columns['high']};"
            " every low must be below its high"
        )
    return ActionStatistics(**columns)
