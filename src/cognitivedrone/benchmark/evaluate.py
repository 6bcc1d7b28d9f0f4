"""Score a policy from a script or a notebook, in one call."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from cognitivedrone.benchmark.episode import Pilot
from cognitivedrone.benchmark.results import Results
from cognitivedrone.benchmark.run_types import LookName, RunConfig
from cognitivedrone.benchmark.runner import run
from cognitivedrone.benchmark.scoring import Summary
from cognitivedrone.benchmark.tables import as_text, results_table
from cognitivedrone.errors import PluginError, RunError
from cognitivedrone.interfaces import Policy, Reasoner
from cognitivedrone.policies import make_policy
from cognitivedrone.printable import visible
from cognitivedrone.reasoners import NONE, make_reasoner

Part = TypeVar("Part")


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What `evaluate` found: printed, it is the table that the command prints."""

    results: Results
    """Every episode, and what identifies the run; the content of results.json."""

    @property
    def summary(self) -> Summary:
        """The scores, such as `summary.overall.rate` and `summary.families["letters"].ci95`."""
        return self.results.summary()

    def table(self) -> str:
        """The scores as text, 80 columns wide."""
        return as_text(results_table(self.results))

    def __str__(self) -> str:
        return self.table()


def evaluate(
    policy: str | Policy | Callable[[], Policy] = "small",
    suite: str | Path = "open-v1:smoke",
    *,
    reasoner: str | Reasoner | Callable[[], Reasoner] | None = None,
    episodes: int | None = None,
    workers: int | None = None,
    seed: int = 0,
    track: bool = False,
    look: LookName = "plain",
    airframe: str = "racer",
    wind: float = 0.0,
    latency: str = "none",
    labels: Path | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    resume: bool = False,
    clips: int = 12,
    decision_timeout: float = 60.0,
    fail_fast: bool = False,
    progress: bool = True,
) -> Evaluation:
    """Fly a policy through a suite of tasks and score it, as `cognitivedrone bench` does.

        from cognitivedrone import evaluate

        evaluation = evaluate(MyPolicy(), suite="open-v1:test")
        print(evaluation, evaluation.summary.overall.rate)

    `policy` and `reasoner` are a name as on the command line ("small", "my_module:MyPolicy:weights.pt,device=cpu"), an
    object, or a class or function that makes one. Names, and classes and functions that another process can import,
    fly in `workers` processes, as many as there are cores by default; objects, and what is defined in a notebook or in
    the script itself, fly in this process alone, and a message says so. `suite` is a name or a task file.

    With `out` the folder keeps records, results.json and report.html, as docs/results.md describes; without it nothing
    is kept. The other options are those of `bench`. Raises `PolicyError` where the pilot cannot be made, `RunError`
    where the run cannot be started or went wrong; an exception of the policy's own counts as `policy_error` unless
    `fail_fast` is true.
    """
    names = {"policy": _name_of(policy), "reasoner": NONE if reasoner is None else _name_of(reasoner)}
    here = [kind for kind, name in names.items() if name is None]
    as_file = Path(suite).exists()
    config = RunConfig(
        policy=names["policy"] or _description(policy),
        reasoner=names["reasoner"] or _description(reasoner),
        suite="" if as_file else str(suite),
        tasks=Path(suite) if as_file else None,
        labels=labels,
        workers=workers,
        track=track,
        seed=seed,
        episodes=episodes,
        look=look,
        airframe=airframe,
        wind=wind,
        latency=latency,
        out=out,
        overwrite=overwrite,
        resume=resume,
        clips=clips if out is not None else 0,
        decision_timeout=decision_timeout,
        fail_fast=fail_fast,
    )
    pilot = None
    if here:
        _one_process(" and ".join(here), workers, progress)
        config = replace(config, workers=0)
        pilot = replace(_pilot(policy, reasoner), command=_call_of(config))
    if out is not None:
        return Evaluation(run(config, progress=progress, pilot=pilot))
    with tempfile.TemporaryDirectory(prefix="cognitivedrone-") as folder:
        return Evaluation(run(replace(config, out=Path(folder) / "run"), progress=progress, pilot=pilot))


def _name_of(part: object) -> str | None:
    """The name by which another process can make `part`; none where it cannot."""
    if isinstance(part, str):
        return part
    module, name = getattr(part, "__module__", None), getattr(part, "__qualname__", None)
    if not callable(part) or not module or not name or module == "__main__":
        return None
    try:
        found = getattr(importlib.import_module(module), name, None)
    except ImportError:
        return None
    return f"{module}:{name}" if found is part else None


def _description(part: object) -> str:
    """What the results call an object of the user's."""
    kind = part if hasattr(part, "__qualname__") else type(part)
    return f"{kind.__module__}.{kind.__qualname__}"


def _call_of(config: RunConfig) -> str:
    """The call that repeats a run of objects: without what does not change its results."""
    default = RunConfig(policy="", suite="")
    shown = ["seed", "track", "episodes", "look", "airframe", "wind", "latency", "labels"]
    options = [f"{name}={value!r}" for name in shown if (value := getattr(config, name)) != getattr(default, name)]
    reasoner = [] if config.reasoner == NONE else [f"reasoner={config.reasoner}"]
    return f"evaluate({', '.join([config.policy, repr(str(config.tasks or config.suite)), *reasoner, *options])})"


def _one_process(what: str, workers: int | None, progress: bool) -> None:
    why = (
        f"the {what} can be used in this process alone, because other processes cannot import it; for more workers"
        " give a class or function of a module, or its name as module:attribute"
    )
    if workers not in (None, 0, 1):
        raise RunError(f"workers={workers}, but {why}")
    if progress:
        print(visible(why), file=sys.stderr)  # noqa: T201


def _pilot(policy: Any, reasoner: Any) -> Pilot:
    made_policy: Policy = make_policy(policy) if isinstance(policy, str) else _made("policy", policy, ("reset", "act"))
    made_reasoner: Reasoner | None
    if reasoner is None or isinstance(reasoner, str):
        made_reasoner = make_reasoner(reasoner or NONE)
    else:
        made_reasoner = _made("reasoner", reasoner, ("refine",))
    return Pilot(made_policy, made_reasoner, lent=True)


def _made(kind: str, part: Any, methods: tuple[str, ...]) -> Any:
    """An object from itself, or from what makes it. Raises `PolicyError` where it lacks a method."""
    made = part() if isinstance(part, type) or (not hasattr(part, methods[-1]) and callable(part)) else part
    missing = [method for method in methods if not callable(getattr(made, method, None))]
    if missing:
        raise PluginError(
            f"the {kind} {_description(made)} has no method {missing[0]}(); see cognitivedrone.interfaces"
        )
    return made
