"""The results of a run and their file, results.json. The schema is documented in docs/benchmark.md."""

from __future__ import annotations

import importlib.metadata
import platform
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import cognitivedrone
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.scores.codec import decode, dumps, encode, read_document
from cognitivedrone.benchmark.scores.published import are_papers_tasks, paper_rows
from cognitivedrone.benchmark.scores.run_types import not_measured, unanswered
from cognitivedrone.benchmark.scores.scoring import RULES, Summary, summarize
from cognitivedrone.errors import RunError
from cognitivedrone.files import replace_file, writing
from cognitivedrone.plan import Rule
from cognitivedrone.types import EpisodeResult
from cognitivedrone.vehicles.contract import LinkReport

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
