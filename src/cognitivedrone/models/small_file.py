"""The small model's file: one ONNX graph that carries its vocabulary, its action statistics and where it comes from.

Contract of the graph; the batch is a dynamic axis, L the description's `text_length`, k its `chunk`:

- inputs `image` uint8 (batch, 256, 256, 3); `state` float32 (batch, 5): velocity x, y, z in the heading frame, m/s,
  height above ground, m, and yaw rate, rad/s; `tokens` int64 (batch, L), as `Vocabulary.encode` gives them;
- outputs `action` float32 (batch, k, 4): velocity x, y, z in the heading frame, m/s, and yaw rate, rad/s; `choice`
  float32 (batch, 4): probability of each seen gate, and last of none of those in view; `gates` float32 (batch, 3, 4):
  each one's centre u, v in pixels, detection score 0 to 1, and distance in m.

The description is JSON under the ONNX metadata key `KEY`.
"""

from __future__ import annotations

import importlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import MissingExtra, PolicyError
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.types import IMAGE_SIZE

KEY = "cognitivedrone"
FORMAT = 1
KIND = "small-vla"
LARGEST_BYTES = 256 * 2**20
"""A file that is larger is refused before it is read."""

T = TypeVar("T")
Four = tuple[float, float, float, float]
"""One number for each of velocity x, y, z in m/s and yaw rate in rad/s."""


@dataclass(frozen=True, slots=True)
class ActionStatistics:
    """What actions the model was trained on."""

    low: Four
    """Lowest that it can ask for."""
    high: Four
    """Highest that it can ask for."""
    mean: Four
    std: Four
    q01: Four
    """First percentile."""
    q99: Four
    """Last percentile."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a model comes from."""

    recipe: str
    data: str
    """Hash of the data, or what streamed it."""
    commit: str
    """Of the code that trained it."""
    trained: str
    """ISO 8601, UTC."""
    steps: int
    scores: Mapping[str, Any]
    """What it reached, by name."""


@dataclass(frozen=True, slots=True)
class Description:
    """All that a model file says of itself."""

    name: str
    vocabulary: Vocabulary
    text_length: int
    """Words of a sentence that are read."""
    chunk: int
    """Control steps that one look decides."""
    action: ActionStatistics
    config: Mapping[str, Any]
    """Of the network."""
    provenance: Provenance
    image_size: int = IMAGE_SIZE
    """Height and width of the image it is given, pixels."""

    def to_json(self) -> str:
        """As it is written into the file."""
        return json.dumps(
            {
                "format": FORMAT,
                "kind": KIND,
                **_table(self),
                "vocabulary": self.vocabulary.words,
                "action": _table(self.action),
                "config": dict(self.config),
                "provenance": {**_table(self.provenance), "scores": dict(self.provenance.scores)},
            },
            ensure_ascii=False,
        )

    @classmethod
    def from_json(cls, text: str, where: str) -> Description:
        """Read back what `to_json` wrote; raises `PolicyError` that says where what is wrong."""
        try:
            table = json.loads(text)
        except ValueError as error:
            raise PolicyError(f"the description in {where} is not JSON: {error}") from None
        version = table.get("format") if isinstance(table, dict) else None
        if version != FORMAT:
            raise PolicyError(
                f"{where} is a model file of format {version!r} and this version reads format {FORMAT};"
                " take a file and a release of cognitivedrone that belong together"
            )
        if table.get("kind") != KIND:
            raise PolicyError(f"{where} is a model of kind {table.get('kind')!r}, not {KIND!r}")
        origin = _field(table, "provenance", dict, where)
        described = cls(
            name=_field(table, "name", str, where),
            vocabulary=_vocabulary(_field(table, "vocabulary", list, where), where),
            text_length=_count(table, "text_length", where),
            image_size=_count(table, "image_size", where),
            chunk=_count(table, "chunk", where),
            action=_statistics(_field(table, "action", dict, where), where),
            config=_field(table, "config", dict, where),
            provenance=Provenance(
                **{name: _field(origin, name, str, where) for name in ("recipe", "data", "commit", "trained")},
                steps=_field(origin, "steps", int, where),
                scores=_field(origin, "scores", dict, where),
            ),
        )
        if described.image_size != IMAGE_SIZE:
            raise PolicyError(f"{where} reads images of {described.image_size} pixels; drones send {IMAGE_SIZE}")
        return described


@dataclass(frozen=True, slots=True)
class Output:
    """What the network says of n frames."""

    action: NDArray[np.float32]
    """(n, k, 4), heading frame, m/s and rad/s: for the next k control steps."""
    choice: NDArray[np.float32]
    """(n, 4) probability that each of the seen gates is meant; last, that none of them is."""
    gates: NDArray[np.float32]
    """(n, 3, 4) of each seen gate: centre u, v in pixels, detection score 0 to 1, distance in m."""


def describe(path: str | Path, description: Description) -> None:
    """Write the description into an ONNX file, in place of any it has.

    Raises `MissingExtra` where the `onnx` package is not installed.
    """
    try:
        onnx: Any = importlib.import_module("onnx")
    except ModuleNotFoundError:
        raise MissingExtra("onnx", "train") from None
    model = onnx.load(str(path))
    others = {entry.key: entry.value for entry in model.metadata_props if entry.key != KEY}
    onnx.helper.set_model_props(model, {**others, KEY: description.to_json()})
    whole = Path(f"{path}.part")
    onnx.save(model, str(whole))
    whole.replace(path)


def read_description(path: str | Path) -> Description:
    """What the model in the file says of itself; raises `PolicyError` as `SmallModel.load` does."""
    return _description_of(_open(Path(path), threads=1, optimise=False), str(path))


class SmallModel:
    """The network, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, description: Description) -> None:
        """Of an `onnxruntime.InferenceSession`; `load` makes one from a file."""
        self._session = session
        self.description = description

    @classmethod
    def load(cls, path: str | Path, *, threads: int = 1) -> SmallModel:
        """Load a model file, to be run on `threads` cores.

        Raises `PolicyError` where the file is missing, too large, cut short, or does not keep to the contract.
        """
        session = _open(Path(path), threads=threads, optimise=True)
        description = _description_of(session, str(path))
        _check_graph(session, description, str(path))
        return cls(session, description)

    def run(self, images: NDArray[np.uint8], states: NDArray[np.float32], texts: Sequence[str]) -> Output:
        """Look at n frames (n, 256, 256, 3) with states (n, 5), each with its own sentence.

        Raises `PolicyError` where these have other shapes or types.
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


def _open(path: Path, *, threads: int, optimise: bool) -> Any:
    """An inference session of a file."""
    if not path.is_file():
        raise PolicyError(f"there is no model file {path}")
    if path.stat().st_size > LARGEST_BYTES:
        raise PolicyError(
            f"{path} has {path.stat().st_size / 2**20:.0f} MB; a small model has at most {LARGEST_BYTES / 2**20:.0f} MB"
        )
    ort: Any = importlib.import_module("onnxruntime")
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    # Waiting threads sleep: the cores belong to the simulator, or to the rest of the drone.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4  # what matters is raised
    if not optimise:
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    # The arena grows by what is asked for instead of doubling.
    provider = ("CPUExecutionProvider", {"arena_extend_strategy": "kSameAsRequested"})
    try:
        return ort.InferenceSession(str(path), options, providers=[provider])
    except Exception as error:  # its errors have no public common type
        reason = str(error).splitlines()[0]
        if type(error).__name__ == "InvalidProtobuf" or "No graph was found" in reason:
            raise PolicyError(f"{path} is not an ONNX file, or it was cut short; fetch or train it anew") from None
        raise PolicyError(f"ONNX Runtime {ort.__version__} cannot load {path}: {reason}") from None


def _description_of(session: Any, where: str) -> Description:
    text = session.get_modelmeta().custom_metadata_map.get(KEY)
    if text is None:
        raise PolicyError(
            f"{where} does not describe itself: it lacks the metadata {KEY!r} that `cognitivedrone train` writes"
        )
    return Description.from_json(text, where)


def _check_graph(session: Any, description: Description, where: str) -> None:
    """Compare names, types and shapes of inputs and outputs with the contract."""
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
    for side, wanted, found in (("in", inputs, session.get_inputs()), ("out", outputs, session.get_outputs())):
        nodes = {node.name: node for node in found}
        if nodes.keys() != wanted.keys():
            raise PolicyError(f"{where} has the {side}puts {', '.join(nodes)}; expected {', '.join(wanted)}")
        for name, (kind, shape) in wanted.items():
            node = nodes[name]
            if node.type != kind or not _fits(node.shape, shape):
                raise PolicyError(
                    f"{side}put {name!r} of {where} is {node.type} {node.shape}; expected {kind} {['batch', *shape]}"
                )


def _fits(found: Sequence[Any], wanted: tuple[int, ...]) -> bool:
    """Whether a graph's shape can be (batch, *wanted) for any batch: a dimension without a number may be any."""
    batch, rest = found[:1], found[1:]
    return (
        len(rest) == len(wanted)
        and not isinstance(batch[0], int)
        and all(not isinstance(size, int) or size == want for size, want in zip(rest, wanted, strict=True))
    )


def _table(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in fields(value)}


def _field(table: Mapping[str, Any], name: str, kind: type[T], where: str) -> T:
    """A field of the description, of the type it must have."""
    if name not in table:
        raise PolicyError(f"the description in {where} lacks {name!r}")
    value = table[name]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise PolicyError(f"{name!r} of the description in {where} is {value!r:.60}, which is no {kind.__name__}")
    return value


def _count(table: Mapping[str, Any], name: str, where: str) -> int:
    value = _field(table, name, int, where)
    if value < 1:
        raise PolicyError(f"{name!r} of the description in {where} is {value}; it must be at least 1")
    return value


def _vocabulary(words: list[Any], where: str) -> Vocabulary:
    if not all(isinstance(word, str) for word in words):
        raise PolicyError(f"the vocabulary in {where} holds something that is no word")
    try:
        return Vocabulary(tuple(words))
    except PolicyError as error:
        raise PolicyError(f"{where}: {error}") from None


def _statistics(table: Mapping[str, Any], where: str) -> ActionStatistics:
    """Action statistics, checked: a model without them would fly at the wrong speed."""
    columns: dict[str, Four] = {}
    for field in fields(ActionStatistics):
        values = _field(table, field.name, list, f"{where} (action)")
        if len(values) != 4 or not all(isinstance(value, int | float) and math.isfinite(value) for value in values):
            raise PolicyError(
                f"action statistics {field.name!r} in {where} are {values!r:.60}; expected 4 finite numbers"
            )
        columns[field.name] = (float(values[0]), float(values[1]), float(values[2]), float(values[3]))
    if any(low >= high for low, high in zip(columns["low"], columns["high"], strict=True)):
        raise PolicyError(
            f"action statistics in {where} have low {columns['low']} and high {columns['high']};"
            " every low must be below its high"
        )
    return ActionStatistics(**columns)
