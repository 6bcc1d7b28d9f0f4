"""`resolve`: a plan becomes a `Job`, once; below it no name is looked up, and every worker gets the job unchanged.

And the shards of a run: n equal parts, each flown on its own and joined to the others by `merge`.

Provenance of a run besides its options: machine, commit, the user's own modules, command line.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import shlex
import sysconfig
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cognitivedrone import checkout, policies, reasoners, registry, system
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.scores.results import FILES, REQUIRED, RunFacts, SuiteFacts, versions
from cognitivedrone.control.latency import Delays, parse_delays
from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.errors import LabelError, RunError
from cognitivedrone.files import digest_of_files
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.labels import load_pack
from cognitivedrone.labels.folder import digest_of_labels
from cognitivedrone.plan import PilotSpec, Scenario
from cognitivedrone.policies import POLICIES, policy_files
from cognitivedrone.reasoners import NONE, REASONERS, reasoner_files
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.system.interrupts import is_ctrl_c
from cognitivedrone.tasks import SUITES, Suite
from cognitivedrone.tasks.suites import CONDITIONS, suite_of, suite_of_tracks
from cognitivedrone.types import Track
from cognitivedrone.vehicles import autopilot_file, check_tracks, check_vehicle
from cognitivedrone.vehicles.contract import Request
from cognitivedrone.world.places import known_as


def platform_facts(command: str, policy: str = "", reasoner: str = "") -> dict[str, str]:
    """The machine, the source and the command, as text.

    For a user's own policy or reasoner ("module:attribute") this includes the file of its module, and the command
    includes the PYTHONPATH that finds it.
    """
    facts = {
        "command": command,
        "commit": checkout.commit() or "none",
        "system": system.name(),
        "machine": platform.machine(),
        "processor": system.processor(),
        "cores": str(os.cpu_count() or 1),
    }
    installed = {Path(path).resolve() for path in sysconfig.get_paths().values()}  # they need no PYTHONPATH
    roots: list[str] = []
    for kind, name, table in (("policy", policy, POLICIES), ("reasoner", reasoner, REASONERS)):
        file = own_module(name, table)
        if file is None:
            continue
        facts[f"{kind}_file"] = _shown(file)
        root = file.parents[name.partition(":")[0].count(".") + (file.name == "__init__.py")]
        roots += [_shown(root)] if root not in installed and _shown(root) not in roots else []
    if roots:
        facts["command"] = f"PYTHONPATH={shlex.quote(os.pathsep.join(roots))} {command}"
    return facts


def own_module(name: str, table: Mapping[str, str]) -> Path | None:
    """The source file of a user's own plug-in "module:attribute"; none for names in `table`, or without a file."""
    module, colon, _ = name.partition(":")
    if not colon or module in table:
        return None
    try:
        spec = importlib.util.find_spec(module)
    except BaseException as error:  # whatever the user's package raises; making the plug-in reports it
        if is_ctrl_c(error):
            raise
        return None
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return None
    return Path(spec.origin).resolve()


def _shown(path: Path) -> str:
    """The path, relative to the current folder if it is inside it."""
    here = Path.cwd().resolve()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


@dataclass(frozen=True, order=True, slots=True)
class Shard:
    """Part `number` of `count`, written "2/8": every eighth episode, from the second."""

    number: int
    """From 1."""
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def of(self, episodes: range) -> range:
        """Its share of the episodes; neighbours, which are often of one family, go to different shards."""
        return episodes[self.number - 1 :: self.count]


def parse_shard(text: str) -> Shard:
    """The shard written as "i/n", i from 1 to n. Raises `RunError`."""
    found = re.fullmatch(r"([1-9][0-9]{0,5})/([1-9][0-9]{0,5})", text)
    shard = Shard(*map(int, found.groups())) if found else None
    if shard is None or shard.number > shard.count:
        raise RunError(f"--shard is {text!r}; give i/n, such as 2/8 for the second of eight parts")
    return shard


MOST_NAMED = 20
"""Pictures that are missing, named in one error."""


@dataclass(frozen=True, slots=True)
class Job:
    """A plan with everything that its names stand for."""

    plan: Plan
    suite: Suite
    facts: RunFacts
    """The identity of the run."""
    delays: Delays
    """Inference latency to charge."""
    episodes: range
    """Indices of the tracks to fly."""
    request: Request
    """The vehicle, with its scene."""


def resolve(plan: Plan, *, named: bool = True) -> Job:
    """Look up and check everything that a plan names, before anything is started or written.

    If the pilot is not `named` but passed as objects, its files are unknown. Raises `RunError` for a vehicle or suite
    that cannot be flown like that, and the specific error for anything that is missing.
    """
    scenario = plan.scenario
    check_vehicle(plan.vehicle, scenario)
    _check_conditions(scenario)
    suite = suite_of(scenario, plan.episodes)
    delays = parse_delays(plan.latency)
    policy, reasoner = plan.pilot.policy, plan.pilot.reasoner
    models, answers = (policy_files(policy), reasoner_files(reasoner)) if named else ((), ())
    autopilot = autopilot_file(plan.vehicle)
    labels = scenario.labels
    resolved = {
        "labels": None if labels is None else digest_of_labels(labels),
        "latency": delays.identity,
        "place": known_as(scenario.place),
    }
    pack = load_pack(labels)
    asked = suite
    if labels is not None or suite.name not in SUITES:  # the shipped pack draws every shipped suite
        suite = _drawn(suite, pack, plan)
    options = plan.identity(resolved) | {"model": digest_of_files(*models) if models else None}
    own = {"policy_code": own_module(policy, POLICIES), "reasoner_code": own_module(reasoner, REASONERS)}
    optional = {**(own if named else {}), "autopilot": autopilot}
    read = {"reasoner_model": answers, **{key: (file,) for key, file in optional.items() if file is not None}}
    options |= {key: digest_of_files(*files) for key, files in read.items() if files}
    recorded = plan.pilot.shown
    facts = RunFacts(
        suite=SuiteFacts(suite.name, suite.digest, suite.n_tasks, None if suite is asked else asked.n_tasks),
        policy=recorded.policy,
        reasoner=recorded.reasoner,
        options={key: options[key] for key in (*REQUIRED, *options)},  # keeps the order of existing files
        versions=versions(),
    )
    episodes = range(len(suite.tracks))[: plan.episodes]
    if plan.shard is not None:
        episodes = parse_shard(plan.shard).of(episodes)
    if not episodes:
        raise RunError(f"--shard {plan.shard} has no episode; give at most as many shards as the run has episodes")
    check_tracks(plan.vehicle, (suite.tracks[index] for index in episodes))
    request = Request(plan.vehicle, pack, find_airframe(scenario.airframe), TrackConfig.of(scenario))
    return Job(plan, suite, facts, delays, episodes, request)


def plan_of(facts: RunFacts, pilot: PilotSpec, **changes: object) -> Plan:
    """The plan of a recorded run, with a pilot; `changes` give what a run records only by its hash."""
    names = Plan.identity_names()
    given = {
        names[key]: value for key, value in facts.options.items() if key in names and key not in ("episodes", *FILES)
    }
    return Plan.of(**{"pilot": pilot, "suite": facts.suite.name, **given, **changes})


def pilot_of(facts: RunFacts, policy: str | None, reasoner: str | None) -> PilotSpec:
    """Who flew a recorded run. A user's own code is imported only if it is given here, not because a file names it."""
    if policy is None:
        registry.check_self_contained("policy", facts.policy, POLICIES, policies.SELF_CONTAINED)
    if reasoner is None and facts.reasoner != NONE:
        registry.check_self_contained("reasoner", facts.reasoner, REASONERS, reasoners.SELF_CONTAINED)
    return PilotSpec(policy or facts.policy, reasoner or facts.reasoner)


def _drawn(suite: Suite, pack: LabelPack, plan: Plan) -> Suite:
    """The suite, of which every picture has been drawn; with --missing skip, its tracks that have all of theirs.

    Raises `LabelError` that names all pictures that are missing, each with what is near.
    """
    missing: dict[str, str] = {}
    used = suite.tracks if plan.missing == "skip" else suite.tracks[: plan.episodes]
    for reference in sorted({reference for track in used for reference in _references(track)}):
        try:
            pack.image(reference)
        except LabelError as error:
            missing[reference] = str(error)
    if not missing:
        return suite
    kept = [track for track in used if missing.keys().isdisjoint(_references(track))]
    if plan.missing == "skip" and kept:
        return suite_of_tracks(suite.name, kept)
    first, *others = missing.values()
    if not others and kept:
        raise LabelError(first)
    words = f"{len(used) - len(kept)} of {len(used)} tasks of {suite.name} lack a picture"
    if plan.scenario.labels is None:
        raise LabelError(f"{words}: --tasks of one's own need their pictures; add --labels FOLDER ({first})")
    shown = "; ".join([first, *others][:MOST_NAMED]) + (
        f"; and {more} more" if (more := len(others) + 1 - MOST_NAMED) > 0 else ""
    )
    raise LabelError(f"{words}; add them, or leave the tasks out with --missing skip: {shown}")


def _references(track: Track) -> set[str]:
    """The label references of everything that a track shows."""
    marks = {task.landmark.label for task in track if task.landmark}
    return marks | {reference for task in track for reference in (*task.labels, task.board) if reference}


def _check_conditions(scenario: Scenario) -> None:
    """Raise `RunError` for a suite that is scored under other conditions."""
    conditions = CONDITIONS.get(scenario.suite, {}) if scenario.tasks is None else {}
    if any(getattr(scenario, name) != value for name, value in conditions.items()):
        words = " ".join(f"--{name} {value}" for name, value in conditions.items())
        raise RunError(f"suite {scenario.suite!r} is scored under its own conditions only; add {words}")
