"""The small VLA's file: one ONNX graph with its vocabulary, action statistics and provenance.

Contract of the graph; the batch is a dynamic axis, L the description's `text_length`, k its `chunk`:

- inputs `image` uint8 (batch, 256, 256, 3); `state` float32 (batch, 5): velocity x, y, z in the heading frame, m/s,
  height above ground, m, and yaw rate, rad/s; `tokens` int64 (batch, L, TOKEN), as `Lexicon.encode` returns them, or
  (batch, L) in files with a closed `Vocabulary`;
- outputs `action` float32 (batch, k, 4): velocity x, y, z in the heading frame, m/s, and yaw rate, rad/s; `choice`
  float32 (batch, 4): probability of each detected gate, and last of none of those in view; `gates` float32
  (batch, 3, 4): each one's centre u, v in pixels, detection score 0 to 1, and distance in m; and, in files with a
  `Lexicon`, `present` float32 (batch,): probability that one of them is what the sentence asks for.

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
    lexicon_table,
    open_model,
    provenance_of,
    words_of_table,
    write_table,
)
from cognitivedrone.models.text import TOKEN, Lexicon, Vocabulary
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
    vocabulary: Vocabulary | Lexicon
    text_length: int
    """Number of words of a sentence that are read."""
    chunk: int
    """Control steps per inference."""
    action: ActionStatistics
    network: Mapping[str, Any]
    """Configuration of the network."""
    provenance: Provenance
    attributes: tuple[str, ...] = ()
    """Names of the attribute values that it reads of panels; empty in files with a closed vocabulary."""
    image_size: int = IMAGE_SIZE
    """Height and width of the input image, pixels."""

    def table(self) -> dict[str, Any]:
        """The JSON table that is written into the file."""
        return {
            **{name: value for name, value in _table(self).items() if name != "attributes"},
            "facets": self.attributes,
            "action": _table(self.action),
            "network": dict(self.network),
            **lexicon_table(self.vocabulary),
            "provenance": {**_table(self.provenance), "scores": dict(self.provenance.scores)},
        }

    @classmethod
    def of(cls, table: Mapping[str, Any], where: str) -> Description:
        """Read back what `table` gave; raises `ModelError` that says where what is wrong."""
        described = cls(
            name=field_of(table, "name", str, where),
            vocabulary=words_of_table(table, where),
            text_length=count_of(table, "text_length", where),
            image_size=count_of(table, "image_size", where),
            chunk=count_of(table, "chunk", where),
            action=statistics_of(field_of(table, "action", dict, where), where),
            network=field_of(table, "network" if "network" in table else "config", dict, where),
            attributes=tuple(field_of(table, "facets", list, where)) if "facets" in table else (),
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
    present: Float32[Float32Array, images] | None = None
    """(n,) probability that one of them is what the sentence asks for; None of models that cannot tell."""


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
        inputs = {"image": images, "state": states, "tokens": tokens}
        return Output(*self._session.run(_outputs(self.description), inputs))


def _check_input(name: str, array: NDArray[Any], kind: type, shape: tuple[int, ...]) -> None:
    if array.dtype != kind or array.shape != shape:
        raise PolicyError(f"{name} must be {np.dtype(kind)} {shape}, not {array.dtype} {array.shape}")


def _check_graph(session: Any, description: Description, where: str) -> None:
    size = description.image_size
    length = description.text_length
    inputs = {
        "image": ("tensor(uint8)", (size, size, 3)),
        "state": ("tensor(float)", (5,)),
        "tokens": ("tensor(int64)", (length, TOKEN) if isinstance(description.vocabulary, Lexicon) else (length,)),
    }
    shapes: dict[str, tuple[int, ...]] = {
        "action": (description.chunk, 4),
        "choice": (4,),
        "gates": (3, 4),
        "present": (),
    }
    outputs = {name: ("tensor(float)", shapes[name]) for name in _outputs(description)}
    check_graph(session, inputs, outputs, where)


def _outputs(description: Description) -> tuple[str, ...]:
    named = ("action", "choice", "gates")
    return (*named, "present") if isinstance(description.vocabulary, Lexicon) else named


def _table(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in fields(value)}


def statistics_of(table: Mapping[str, Any], where: str) -> ActionStatistics:
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
