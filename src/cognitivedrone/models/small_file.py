"""The small VLA's files: a folder with the head that flies, the eyes that it sees by, and its language.

`model.onnx` is the head: one ONNX graph with action statistics and provenance of the whole. Beside it stand `eyes.onnx`
(`eyes.sight`) and, of a policy that reads sentences, `language.onnx` (`mind`). Contract of the head's graph; the batch
is a dynamic axis, k the description's `chunk`:

- inputs `slots` and `whole`, as the eyes give them, and `state` float32 (batch, 5): velocity x, y, z in the heading
  frame, m/s, height above ground, m, and yaw rate, rad/s;
- outputs `options` float32 (batch, 4, k, 4): velocity x, y, z in the heading frame, m/s, and yaw rate, rad/s, toward
  each gate and, last, toward none of those in view; `inclination` float32 (batch, 4): logits by which the head would
  choose among these if nothing were asked for.

The description is JSON, see `onnx_file`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, PolicyError
from cognitivedrone.models.eyes.sight import EYES_FILE, FEATURES, EyesModel, Sight
from cognitivedrone.models.mind import LANGUAGE_FILE, Mind
from cognitivedrone.models.onnx_file import (
    Provenance,
    Tensors,
    check_graph,
    count_of,
    field_of,
    open_model,
    provenance_of,
    texts_of,
    write_table,
)
from cognitivedrone.types import IMAGE_SIZE, Float32Array

KIND = "flight-head"
MODEL_FILE = "model.onnx"
FORMER = {
    "small-vla": "a policy of an earlier kind, which reads sentences by a list of words",
    "small-policy": "a policy of an earlier kind, which sees and flies by one file",
}

STATE = 5
"""Velocity x, y, z (heading frame, m/s), height (m), yaw rate (rad/s)."""
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
    encoder: str
    """Digest of the text encoder that it was trained with; empty if it reads no sentences."""
    chunk: int
    """Control steps per inference."""
    action: ActionStatistics
    network: Mapping[str, Any]
    """Configuration of the network."""
    provenance: Provenance
    attributes: tuple[str, ...] = ()
    """Names of the attribute values that it reads of panels."""
    image_size: int = IMAGE_SIZE
    """Height and width of the input image, pixels."""

    def table(self) -> dict[str, Any]:
        """The JSON table that is written into the file."""
        return {
            **{name: value for name, value in _table(self).items() if name != "attributes"},
            "facets": self.attributes,
            "action": _table(self.action),
            "network": dict(self.network),
            "provenance": {**_table(self.provenance), "scores": dict(self.provenance.scores)},
        }

    @classmethod
    def of(cls, table: Mapping[str, Any], where: str) -> Description:
        """Read back what `table` gave; raises `ModelError` that says where what is wrong."""
        described = cls(
            name=field_of(table, "name", str, where),
            encoder=field_of(table, "encoder", str, where),
            image_size=count_of(table, "image_size", where),
            chunk=count_of(table, "chunk", where),
            action=statistics_of(field_of(table, "action", dict, where), where),
            network=field_of(table, "network", dict, where),
            attributes=texts_of(table, "facets", where),
            provenance=provenance_of(table, where),
        )
        if described.image_size != IMAGE_SIZE:
            raise ModelError(f"{where} reads images of {described.image_size} pixels; drones send {IMAGE_SIZE}")
        return described


@dataclass(frozen=True, slots=True)
class Flown:
    """The head's output for n frames."""

    options: Float32[Float32Array, "images 4 steps 4"]
    """(n, 4, k, 4), heading frame, m/s and rad/s: for the next k control steps, toward each gate and toward none."""
    inclination: Float32[Float32Array, "images 4"]
    """(n, 4) logits of these."""


def describe(path: str | Path, description: Description) -> None:
    """Write the description and a checksum into an ONNX file, replacing existing ones.

    Raises `MissingExtra` if the `onnx` package is not installed.
    """
    write_table(path, KIND, description.table())


def read_description(path: str | Path) -> Description:
    """What the model in the file says of itself; raises `ModelError` as `SmallModel.load` does."""
    _, table = open_model(Path(path), KIND, threads=1, optimise=False, former=FORMER)
    return Description.of(table, str(path))


class SmallModel:
    """Eyes, mind and head of a policy, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, description: Description, eyes: EyesModel, mind: Mind | None) -> None:
        """`session` runs the head; `load` creates one from a file."""
        self._session = session
        self.description = description
        self.eyes = eyes
        self.mind = mind
        """None of a model that reads no sentences."""

    @classmethod
    def load(cls, path: str | Path, *, threads: int = 1) -> SmallModel:
        """Load a head, to be run on `threads` cores, with eyes and language beside it, which a reasoner shares.

        Raises `ModelError` where a file is missing, too large, damaged, cut short, does not keep to the contract, or
        where the files do not belong together.
        """
        path = Path(path)
        session, table = open_model(path, KIND, threads=threads, optimise=True, former=FORMER)
        description = Description.of(table, str(path))
        eyes = EyesModel.of(beside(path, EYES_FILE), threads=threads)
        inputs: Tensors = {
            "slots": ("tensor(float)", (3, eyes.width + FEATURES)),
            "whole": ("tensor(float)", (eyes.width,)),
            "state": ("tensor(float)", (STATE,)),
        }
        outputs: Tensors = {
            "options": ("tensor(float)", (4, description.chunk, 4)),
            "inclination": ("tensor(float)", (4,)),
        }
        check_graph(session, inputs, outputs, str(path))
        mind = Mind.of(beside(path, LANGUAGE_FILE), threads=threads) if description.encoder else None
        if mind is not None and not (
            mind.encoder.digest == description.encoder
            and mind.attributes.names == eyes.attributes.names == description.attributes
        ):
            raise ModelError(f"{path}, {EYES_FILE}, {LANGUAGE_FILE} do not belong together; take all from one folder")
        return cls(session, description, eyes, mind)

    @property
    def words(self) -> frozenset[str]:
        """The words that its text encoder knows whole; empty if it reads no sentences."""
        pieces = () if self.mind is None else self.mind.encoder.pieces.known
        return frozenset(piece for piece in pieces if piece.isalpha())

    def fly(self, sight: Sight, states: NDArray[np.float32]) -> Flown:
        """The head's output for what n frames show, with states (n, 5). Raises `PolicyError` for other shapes."""
        shape = (len(sight.whole), STATE)
        if states.dtype != np.float32 or states.shape != shape:
            raise PolicyError(f"states must be float32 {shape}, not {states.dtype} {states.shape}")
        inputs = {"slots": sight.slots, "whole": sight.whole, "state": states}
        return Flown(*self._session.run(("options", "inclination"), inputs))


def beside(model: Path, name: str) -> Path:
    """A file of the same folder; raises `ModelError` where there is none."""
    path = model.with_name(name)
    if not path.is_file():
        raise ModelError(f"{name} is missing beside {model}: a model flies with all files of its training's folder")
    return path


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
