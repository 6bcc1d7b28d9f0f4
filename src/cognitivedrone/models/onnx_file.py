"""ONNX files that describe themselves and tell when they are damaged, both before they are run.

A JSON table in the file's metadata says what the model is; a checksum, what its bytes were: `sha256-of-this-file:` and
64 digits somewhere in them, computed with zeros in their place. `seal` fills it in, `check` compares.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import json
import mmap
import multiprocessing
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, import_extra
from cognitivedrone.files import read_regular, reason_of, replacing
from cognitivedrone.system.imports import switch_off
from cognitivedrone.text.json_text import parse_json

MARK: Final = "sha256-of-this-file:"
BLANK: Final = MARK + "0" * 64
"""Placeholder that a file to be sealed must contain exactly once."""

Finding = Literal["sound", "damaged", "unknown"]
"""`unknown`: the file holds no checksum."""


def seal(path: Path) -> None:
    """Write the checksum of a file into it, replacing its only `BLANK`."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
        at = content.find(BLANK.encode())
        if at < 0 or content.find(MARK.encode(), at + 1) >= 0:
            raise ValueError(f"{path} must hold {MARK!r} and zeros exactly once")
        digest = hashlib.sha256(content).hexdigest()
        content[at + len(MARK) : at + len(BLANK)] = digest.encode()


def check(content: bytes | mmap.mmap) -> Finding:
    """Whether the content of a file matches its own checksum."""
    at = content.find(MARK.encode())
    if at < 0:
        return "unknown"
    start, stop = at + len(MARK), at + len(BLANK)
    digest = hashlib.sha256()
    with memoryview(content) as view:
        for piece in (view[:start], b"0" * 64, view[stop:]):
            digest.update(piece)
    return "sound" if content[start:stop] == digest.hexdigest().encode() else "damaged"


KEY = "cognitivedrone"
"""Key of the metadata."""
FORMAT = 2
"""Version of the description. Format 1, the same without a checksum, is also accepted."""
LARGEST_BYTES = 256 * 2**20
"""Maximum file size; larger files are refused before they are read."""

T = TypeVar("T")
Tensors = Mapping[str, tuple[str, tuple[int, ...]]]
"""By name: ONNX Runtime's type, and the shape without the batch."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """Provenance of a model."""

    recipe: str
    data: str
    """Hash of the data, or the name of the rollout stream."""
    commit: str
    """Commit of the training code."""
    trained: str
    """Time of training, ISO 8601, UTC."""
    steps: int
    scores: Mapping[str, Any]
    """Scores of the model, by name."""


def write_table(path: str | Path, kind: str, table: Mapping[str, Any]) -> None:
    """Write a description and a checksum into an ONNX file, replacing existing ones.

    Raises `MissingExtra` if the `onnx` package is not installed.
    """
    onnx = import_extra("onnx", "train", "onnx")
    model = onnx.load(str(path))
    others = {entry.key: entry.value for entry in model.metadata_props if entry.key != KEY}
    text = json.dumps({"format": FORMAT, "checksum": BLANK, "kind": kind, **table}, ensure_ascii=False)
    onnx.helper.set_model_props(model, {**others, KEY: text})
    with replacing(Path(path)) as whole:
        onnx.save(model, str(whole))
        seal(whole)


def check_model_file(path: Path) -> None:
    """Raise `ModelError` unless there is a file that is small enough for a model, before it is read or hashed."""
    if not path.is_file():
        raise ModelError(f"there is no model file {path}")
    if path.stat().st_size > LARGEST_BYTES:
        raise ModelError(
            f"{path} has {path.stat().st_size / 2**20:.0f} MB; a small model has at most {LARGEST_BYTES / 2**20:.0f} MB"
        )


def beside(model: Path, name: str) -> Path:
    """A file that belongs to a model's: the one in the same folder, or the packaged one."""
    near = model.parent / name
    return near if near.is_file() else Path(str(resources.files("cognitivedrone.models"))) / "weights" / name


def shared(load: Callable[..., T], path: Path, *others: Path, threads: int = 1) -> T:
    """What `load` makes of a file, one for policy and reasoner; made again where it or one of `others` has changed."""
    changed = tuple(file.stat().st_mtime_ns if file.is_file() else 0 for file in (path, *others))
    found: T = _loaded(load, path, threads, changed)
    return found


@functools.lru_cache(maxsize=16)
def _loaded(load: Callable[..., Any], path: Path, threads: int, changed_ns: tuple[int, ...]) -> Any:  # noqa: ARG001
    return load(path, threads=threads)


def open_model(
    path: Path, kind: str, *, threads: int, optimise: bool, former: Mapping[str, str] | None = None
) -> tuple[Any, dict[str, Any]]:
    """An inference session of a model file of this kind, run on the CPU, and its description; `former` says of kinds of
    earlier versions what they are.

    Raises `ModelError` where it cannot be loaded, does not match its checksum, or is of another kind or format; warns
    where it has no checksum.
    """
    check_model_file(path)
    try:
        content = read_regular(path, LARGEST_BYTES)
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {reason_of(error)}") from None
    if (finding := check(content)) == "damaged":
        raise ModelError(f"{path} does not match its checksum, so it is damaged; download or train it again")
    # Use the bytes that were checked, not the file's current content.
    session = _open_session(content, path, threads=threads, optimise=optimise)
    table = _read_table(session, kind, str(path), former or {})
    if finding == "unknown" and table["format"] == FORMAT:
        raise ModelError(f"{path} has lost its checksum, so it is damaged; download or train it again")
    if finding == "unknown" and multiprocessing.parent_process() is None:  # once, not in every worker
        warnings.warn(
            f"{path} was written before model files had checksums: damage to it would not be noticed", stacklevel=4
        )
    return session, table


def _open_session(content: bytes, path: Path, *, threads: int, optimise: bool) -> Any:
    switch_off()
    ort: Any = importlib.import_module("onnxruntime")
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    # Waiting threads sleep, because the cores are needed by the simulator, or by the rest of the drone.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4  # errors are raised anyway
    if not optimise:
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    # The arena grows by the requested size instead of doubling.
    provider = ("CPUExecutionProvider", {"arena_extend_strategy": "kSameAsRequested"})
    try:
        return ort.InferenceSession(content, options, providers=[provider])
    except Exception as error:  # its errors have no public common type
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        no_graph = "No graph was found" in reason or "does not have a graph" in reason  # the latter until 1.23
        if type(error).__name__ == "InvalidProtobuf" or no_graph or not content:
            raise ModelError(f"{path} is not an ONNX file, or it was cut short; download or train it again") from None
        raise ModelError(f"ONNX Runtime {ort.__version__} cannot load {path}: {reason}") from None


def _read_table(session: Any, kind: str, where: str, former: Mapping[str, str]) -> dict[str, Any]:
    """The description in an open file, of a format read here and of this kind; raises `ModelError` for any other."""
    try:
        text = session.get_modelmeta().custom_metadata_map.get(KEY)
        table = None if text is None else parse_json(text)
    except ValueError as error:
        raise ModelError(f"the description in {where} is not JSON: {error}") from None
    if text is None:
        raise ModelError(
            f"{where} does not describe itself: it lacks the metadata {KEY!r} that `cognitivedrone train` writes"
        )
    version = table.get("format") if isinstance(table, dict) else None
    if version not in (1, FORMAT) or isinstance(version, bool):
        raise ModelError(
            f"{where} is a model file of format {version!r} and this version reads formats 1 and {FORMAT};"
            " use a file and a release of cognitivedrone that match"
        )
    found = cast(dict[str, Any], table)
    if isinstance(found.get("kind"), str) and found["kind"] in former:
        raise ModelError(f"{where} is {former[found['kind']]}; use the release that it came with, or train it again")
    if found.get("kind") != kind:
        raise ModelError(f"{where} is a model of kind {found.get('kind')!r:.60}, not {kind!r}")
    return found


def numbers_of(session: Any, outputs: Sequence[str], inputs: Mapping[str, Any], what: str) -> list[Any]:
    """These outputs of a network; raises `ModelError` where one is not a number, as of weights that are none."""
    found: list[Any] = session.run(outputs, inputs)
    for name, values in zip(outputs, found, strict=True):
        if np.isnan(values).any():
            raise ModelError(
                f"{what} answers with values that are not numbers ({name}), so its weights are damaged; train or"
                " download it again"
            )
    return found


def shares_of(logits: NDArray[Any]) -> NDArray[Any]:
    """Probabilities (..., n) of logits (..., n)."""
    shares = np.exp(logits - logits.max(axis=-1, keepdims=True))
    found: NDArray[Any] = shares / shares.sum(axis=-1, keepdims=True)
    return found


def check_graph(session: Any, inputs: Tensors, outputs: Tensors, where: str) -> None:
    """Compare names, types and shapes of inputs and outputs with a contract; raises `ModelError`."""
    for side, wanted, found in (("in", inputs, session.get_inputs()), ("out", outputs, session.get_outputs())):
        nodes = {node.name: node for node in found}
        if nodes.keys() != wanted.keys():
            raise ModelError(f"{where} has the {side}puts {', '.join(nodes)}; expected {', '.join(wanted)}")
        for name, (kind, shape) in wanted.items():
            node = nodes[name]
            if node.type != kind or not _fits(node.shape, shape):
                raise ModelError(
                    f"{side}put {name!r} of {where} is {node.type} {node.shape}; expected {kind} {['batch', *shape]}"
                )


def _fits(found: Sequence[Any], wanted: tuple[int, ...]) -> bool:
    """Whether a graph's shape can be (batch, *wanted) for any batch: a dimension without a number matches any."""
    batch, rest = found[:1], found[1:]
    return (
        len(rest) == len(wanted)
        and not isinstance(batch[0], int)
        and all(not isinstance(size, int) or size == want for size, want in zip(rest, wanted, strict=True))
    )


def field_of(table: Mapping[str, Any], name: str, kind: type[T], where: str) -> T:
    """A field of the description, checked to be of this type."""
    if name not in table:
        raise ModelError(f"the description in {where} lacks {name!r}")
    value = table[name]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ModelError(f"{name!r} of the description in {where} is {value!r:.60}, which is not a {kind.__name__}")
    return value


def texts_of(table: Mapping[str, Any], name: str, where: str) -> tuple[str, ...]:
    """A field that is a list of texts; raises `ModelError`."""
    values = field_of(table, name, list, where)
    if not all(isinstance(value, str) for value in values):
        raise ModelError(f"{name!r} of the description in {where} holds something else than text")
    return tuple(values)


def count_of(table: Mapping[str, Any], name: str, where: str) -> int:
    """A field that is a whole number from 1; raises `ModelError`."""
    value = field_of(table, name, int, where)
    if value < 1:
        raise ModelError(f"{name!r} of the description in {where} is {value}; it must be at least 1")
    return value


def provenance_of(table: Mapping[str, Any], where: str) -> Provenance:
    """Where a model comes from, from its description; raises `ModelError`."""
    origin = field_of(table, "provenance", dict, where)
    return Provenance(
        **{name: field_of(origin, name, str, where) for name in ("recipe", "data", "commit", "trained")},
        steps=field_of(origin, "steps", int, where),
        scores=field_of(origin, "scores", dict, where),
    )
