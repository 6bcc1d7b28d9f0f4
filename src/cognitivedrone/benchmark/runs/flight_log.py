"""The benchmark's record of one flight: path, frames, and what the reasoner did in each stage."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from cognitivedrone.benchmark.scores.run_types import Trace
from cognitivedrone.control.async_reasoner import ANSWER_S
from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.errors import ReasonerFault
from cognitivedrone.film.frame import FilmFrame
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.tasks.directives import declines, fitting_gate, parse_directive
from cognitivedrone.types import (
    Action,
    Event,
    FloatArray,
    Gate,
    Guidance,
    Observation,
    ReasonerReport,
    StageResult,
)

FAULTS: tuple[ReasonerFault, ...] = get_args(ReasonerFault)


@dataclass
class _Stage:
    """What the reasoner returned in one stage."""

    first_step: int
    directive: str | None = None
    answers: int = 0
    adopted: int = 0
    late: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    ages_s: list[float] = field(default_factory=list)


class FlightLog:
    """Records path, frames and directives of one flight of a track."""

    def __init__(self, track_runner: TrackRunner, *, keep_frames: bool, reasoner: Reasoner | None = None) -> None:
        self.track_runner = track_runner
        self._reasoner = reasoner
        self.keep_frames = keep_frames
        self.path: list[FloatArray] = []
        self.frames: list[FilmFrame] = []
        self._stages: list[_Stage] = []
        self.guidance: Guidance | None = None
        """The directive of the last step."""

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        """One control step."""
        self.guidance = guidance
        state = self.track_runner.world.state()
        self.path.append(state.position.copy())
        if self.keep_frames:
            image, asked = observation.image.copy(), observation.instruction
            stage, pose = len(self._stages) - 1, (self.path[-1], state.quaternion.copy())
            own = self.track_runner.track[stage].instruction
            seen = () if self._reasoner is None else tuple(self._reasoner.seen)
            self.frames.append(FilmFrame(image, asked, guidance, action, observation.time, stage, own, *pose, seen))
        if guidance is not None:
            self._stages[-1].directive = guidance.directive
            self._stages[-1].ages_s.append(guidance.age)

    def note(self, event: Event) -> None:
        """A new stage, an event of the reasoner, or the pilot declines or no longer does."""
        if event.kind == "segment":
            self._stages.append(_Stage(len(self.path)))
        elif event.kind in ("declined", "resumed"):
            self.track_runner.decline(event.kind == "declined")
        elif event.kind in FAULTS:
            self._stages[-1].faults[event.kind] += 1
        elif event.kind in ("adopted", "agreed", "kept"):
            self._stages[-1].answers += 1
            self._stages[-1].adopted += event.kind == "adopted"
        if event.age_s is not None and (event.kind in FAULTS or event.kind in ("adopted", "agreed", "kept")):
            self._stages[-1].late += event.age_s > ANSWER_S

    def results(self) -> tuple[StageResult, ...]:
        """The stages' results, each with its reasoner report."""
        results = []
        for index, (result, task) in enumerate(zip(self.track_runner.results, self.track_runner.track, strict=True)):
            stage = self._stages[index] if index < len(self._stages) else None
            if stage is None or not (stage.answers or stage.faults):
                results.append(result)
                continue
            report = _report(stage, result.time_s, task.gates, task.target)
            results.append(replace(result, directive=stage.directive, reasoner=report))
        return tuple(results)

    def trace(self, decision_s: float) -> Trace:
        """The flight path, including the last position."""
        path = np.array([*self.path, self.track_runner.world.state().position], dtype=np.float32)
        stages = tuple(self.track_runner.stages[: len(self._stages)])
        return Trace(path, stages, tuple(stage.first_step for stage in self._stages), decision_s)


def _report(stage: _Stage, seconds: float, gates: Sequence[Gate], target: int | None) -> ReasonerReport:
    faults = sum(stage.faults.values())
    directive = stage.directive or ""
    directed = parse_directive(directive)
    right = (None,) * 3 if target is None else (gates[target].size, gates[target].color, gates[target].shape)
    size, color, shape = (None if mine is None else mine == gold for mine, gold in zip(directed, right, strict=True))
    return ReasonerReport(
        answers=stage.answers,
        faults=dict(sorted(stage.faults.items())),
        changes=max(0, stage.adopted - 1),
        age_s=round(statistics.fmean(stage.ages_s), 4) if stage.ages_s else None,
        rate_hz=round((stage.answers + faults) / seconds, 4) if seconds else None,
        size=size,
        color=color,
        shape=shape,
        gate=declines(directive) if target is None else fitting_gate(directive, gates) == target,
        late=stage.late,
    )
