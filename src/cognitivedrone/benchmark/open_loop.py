"""A policy on recorded flights, without flying: how far its commands are from the recorded ones (`predict`).

The paper's three training curves: L1 error of the action, its accuracy, and the cross-entropy of its tokens. Each step
is asked with the recorded frame and state, in the order of the flight; the first command of the answer counts.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.text import Text

from cognitivedrone.benchmark.config import PredictPlan
from cognitivedrone.benchmark.reports.tables import DASH, new_table, words
from cognitivedrone.benchmark.runs.job import platform_facts
from cognitivedrone.benchmark.runs.runner import results_folder
from cognitivedrone.benchmark.scores.results import dumps, versions, write_whole
from cognitivedrone.control.calls import begin_stage, calling, check_chunk
from cognitivedrone.data.recorded import Recorded, check_scenes, observation_at, recorded, state_at
from cognitivedrone.envs.track_runner import stage_of
from cognitivedrone.errors import RunError
from cognitivedrone.interfaces import Policy
from cognitivedrone.policies import make_policy
from cognitivedrone.system.interrupts import watched
from cognitivedrone.terminal.progress import counted
from cognitivedrone.text.printable import shown_address
from cognitivedrone.types import ALL_CATEGORIES, EpisodeContext, FloatArray, GroundTruth, Observation

PREDICTIONS_FILE: Final = "predict.json"
SCHEMA: Final = "cognitivedrone.predict/1"


@runtime_checkable
class TokenPolicy(Protocol):
    """A policy whose actions may be tokens."""

    @property
    def has_tokens(self) -> bool:
        """Whether they are."""

    def token_answer(
        self, observation: Observation, action: FloatArray
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Of a true action's (4,) tokens, each given those before it: whether it is the likeliest one (4,), and its
        cross-entropy (4,), nats.
        """


@dataclass(frozen=True, slots=True)
class OpenLoopScore:
    """Over some steps; the lists are by dimension (vx, vy, vz m/s, yaw rate rad/s)."""

    steps: int
    l1: Sequence[float]
    """Mean absolute error."""
    mean_l1: float
    accuracy: float
    """Share of components that are right: tokens, or within the tolerance."""
    cross_entropy: float | None
    """Mean over the tokens, nats; none for a policy without tokens."""


def predict(plan: PredictPlan) -> dict[str, OpenLoopScore]:
    """Ask, score and write predict.json; the scores are overall and by category.

    Raises `DataError` for flights that cannot be read, `PolicyError` for a policy that cannot answer, and `RunError`
    where no flight is in the split.
    """
    flights = [each for each in recorded(plan.flights) if plan.split in ("all", each.split)][: plan.episodes]
    if not flights:
        raise RunError(f"{plan.flights} has no flight in its split {plan.split}; give --split all")
    policy = make_policy(plan.policy)
    policy.check()
    if policy.needs_ground_truth:
        check_scenes(flights, plan.flights)
    rows: dict[str, list[FloatArray]] = {}
    with closing(policy), watched():
        for number, flight in enumerate(counted(flights, "asking", len(flights))):
            rows.setdefault(flight.task.category, []).extend(_answers(policy, flight, number, plan))
    tokens = isinstance(policy, TokenPolicy) and policy.has_tokens
    parts = {"overall": [row for part in rows.values() for row in part]}
    parts |= {category: rows[category] for category in ALL_CATEGORIES if category in rows}
    scores = {name: _score(np.array(part), plan.tolerance, tokens=tokens) for name, part in parts.items()}
    document = {
        "schema": SCHEMA,
        "flights": plan.flights.absolute().name,
        "policy": shown_address(plan.policy),
        "options": {"split": plan.split, "every": plan.every, "tolerance": plan.tolerance, "episodes": len(flights)},
        "accuracy": "tokens" if tokens else f"within {plan.tolerance:g} m/s or rad/s",
        "scores": scores,
        "versions": versions(),
        "platform": platform_facts(shlex.join(["cognitivedrone", "predict", *map(shown_address, plan.words())])),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    write_whole(out_of(plan), dumps(document, indent=1) + "\n")
    return scores


def out_of(plan: PredictPlan) -> Path:
    """The file of the scores: the one given, or in a folder named after flights and policy."""
    if plan.out is not None:
        return plan.out
    folder = results_folder("predict", plan.flights.absolute().name, shown_address(plan.policy))
    folder.mkdir(parents=True, exist_ok=True)
    return folder / PREDICTIONS_FILE


def _answers(policy: Policy, flight: Recorded, number: int, plan: PredictPlan) -> Iterator[FloatArray]:
    """(12,) of every step: the error, and of a policy with tokens what is right and the cross-entropy."""
    episode = flight.load()
    step = 0
    truth = GroundTruth(flight.task, stage_of(flight.task), lambda: state_at(episode, step))
    with calling("the policy"):
        begin_stage(policy, EpisodeContext(flight.task.instruction, number, 0, truth))
    for step in range(0, len(episode), plan.every):
        observation = observation_at(episode, step)
        with calling("the policy"):
            chunk = check_chunk(policy.act(observation))
        true = episode.action[step].astype(np.float64)
        right, entropy = np.zeros(4, np.bool_), np.full(4, np.nan)
        if isinstance(policy, TokenPolicy) and policy.has_tokens:
            with calling("the policy"):
                right, entropy = policy.token_answer(observation, true)
        yield np.concatenate([np.abs(chunk[0] - true), right, entropy])


def _score(rows: FloatArray, tolerance: float, *, tokens: bool) -> OpenLoopScore:
    error, right = rows[:, :4], rows[:, 4:8] if tokens else rows[:, :4] <= tolerance
    l1 = error.mean(axis=0)
    entropy = float(rows[:, 8:].mean()) if tokens else None
    return OpenLoopScore(len(rows), l1.tolist(), float(l1.mean()), float(right.mean()), entropy)


def predict_table(plan: PredictPlan, scores: Mapping[str, OpenLoopScore]) -> RenderableType:
    """The scores in 80 columns."""
    title = f"{plan.flights.absolute().name}: policy {shown_address(plan.policy)}, open loop"
    table = new_table(title, "", "steps", "L1", "vx", "vy", "vz", "yaw", "right", "entropy")
    for name, score in scores.items():
        entropy = DASH if score.cross_entropy is None else f"{score.cross_entropy:.3f}"
        cells: list[Any] = [f"{score.mean_l1:.3f}", *(f"{error:.3f}" for error in score.l1), f"{score.accuracy:.1%}"]
        table.add_row(words(name), str(score.steps), *cells, entropy, style="bold" if name == "overall" else "")
    tokens = any(score.cross_entropy is not None for score in scores.values())
    how = "tokens that are right" if tokens else f"numbers within {plan.tolerance:g} m/s or rad/s"
    return Group(table, Text(f"L1 in m/s and rad/s; right: {how}; entropy: cross-entropy in nats", style="dim"))
