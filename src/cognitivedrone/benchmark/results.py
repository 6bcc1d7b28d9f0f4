"""The results of a run and their file, results.json. The schema is told in docs/results.md."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cognitivedrone
from cognitivedrone.benchmark.codec import decode, dumps, encode
from cognitivedrone.benchmark.run_types import LinkName, LookName, Rule
from cognitivedrone.benchmark.scoring import RULES, Summary, summarize
from cognitivedrone.errors import RunError
from cognitivedrone.files import read_regular, reason_of, replace_file, writing
from cognitivedrone.types import EpisodeResult
from cognitivedrone.vehicles.one_drone import LinkReport

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


@dataclass(frozen=True, slots=True)
class Options:
    """What else decides a run's outcome."""

    seed: int
    track: bool
    """Whether single tasks were chained into tracks."""
    episodes: int | None
    """The limit on episodes, if one was given."""
    look: LookName
    airframe: str
    labels: str | None
    """SHA-256 of the user's folder of label images, if one was given."""
    wind_m_s: float
    """Speed of a steady wind."""
    model: str | None
    """SHA-256 of the model file that the policy flies, if it flies one."""
    latency: str = field(default="none", metadata={"json": "where set"})
    """What was charged for thinking; a file is told by its SHA-256."""
    reasoner_model: str | None = field(default=None, metadata={"json": "where set"})
    """SHA-256 of the model file or the answers that the reasoner uses, if it uses one."""
    link: LinkName = field(default="sim", metadata={"json": "where set"})
    """Whose autopilot flew: `sim` is our own."""
    autopilot: str | None = field(default=None, metadata={"json": "where set"})
    """SHA-256 of the program that flew, where it was not our own."""


@dataclass(frozen=True, slots=True)
class RunFacts:
    """A run's identity: two runs of equal facts give equal results. The content of run.json."""

    suite: SuiteFacts
    policy: str
    reasoner: str
    options: Options
    versions: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Timing:
    """How long it took on this machine."""

    finished: str
    """Time of training, ISO 8601, UTC."""
    wall_s: float
    """Of this session; a resumed run had others before."""
    workers: int
    episodes_flown: int
    """In this session."""
    mean_decision_ms: float | None
    """Mean wall time of a policy's decision."""
    link: LinkReport | None = field(default=None, metadata={"json": "where set"})
    """What happened on the link in this session, where an autopilot in another process flew."""


@dataclass(frozen=True, slots=True)
class Results:
    """Everything a run found out."""

    run: RunFacts
    renderer: str
    rule: Rule
    """The rule of the headline scores."""
    episodes: tuple[EpisodeResult, ...]
    """In the order of the suite."""
    platform: Mapping[str, str]
    timing: Timing

    def summary(self, rule: Rule | None = None) -> Summary:
        """The scores by a rule; by the run's own where none is named."""
        return summarize(self.episodes, rule or self.rule)


def versions() -> dict[str, str]:
    """Versions of what decides a result."""
    packages = {name: importlib.metadata.version(name) for name in ("mujoco", "numpy", "onnxruntime")}
    return {"cognitivedrone": cognitivedrone.__version__, "python": platform.python_version(), **packages}


def results_to_json(results: Results) -> dict[str, Any]:
    """The content of results.json. All but `platform` and `timing` is the same on every repetition of the run."""
    return {
        "schema": SCHEMA,
        **encode(results.run),
        "renderer": results.renderer,
        "rule": results.rule,
        "scores": {rule: encode(results.summary(rule)) for rule in RULES},
        "episodes": encode(results.episodes),
        "platform": encode(results.platform),
        "timing": encode(results.timing),
    }


def results_from_json(document: Any, where: str) -> Results:
    """Check and read the content of results.json. The scores in it must be those of its own rows.

    Raises `RunError` naming the place of the first fault.
    """
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        found = document.get("schema") if isinstance(document, dict) else None
        raise RunError(f"{where} is not a results file of this version: its schema is {found!r}, not {SCHEMA!r}")
    parts = {key: value for key, value in document.items() if key not in ("schema", "scores")}
    run = {key: parts.pop(key) for key in RunFacts.__dataclass_fields__ if key in parts}
    results = decode(Results, {"run": run, **parts}, where)
    written = document.get("scores")
    for rule in RULES:
        if not isinstance(written, dict) or written.get(rule) != encode(results.summary(rule)):
            raise RunError(f"{where}: scores.{rule} does not follow from the episodes; the file was changed or cut")
    return results


def write_results(path: Path, results: Results) -> None:
    """Write results.json whole or not at all."""
    write_whole(path, dumps(results_to_json(results), indent=1) + "\n")


def read_results(path: Path) -> Results:
    """Read results.json, given itself or its folder. Raises `RunError` for what is missing or malformed."""
    path = path / RESULTS_FILE if path.is_dir() else path
    try:
        document = json.loads(read_regular(path, MAX_FILE_BYTES).decode("utf-8"))
    except FileNotFoundError:
        raise RunError(f"{path} does not exist; give the --out folder of a finished run") from None
    except OSError as error:
        raise RunError(f"{path} cannot be read ({reason_of(error)}); give the --out folder of a finished run") from None
    except (ValueError, RecursionError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None
    return results_from_json(document, str(path))


def write_whole(path: Path, text: str) -> None:
    """Write a file so that a kill at any moment leaves the old one or the new one.

    Raises `RunError` where it cannot be written; then the old one stays, and nothing is left beside it.
    """
    with writing(path, RunError):
        # What a policy says may hold lone surrogates, which no encoding has.
        replace_file(path, text.encode("utf-8", "backslashreplace"))
