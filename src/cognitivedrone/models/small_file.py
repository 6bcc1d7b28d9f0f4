"""The small VLA's file: one ONNX graph with its attribute values, action statistics and provenance.

Contract of the graph; the batch is a dynamic axis, k the description's `chunk`:

- inputs `image` uint8 (batch, 256, 256, 3); `state` float32 (batch, 5): velocity x, y, z in the heading frame, m/s,
  height above ground, m, and yaw rate, rad/s; of a policy that reads sentences, `words` float32 (batch, L, W), as the
  text encoder that the description names gives them (`text_encoder`); and, of one that asks the picture classifier,
  `opinions` float32 (batch, 3, T) and `paper` float32 (batch, 3) (`opinions`);
- outputs `action` float32 (batch, k, 4): velocity x, y, z in the heading frame, m/s, and yaw rate, rad/s; `choice`
  float32 (batch, 4): probability of each detected gate, and last of none of those in view; `gates` float32
  (batch, 3, 4): each one's centre u, v in pixels, detection score 0 to 1, and distance in m; of a policy that reads
  sentences, `present` float32 (batch,): probability that one of them is what the sentence asks for; and, of one that
  asks the picture classifier, `panels` float32 (batch, 3, 4): each one's centre u, v and height in pixels, and which of
  the three colours its gate has.

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
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.opinions import Opinions
from cognitivedrone.models.eyes.picture_classifier import PictureClassifier, classifier_of
from cognitivedrone.models.onnx_file import (
    Provenance,
    check_graph,
    count_of,
    field_of,
    open_model,
    provenance_of,
    texts_of,
    write_table,
)
from cognitivedrone.models.words.text_encoder import TextEncoderModel, packed
from cognitivedrone.types import COLORS, IMAGE_SIZE, Float32Array

KIND = "small-policy"
FORMER = {"small-vla": "a policy of an earlier kind, which reads sentences by a list of words"}
_ANY = 1

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
    classifier: bool = False
    """Whether it asks the picture classifier; not after a lesson, whose reader knows the user's own photographs."""
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
            classifier=table.get("classifier") is True,
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
    panels: Float32[Float32Array, "images 3 4"] | None = None
    """(n, 3, 4) of each gate's panel: centre u, v and height in pixels, and the number of its gate's colour; None of
    models that do not ask the picture classifier."""
    occupied: Float32[Float32Array, "images 16 16"] | None = None
    """(n, 16, 16) for each part of the frame, rows from the top: probability of an obstacle, as the obstacle eye sees
    it; None where nobody asked it."""
    depth: Float32[Float32Array, "images 16 16"] | None = None
    """(n, 16, 16) its distance along the camera's axis, m, if there is one."""

    def without_numbers(self) -> str | None:
        """The name of the first part that holds a value which is not a number; none if there is none."""
        parts = ((field.name, getattr(self, field.name)) for field in fields(self))
        return next((name for name, values in parts if values is not None and np.isnan(values).any()), None)


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
    """The network, run by ONNX Runtime on the CPU."""

    def __init__(
        self,
        session: Any,
        description: Description,
        encoder: TextEncoderModel | None,
        opinions: Opinions | None = None,
    ) -> None:
        """Wrap an `onnxruntime.InferenceSession`; `load` creates one from a file."""
        self._session = session
        self.description = description
        self._encoder = encoder
        self.opinions = opinions
        """Those of a flight that has not begun, of a model that asks the picture classifier; each flight has a fork."""

    @classmethod
    def load(cls, path: str | Path, *, threads: int = 1) -> SmallModel:
        """Load a model file, to be run on `threads` cores, and its text encoder: beside it, or the packaged one.

        Raises `ModelError` where a file is missing, too large, damaged, cut short, does not keep to the contract, or
        where the text encoder is another one than the policy was trained with.
        """
        session, table = open_model(Path(path), KIND, threads=threads, optimise=True, former=FORMER)
        description = Description.of(table, str(path))
        _check_graph(session, description, str(path))
        if not description.encoder:
            return cls(session, description, None)
        encoder = TextEncoderModel.of_digest(description.encoder, Path(path), threads=threads)
        if not description.classifier:
            return cls(session, description, encoder)
        classifier = PictureClassifier.load(classifier_of(Path(path)), threads=threads)
        return cls(session, description, encoder, Opinions(classifier, AttributeSchema(description.attributes)))

    @property
    def words(self) -> frozenset[str]:
        """The words that its text encoder knows whole; empty if it reads no sentences."""
        pieces = () if self._encoder is None else self._encoder.tokenizer.pieces
        return frozenset(piece for piece in pieces if piece.isalpha())

    def run(
        self,
        images: NDArray[np.uint8],
        states: NDArray[np.float32],
        texts: Sequence[str],
        opinions: Sequence[Opinions | None] | None = None,
    ) -> Output:
        """Run the network on n frames (n, 256, 256, 3) with states (n, 5), each with its own sentence.

        `opinions` are those of each frame's flight, by default none. Raises `PolicyError` for other shapes or types.
        """
        size = IMAGE_SIZE
        _check_input("images", images, np.uint8, (len(texts), size, size, 3))
        _check_input("states", states, np.float32, (len(texts), 5))
        inputs: dict[str, NDArray[Any]] = {"image": images, "state": states}
        if self._encoder is not None:
            inputs["words"] = packed([self._encoder.words(text) for text in texts])
        if self.opinions is not None:
            known = [(each or self.opinions).arrays() for each in opinions or [None] * len(texts)]
            inputs |= {name: np.stack([each[name] for each in known]) for name in ("opinions", "paper")}
        return Output(*self._session.run(_outputs(self.description), inputs))


def _check_input(name: str, array: NDArray[Any], kind: type, shape: tuple[int, ...]) -> None:
    if array.dtype != kind or array.shape != shape:
        raise PolicyError(f"{name} must be {np.dtype(kind)} {shape}, not {array.dtype} {array.shape}")


def _check_graph(session: Any, description: Description, where: str) -> None:
    size = description.image_size
    inputs: dict[str, tuple[str, tuple[int, ...]]] = {
        "image": ("tensor(uint8)", (size, size, 3)),
        "state": ("tensor(float)", (5,)),
    }
    if description.encoder:
        language = field_of(description.network, "language", dict, where)
        inputs["words"] = ("tensor(float)", (_ANY, count_of(language, "size", where)))
    if description.classifier:
        things = len(AttributeSchema(description.attributes).things)
        inputs |= {"opinions": ("tensor(float)", (len(COLORS), things)), "paper": ("tensor(float)", (len(COLORS),))}
    shapes: dict[str, tuple[int, ...]] = {
        "action": (description.chunk, 4),
        "choice": (4,),
        "gates": (3, 4),
        "present": (),
        "panels": (3, 4),
    }
    outputs = {name: ("tensor(float)", shapes[name]) for name in _outputs(description)}
    check_graph(session, inputs, outputs, where)


def _outputs(description: Description) -> tuple[str, ...]:
    named = ("action", "choice", "gates")
    if not description.encoder:
        return named
    return (*named, "present", "panels") if description.classifier else (*named, "present")


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
