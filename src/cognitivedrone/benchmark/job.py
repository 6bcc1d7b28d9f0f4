"""A checked run: the plan with all its names resolved, once, and sent unchanged to every worker."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.provenance import own_module
from cognitivedrone.benchmark.results import REQUIRED, RunFacts, SuiteFacts, versions
from cognitivedrone.benchmark.shard import parse_shard
from cognitivedrone.control.latency import Delays, parse_delays
from cognitivedrone.errors import RunError
from cognitivedrone.files import digest_of_file, digest_of_folder
from cognitivedrone.labels import load_pack
from cognitivedrone.policies import POLICIES, model_file
from cognitivedrone.reasoners import REASONERS, reasoner_file
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.tasks import SUITES, Suite
from cognitivedrone.tasks.scenario import suite_of
from cognitivedrone.vehicles import autopilot_file, check_vehicle


@dataclass(frozen=True, slots=True)
class Job:
    """A plan with everything that its names stand for."""

    plan: Plan
    suite: Suite
    facts: RunFacts
    """The identity of the run."""
    delays: Delays
    """Inference latency to charge."""

    @property
    def episodes(self) -> range:
        """Indices of the tracks to fly."""
        whole, limit = len(self.suite.tracks), self.plan.episodes
        episodes = range(whole if limit is None else min(limit, whole))
        return episodes if self.plan.shard is None else parse_shard(self.plan.shard).of(episodes)


def prepare(plan: Plan, *, named: bool = True) -> Job:
    """Resolve and check everything that a plan names, before anything is started or written.

    If the pilot is not `named` but passed as objects, its files are unknown. Raises `RunError` for invalid options, and
    the specific error for anything that is missing.
    """
    suite = suite_of(plan.scenario, plan.episodes)
    _check(plan)
    delays = parse_delays(plan.latency)
    policy, reasoner = plan.pilot.policy, plan.pilot.reasoner
    model, answers = (model_file(policy), reasoner_file(reasoner)) if named else (None, None)
    autopilot = autopilot_file(plan.vehicle)
    labels = plan.scenario.labels
    resolved = {"labels": None if labels is None else digest_of_folder(labels), "latency": delays.identity}
    options = plan.identity(resolved) | {"model": None if model is None else digest_of_file(model)}
    own = {"policy_code": own_module(policy, POLICIES), "reasoner_code": own_module(reasoner, REASONERS)}
    optional = {"reasoner_model": answers, **(own if named else {}), "autopilot": autopilot}
    options |= {key: digest_of_file(file) for key, file in optional.items() if file is not None}
    facts = RunFacts(
        suite=SuiteFacts(suite.name, suite.digest, suite.n_tasks),
        policy=policy,
        reasoner=reasoner,
        options={key: options[key] for key in (*REQUIRED, *options)},  # keeps the order of existing files
        versions=versions(),
    )
    job = Job(plan, suite, facts, delays)
    if not job.episodes:
        raise RunError(f"--shard {plan.shard} has no episode; give at most as many shards as the run has episodes")
    return job


def preflight(job: Job) -> None:
    """Check that the run can fly, before a process is started; raises the error for whatever is missing."""
    scenario = job.plan.scenario
    find_airframe(scenario.airframe)
    check_vehicle(job.plan.vehicle, scenario)
    if scenario.labels is None and job.suite.name in SUITES:
        return  # the shipped pack draws every shipped suite
    pack = load_pack(scenario.labels)
    tasks = [task for index in job.episodes for task in job.suite.tracks[index]]
    for reference in sorted({reference for task in tasks for reference in (*task.labels, task.board) if reference}):
        pack.image(reference)


def _check(plan: Plan) -> None:
    for name, value, least in (("episodes", plan.episodes, 1), ("workers", plan.workers, 0)):
        if value is not None and value < least:
            raise RunError(f"--{name} is {value}; it must be at least {least}")
    if not 0 < plan.decision_timeout < math.inf:
        raise RunError(f"--decision-timeout is {plan.decision_timeout}; it must be above 0 seconds")
    labels, wind = plan.scenario.labels, plan.scenario.wind
    if labels is not None and not labels.is_dir():
        raise RunError(f"--labels {labels} is not a folder of images")
    if not 0 <= wind < math.inf:
        raise RunError(f"--wind is {wind}; it must be 0 m/s or more")
    if plan.vehicle.kind == "mavlink":
        raise RunError(f"--link {plan.vehicle.link}: a real flight cannot be scored; fly it with cognitivedrone fly")
    _check_executor(plan)
    if plan.vehicle.kind == "gazebo" and plan.workers not in (None, 0, 1):
        raise RunError(f"--link gazebo has a single vehicle, so --workers {plan.workers} is too many; leave it out")


def _check_executor(plan: Plan) -> None:
    if plan.cpus_per_worker < 1:
        raise RunError(f"--cpus-per-worker is {plan.cpus_per_worker}; it must be at least 1")
    if not 0 <= plan.gpus_per_worker < math.inf:
        raise RunError(f"--gpus-per-worker is {plan.gpus_per_worker}; it must be 0 or more")
    if plan.executor == "local":
        if plan.changed(cpus_per_worker=1, gpus_per_worker=0.0) != plan:
            raise RunError("--cpus-per-worker and --gpus-per-worker are for --executor ray; leave them out, or add it")
    elif plan.workers == 0:
        raise RunError("--workers 0 flies in this process; leave out --executor ray, or give at least one worker")
    elif plan.vehicle.kind == "gazebo":
        raise RunError("--link gazebo flies the one vehicle of this machine; leave out --executor ray")
