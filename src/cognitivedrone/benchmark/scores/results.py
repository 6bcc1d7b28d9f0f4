"""The results of a run, and their file, results.json, whose schema docs/benchmark.md documents.

cattrs takes the dataclasses to JSON and back: `decode` derives its schema from the type hints, checks every field, and
rejects an invalid file with the path of the first invalid value. Non-finite numbers are written as null, and null is
read as NaN where a float is expected. A field with the metadata `{"json": "where set"}` is omitted at its default.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import math
import platform
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeVar, get_origin

import cattrs
import numpy as np
from cattrs.gen import make_dict_unstructure_fn, override
from numpy.typing import NDArray

import cognitivedrone
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.scores.published import are_papers_tasks, paper_rows
from cognitivedrone.benchmark.scores.run_types import not_measured, unanswered
from cognitivedrone.benchmark.scores.scoring import RULES, Summary, summarize
from cognitivedrone.errors import RunError
from cognitivedrone.files import read_regular, reason_of, replace_file, schema, writing
from cognitivedrone.plan import Rule
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import EpisodeResult
from cognitivedrone.vehicles.contract import LinkReport

T = TypeVar("T")
_SURROGATE = re.compile("[\ud800-\udfff]")


def encode(value: Any) -> Any:
    """Plain JSON values for dataclasses, mappings, sequences, numbers and arrays; arrays are rounded to 3 decimals."""
    return _CONVERTER.unstructure(value)


def dumps(value: Any, *, indent: int | None = None) -> str:
    """JSON text of `encode(value)`, identical for equal values. Surrogates, which no file takes, are spelled out."""
    separators = (",", ":") if indent is None else (",", ": ")
    text = json.dumps(encode(value), ensure_ascii=False, allow_nan=False, indent=indent, separators=separators)
    return _SURROGATE.sub(lambda found: rf"\\u{ord(found.group()):04x}", text)


def read_document(path: Path, schema: str, kind: str, way_out: str, max_bytes: int) -> dict[str, Any]:
    """The JSON object of a file with this schema, without it. Raises `RunError` that names `kind` and the way out."""
    try:
        document = parse_json(read_regular(path, max_bytes).decode("utf-8"))
    except OSError as error:
        raise RunError(f"{path} cannot be read ({reason_of(error)}); {way_out}") from None
    except ValueError as error:
        raise RunError(f"{path} cannot be read: {error}; {way_out}") from None
    found = document.pop("schema", None) if isinstance(document, dict) else None
    if found != schema:
        raise RunError(f"{path} is no {kind} of this version: its schema is {found!r}, not {schema!r}; {way_out}")
    return dict(document)


def decode(kind: type[T], value: Any, where: str) -> T:
    """`value` as a `kind`: a dataclass, or any type that its hints may contain. Raises `RunError` with the place."""
    return schema.decode(kind, value, where, RunError, _CONVERTER)


def _read_points(value: Any, _: Any) -> NDArray[np.float32]:
    """(n, 3) float32."""
    with suppress(TypeError, ValueError, OverflowError), np.errstate(over="ignore"):
        if isinstance(value, Sequence) and not isinstance(value, str):
            points = np.array(value, dtype=np.float32).reshape(-1, 3)
            if np.isfinite(points).all():
                return points
    raise schema.must_be("a list of [x, y, z]", value)


def _dataclass_writer(kind: type[Any], converter: cattrs.Converter) -> Callable[[Any], Any]:
    fields = dataclasses.fields(kind)
    optional: dict[str, Any] = {
        field.name: override(omit_if_default=True) for field in fields if field.metadata.get("json") == "where set"
    }
    return make_dict_unstructure_fn(kind, converter, **optional)


def _write_float(value: float) -> float | None:
    # Write whole-numbered floats as integers, so that a file does not depend on how a value was computed.
    return value if isinstance(value, int) else float(value) if math.isfinite(value) else None


def _is_array(hint: Any) -> bool:
    """Whether a hint is an `NDArray[...]`, an alias that NumPy 2.5 defines differently from earlier versions."""
    return np.ndarray in (hint, get_origin(hint)) or (get_origin(hint) or hint) is NDArray


def _make_converter() -> cattrs.Converter:
    converter = schema.make_reader(unknown="refused")
    converter.register_structure_hook_func(_is_array, _read_points)
    converter.register_unstructure_hook_factory(schema.is_dataclass, _dataclass_writer)
    converter.register_unstructure_hook(bool, bool)
    converter.register_unstructure_hook(np.integer, int)
    for real in (float, np.floating):
        converter.register_unstructure_hook(real, _write_float)
    converter.register_unstructure_hook_func(_is_array, lambda points: np.round(points.astype(np.float64), 3).tolist())
    return converter


_CONVERTER = _make_converter()


FILES: Final = ("labels", "model", "reasoner_model", "policy_code", "reasoner_code", "autopilot")
"""Options whose value is the SHA-256 of a file: label images, the policy's weights, the reasoner's weights or answers,
the modules of a user's own policy and reasoner, the autopilot program; null if there is none."""
_OPTIONS: Final = Plan.identity_options() | dict.fromkeys(FILES, (str | None, None))
REQUIRED: Final = ("seed", "track", "episodes", "appearance", "airframe", "labels", "wind_m_s", "model")
"""Options in every results file; options added later are omitted at their defaults."""
SCHEMA: Final = "cognitivedrone.results/1"
RESULTS_FILE: Final = "results.json"
MAX_FILE_BYTES: Final = 2**30


@dataclass(frozen=True, slots=True)
class SuiteFacts:
    """Which tasks were flown."""

    name: str
    digest: str
    """SHA-256 of the tasks."""
    size: int
    """Number of tasks."""
    asked: int | None = field(default=None, metadata={"json": "where set"})
    """Number of tasks before those without a picture were left out (`--missing skip`), if any were."""

    @property
    def left_out(self) -> str:
        """How many tasks were flown of how many, if some were left out; else empty."""
        return "" if self.asked is None else f"{self.size} of {self.asked} tasks; the others lack a picture"


@dataclass(frozen=True, slots=True)
class RunFacts:
    """A run's identity: two runs of equal facts give equal results. The content of run.json."""

    suite: SuiteFacts
    policy: str
    reasoner: str
    options: Mapping[str, Any]
    """Everything else that affects the outcome: the plan's options with an `identity` (`cognitivedrone.plan`), and the
    SHA-256 of every file in `FILES`. Some are omitted at their defaults."""
    versions: Mapping[str, str]

    def option(self, key: str) -> Any:
        """The value of an option, or its default if it was omitted."""
        return self.options.get(key, _OPTIONS[key][1])


@dataclass(frozen=True, slots=True)
class Timing:
    """Duration of the run on this machine."""

    finished: str
    """End of the run, ISO 8601, UTC."""
    wall_s: float
    """Of this session; a resumed run had earlier sessions."""
    workers: int
    episodes_flown: int
    """In this session."""
    mean_decision_ms: float | None
    """Mean wall time of a policy's decision."""
    link: LinkReport | None = field(default=None, metadata={"json": "where set"})
    """Link statistics of this session, if an autopilot in another process flew."""


@dataclass(frozen=True)
class Results:
    """The results of a run."""

    run: RunFacts
    renderer: str
    rule: Rule
    """The rule of the headline scores."""
    episodes: tuple[EpisodeResult, ...]
    """In the order of the suite."""
    platform: Mapping[str, str]
    timing: Timing

    @cached_property
    def _summaries(self) -> dict[Rule, Summary]:
        return {rule: summarize(self.episodes, rule) for rule in RULES}

    def summary(self, rule: Rule | None = None) -> Summary:
        """The scores by a rule; the run's own by default."""
        return self._summaries[rule or self.rule]

    @property
    def policy_failure(self) -> str:
        """The first error, if every episode ended in an error of the policy; empty otherwise."""
        failed = [any(stage.outcome == "policy_error" for stage in episode.stages) for episode in self.episodes]
        return self.episodes[0].message if failed and all(failed) else ""

    @property
    def not_measured(self) -> str:
        """Why the run is no measurement of its reasoner; empty if it is one, or has none."""
        reports = [
            stage.reasoner for episode in self.episodes for stage in episode.stages if stage.reasoner is not None
        ]
        faults = sum((Counter(report.faults) for report in reports), Counter[str]())
        why = not_measured(faults, sum(report.answers for report in reports) + faults.total())
        if why or self.measured or not self.episodes:
            return why
        return "this is not a measurement: in every flight the reasoner's server left a question without an answer"

    @property
    def measured(self) -> tuple[EpisodeResult, ...]:
        """The flights that are counted."""
        return tuple(episode for episode in self.episodes if not unanswered(episode))


def versions() -> dict[str, str]:
    """Versions of the packages that affect a result."""
    packages = {name: importlib.metadata.version(name) for name in ("mujoco", "numpy", "onnxruntime")}
    return {"cognitivedrone": cognitivedrone.__version__, "python": platform.python_version(), **packages}


def results_to_json(results: Results) -> dict[str, Any]:
    """The content of results.json. Everything but `platform` and `timing` is the same when the run is repeated."""
    return {
        "schema": SCHEMA,
        **encode(results.run),
        "renderer": results.renderer,
        "rule": results.rule,
        "scores": {rule: encode(results.summary(rule)) for rule in RULES},
        **({"paper": encode(paper_rows(results.summary()))} if are_papers_tasks(results.episodes) else {}),
        "episodes": encode(results.episodes),
        "platform": encode(results.platform),
        "timing": encode(results.timing),
    }


def results_from_json(document: Mapping[str, Any], where: str) -> Results:
    """Check and read the content of results.json, without its schema. Its scores must follow from its episodes.

    Raises `RunError` with the place of the first error.
    """
    parts = {key: value for key, value in document.items() if key not in ("schema", "scores", "paper")}
    run = {key: parts.pop(key) for key in RunFacts.__dataclass_fields__ if key in parts}
    results = decode(Results, {"run": run, **parts}, where)
    check_options(results.run.options, where)
    numbers = [episode.episode for episode in results.episodes]
    if numbers != sorted({*numbers}) or (numbers and numbers[0] < 0):
        raise RunError(f"{where}: its episodes are not in order, or one is there twice; the file was changed")
    if empty := [episode.episode for episode in results.episodes if not episode.stages]:
        raise RunError(f"{where}: episode {empty[0]} has no stage; the file was changed")
    written = document.get("scores")
    for rule in RULES:
        if not isinstance(written, dict) or written.get(rule) != encode(results.summary(rule)):
            raise RunError(f"{where}: scores.{rule} does not follow from the episodes; the file was changed or cut")
    return results


def check_options(options: Mapping[str, Any], where: str) -> None:
    """Raise `RunError` for an option that is unknown, missing, or of another type."""
    for key, (hint, _) in _OPTIONS.items():
        if key in options:
            decode(hint, options[key], f"{where}: options.{key}")
        elif key in REQUIRED:
            raise RunError(f"{where}: options.{key} is missing")
    if unknown := options.keys() - _OPTIONS.keys():
        raise RunError(f"{where}: options has {min(unknown)!r}, which this version does not know")


def write_results(path: Path, results: Results) -> None:
    """Write results.json atomically."""
    write_whole(path, dumps(results_to_json(results), indent=1) + "\n")


def read_results(path: Path) -> Results:
    """Read results.json, from its path or its folder. Raises `RunError` if it is missing or malformed."""
    path = path / RESULTS_FILE if path.is_dir() else path
    way_out = "give the --out folder of a finished run"
    return results_from_json(read_document(path, SCHEMA, "results file", way_out, MAX_FILE_BYTES), str(path))


def write_whole(path: Path, text: str) -> None:
    """Write a file atomically: a kill at any moment leaves the old version or the new one.

    Raises `RunError` if it cannot be written; the old version stays, without temporary files.
    """
    with writing(path, RunError):
        # A policy's messages may contain lone surrogates, which cannot be encoded.
        replace_file(path, text.encode("utf-8", "backslashreplace"))
