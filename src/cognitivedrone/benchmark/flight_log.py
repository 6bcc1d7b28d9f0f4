"""The benchmark's record of one flight: path, frames, and what the reasoner did in each stage."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from cognitivedrone.benchmark.run_types import FilmFrame, Trace
from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.errors import ReasonerFault
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
    faults: Counter[str] = field(default_factory=Counter)
    ages_s: list[float] = field(default_factory=list)


class FlightLog:
    """Records path, frames and directives of one flight of a track."""

    def __init__(self, track_runner: TrackRunner, *, keep_frames: bool) -> None:
        self.track_runner = track_runner
        self.keep_frames = keep_frames
        self.path: list[FloatArray] = []
        self.frames: list[FilmFrame] = []
        self._stages: list[_Stage] = []

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        """One control step."""
        self.path.append(self.track_runner.world.state().position.copy())
        if self.keep_frames:
            image, told = observation.image.copy(), observation.instruction
            self.frames.append(FilmFrame(image, told, guidance, action, observation.time, len(self._stages) - 1))
        if guidance is not None:
            self._stages[-1].directive = guidance.directive
            self._stages[-1].ages_s.append(guidance.age)

    def note(self, event: Event) -> None:
        """A new stage, an event of the reasoner, or the pilot declines or no longer does."""
        if event.kind == "leg":
            self._stages.append(_Stage(len(self.path)))
        elif event.kind in ("declined", "resumed"):
            self.track_runner.decline(event.kind == "declined")
        elif event.kind in FAULTS:
            self._stages[-1].faults[event.kind] += 1
        elif event.kind in ("adopted", "agreed", "kept"):
            self._stages[-1].answers += 1
            self._stages[-1].adopted += event.kind == "adopted"

    def results(self) -> tuple[StageResult, ...]:
        """The stages' results, each with its reasoner report."""
        told = []
        for index, (result, task) in enumerate(zip(self.track_runner.results, self.track_runner.track, strict=True)):
            stage = self._stages[index] if index < len(self._stages) else None
            if stage is None or not (stage.answers or stage.faults):
                told.append(result)
                continue
            report = _report(stage, result.time_s, task.gates, task.target)
            told.append(replace(result, directive=stage.directive, reasoner=report))
        return tuple(told)

    def trace(self, decision_s: float) -> Trace:
        """The flight path, including the last position."""
        path = np.array([*self.path, self.track_runner.world.state().position], dtype=np.float32)
        stages = tuple(self.track_runner.stages[: len(self._stages)])
        return Trace(path, stages, tuple(stage.first_step for stage in self._stages), decision_s)


def _report(stage: _Stage, seconds: float, gates: Sequence[Gate], target: int | None) -> ReasonerReport:
    faults = sum(stage.faults.values())
    directive = stage.directive or ""
    said = parse_directive(directive)
    right = (None,) * 3 if target is None else (gates[target].size, gates[target].color, gates[target].shape)
    size, color, shape = (None if mine is None else mine == gold for mine, gold in zip(said, right, strict=True))
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
    )
