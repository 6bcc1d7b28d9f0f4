"""`evaluate`: scores a policy from a script or notebook in one call."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from cognitivedrone.adapters import as_policy, as_reasoner
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports.tables import as_text, results_table
from cognitivedrone.benchmark.runs.runner import Interrupted, run
from cognitivedrone.benchmark.scores.results import Results
from cognitivedrone.benchmark.scores.scoring import Summary
from cognitivedrone.errors import RunError
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.interfaces import PolicyLike, ReasonerLike
from cognitivedrone.pilot import Pilot
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import NONE, make_reasoner
from cognitivedrone.text.printable import visible


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The result of `evaluate`. Printed, it is the table of the command `bench`."""

    results: Results
    """All episodes and the run's identity; the content of results.json."""

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
    policy: str | PolicyLike | Callable[[], PolicyLike] = "small",
    suite: str | PathLike[str] | Plan = "open-v1:smoke",
    *,
    reasoner: str | ReasonerLike | Callable[[], ReasonerLike] | None = None,
    progress: bool = True,
    **options: Any,
) -> Evaluation:
    """Fly a policy through a suite of tasks and score it, as `cognitivedrone bench` does.

        from cognitivedrone import evaluate

        evaluation = evaluate(MyPolicy(), suite="open-v1:test")
        print(evaluation, evaluation.summary.overall.rate)

    `policy` and `reasoner` are a name as on the command line ("small", "my_module:MyPolicy:weights.pt,device=cpu"), an
    object, or a class or function that makes one. Names, and classes and functions that another process can import,
    fly in `workers` processes (by default as `bench`). Objects, and anything defined in a notebook or in the
    script itself, fly only in this process, with a message. `suite` is a name, a task file, or the `Plan` of a run,
    which may name the reasoner; the other options are those of `bench`, by name, such as `episodes` and `wind`.

    With `out`, records, results.json and report.html are written there (docs/benchmark.md); else nothing is kept.
    Raises `PolicyError` if the pilot cannot be made, `RunError` if the run cannot start or fails, `TypeError`
    for an unknown option; an exception of the policy's own counts as `policy_error` unless `fail_fast` is true.
    """
    if not isinstance(suite, Plan):
        suite = Plan.of(suite="", tasks=Path(suite)) if Path(suite).exists() else Plan.of(suite=os.fspath(suite))
    parts = {"policy": policy, "reasoner": suite.pilot.reasoner if reasoner is None else reasoner}
    names = {kind: _name_of(part) for kind, part in parts.items()}
    plan = suite.changed(**{kind: names[kind] or _description(part) for kind, part in parts.items()}, **options)
    with ExitStack() as undo:
        pilot, command = None, ""
        if here := {kind: part for kind, part in parts.items() if names[kind] is None}:
            _one_process(here, plan.workers, progress)
            plan = plan.changed(workers=0)
            pilot = Pilot(  # users close their own objects
                _part("policy", parts["policy"], "act", make_policy, as_policy, undo),
                _part("reasoner", parts["reasoner"], "refine", make_reasoner, as_reasoner, undo),
            )
            command = _call_of(plan)
        kept = plan.out is not None
        if not kept:
            folder = undo.enter_context(TemporaryFolder())
            plan = plan.changed(out=folder / "run", clips=0)
        try:
            return Evaluation(run(plan, progress=progress, pilot=pilot, command=command))
        except Interrupted as stopped:
            told = str(stopped).partition(", all kept")[0]
            way_out = "continue with resume=True" if kept else "out=FOLDER keeps them, and resume=True continues"
            raise Interrupted(f"{told}; {way_out}") from None


def _name_of(part: object) -> str | None:
    """The name by which another process can make `part`; none if there is none."""
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
    """Name of a user's object in the results."""
    kind = part if hasattr(part, "__qualname__") else type(part)
    return f"{kind.__module__}.{kind.__qualname__}"


def _call_of(plan: Plan) -> str:
    """The call that repeats a run of objects, without options that do not affect the results."""
    named = ("policy", "reasoner", "suite", "tasks")
    options = [f"{name}={value!r}" for name, value in plan.changes().items() if name not in named]
    pilot, scenario = plan.pilot.shown, plan.scenario
    reasoner = [] if pilot.reasoner == NONE else [f"reasoner={pilot.reasoner}"]
    where = repr(str(scenario.tasks or scenario.suite))
    return f"evaluate({', '.join([pilot.policy, where, *reasoner, *options])})"


def _one_process(here: Mapping[str, object], workers: int | None, progress: bool) -> None:
    """Say why what is given for policy or reasoner flies in this process; more workers raise `RunError`."""
    objects = any(not hasattr(part, "__qualname__") for part in here.values())
    why = " and ".join(_why_here(kind, part) for kind, part in here.items())
    way_out = "pass a class of a module" if objects else "put it into a module"
    if workers not in (None, 0, 1):
        raise RunError(f"workers={workers}, but {why}; {way_out} to use more than one process")
    if progress:
        notice = f"flying in one process, because {why}; {way_out} to use more cores"
        print(visible(notice), file=sys.stderr)  # noqa: T201


def _why_here(kind: str, part: object) -> str:
    """Why other processes cannot import a policy or reasoner."""
    if not hasattr(part, "__qualname__"):
        return f"the {kind} is an object"
    what = "class" if isinstance(part, type) else "function"
    where = "in the script itself" if part.__module__ == "__main__" else "where no other process can import it"
    return f"the {kind}'s {what} is defined {where}"


def _part(
    kind: str, given: Any, method: str, make: Callable[[str], Any], adapt: Callable[[str, Any], Any], undo: ExitStack
) -> Any:
    """A policy or reasoner from its name, from a class or function, or from an object. Raises `PolicyError`."""
    is_factory = isinstance(given, type) or (not hasattr(given, method) and callable(given))
    if isinstance(given, str):
        part = make(given)
    else:
        made = given() if is_factory else given
        part = adapt(f"the {kind} {_description(made)}", made)
    if part is not None and (is_factory or isinstance(given, str)):
        undo.callback(part.close)
    return part
