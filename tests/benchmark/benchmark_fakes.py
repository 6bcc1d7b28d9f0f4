"""An episode runner without a simulator: made-up flights that depend on suite, episode and seed alone, as real ones."""

import hashlib
import io
import json
import os
import re
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from cognitivedrone.benchmark.runs.job import Job
from cognitivedrone.benchmark.scores.run_types import Rollout, Trace
from cognitivedrone.control.calls import NO_WATCH, Watch, calling
from cognitivedrone.errors import LabelError
from cognitivedrone.film.frame import FilmFrame
from cognitivedrone.types import EpisodeResult, Guidance, Outcome, Stage, StageResult, Task
from cognitivedrone.world import geometry

ENDINGS: tuple[Outcome, ...] = ("wrong_gate", "collision", "missed", "out_of_bounds", "timeout")


class FakeRunner:
    """Passes about two thirds; goes on behind gates like the real one."""

    renderer = "imagination"

    def __init__(self, job: Job, watch: Watch = NO_WATCH) -> None:
        self.suite = job.suite
        self.policy = job.plan.pilot.policy
        self.seed = job.plan.scenario.seed
        self.watch = watch

    def fly(self, episode: int, *, film: bool) -> Rollout:
        digest = hashlib.sha256(f"{self.suite.digest} {self.policy}".encode()).digest()
        rng = np.random.default_rng([int.from_bytes(digest[:8], "big"), episode, self.seed])
        track = self.suite.tracks[episode]
        results: list[StageResult] = []
        stages: list[Stage] = []
        starts: list[int] = []
        path = np.array([[-1.0, 0.0, 0.75]]) + rng.uniform(-0.5, 0.5, (1, 3))
        stage = Stage(gates=track[0].gates, labels=track[0].labels)
        for task in track:
            if results and results[-1].outcome not in ("passed", "wrong_gate"):
                results.append(not_reached(task))
                continue
            outcome: Outcome = "passed" if rng.random() < 0.65 else ENDINGS[rng.integers(len(ENDINGS))]
            gate = (task.target + 1) % 3 if outcome == "wrong_gate" else task.target
            stages.append(stage)
            starts.append(len(path) - 1)
            path = np.concatenate([path, way(stage, gate, path[-1], outcome, rng)])
            results.append(ended(task, outcome, gate, rng))
            origin, yaw = geometry.next_stage_origin(stage, gate)
            stage = Stage(gates=task.gates, labels=task.labels, origin=origin, yaw=yaw)
        result = EpisodeResult(episode, self.seed, tuple(results), len(path))
        trace = Trace(path.astype(np.float32), tuple(stages), tuple(starts), float(os.getpid()) * 1e-9)
        return Rollout(result, trace, [frame_of(track[0], k) for k in range(8)] if film else None)

    def close(self) -> None:
        """Nothing to free."""


class FifthFails(FakeRunner):
    """Something happens in episode 5."""

    def fly(self, episode: int, *, film: bool) -> Rollout:
        if episode == 5:
            self.fifth()
        return super().fly(episode, film=film)

    def fifth(self) -> None:
        """What happens."""


class DyingRunner(FifthFails):
    """Its process is killed."""

    fifth = staticmethod(lambda: os.kill(os.getpid(), signal.SIGKILL))


class LosingRunner(FifthFails):
    """Loses something once: the file `lost` beside the run's folder says that it is lost."""

    def __init__(self, job: Job, watch: Watch = NO_WATCH) -> None:
        super().__init__(job, watch)
        self.lost = job.plan.out.parent / "lost"


class OnceDyingRunner(LosingRunner):
    """Its process is killed, the first time."""

    killed = staticmethod(os.getpid)

    def fifth(self) -> None:
        if not self.lost.exists():
            self.lost.touch()
            os.kill(self.killed(), signal.SIGKILL)


class ActorLosingRunner(OnceDyingRunner):
    """The process that started it is killed, the first time."""

    killed = staticmethod(os.getppid)


class NodeLosingRunner(LosingRunner):
    """The Ray node whose process is in the file `doomed` is killed in its first episode; no other flies before."""

    def __init__(self, job: Job, watch: Watch = NO_WATCH) -> None:
        super().__init__(job, watch)
        self.doomed = int((job.plan.out.parent / "doomed").read_text())

    def fly(self, episode: int, *, film: bool) -> Rollout:
        actor = os.getppid()
        node = int(Path(f"/proc/{actor}/stat").read_text().rpartition(")")[2].split()[1])
        if node == self.doomed:
            os.kill(node, signal.SIGKILL)
            self.lost.touch()
            while os.getppid() == actor:
                time.sleep(0.01)
            os._exit(1)
        while not self.lost.exists():
            time.sleep(0.01)
        return super().fly(episode, film=film)


class BuggyRunner(FifthFails):
    """Raises something unforeseen."""

    def fifth(self) -> None:
        raise ZeroDivisionError("a bug in a policy")


class CallingRunner(FifthFails):
    """Something happens while its policy is called."""

    def fifth(self) -> None:
        with calling("the policy", self.watch):
            self.called()

    def called(self) -> None:
        """What happens."""


class HangingRunner(CallingRunner):
    """Its policy never answers, and keeps the interpreter to itself."""

    def called(self) -> None:
        re.match(r"(a+)+$", "a" * 60 + "b")


class QuittingRunner(CallingRunner):
    """Its policy ends the process, as if all were well."""

    called = staticmethod(lambda: os._exit(0))


class CrashingRunner(CallingRunner):
    """Its policy brings the process down."""

    called = staticmethod(lambda: os.kill(os.getpid(), signal.SIGSEGV))


class LeavingRunner(FifthFails):
    """Its process ends in good order, and nobody's policy is to blame."""

    fifth = staticmethod(lambda: os._exit(0))


class RaisingRunner(FakeRunner):
    """Its reasoner raises in episode 5, and the flight goes on."""

    def fly(self, episode: int, *, film: bool) -> Rollout:
        flown = super().fly(episode, film=film)
        return replace(flown, error="Traceback of a reasoner") if episode == 5 else flown


class UnlabelledRunner(FakeRunner):
    """Cannot be made."""

    def __init__(self, job: Job, watch: Watch = NO_WATCH) -> None:
        raise LabelError("label 'zebr' is not in the pack; did you mean 'zebra'?")


class StillbornRunner(FakeRunner):
    """Takes its process down while it is made."""

    def __init__(self, job: Job, watch: Watch = NO_WATCH) -> None:
        os._exit(3)


class InterruptedRunner(FifthFails):
    """Somebody presses Ctrl-C."""

    def fifth(self) -> None:
        raise KeyboardInterrupt


class GroupInterruptedRunner(FifthFails):
    """Somebody presses Ctrl-C; the terminal tells the whole process group."""

    fifth = staticmethod(lambda: os.killpg(os.getpgrp(), signal.SIGINT))


class NamedRunner(FakeRunner):
    """Says which process it is in."""

    @property
    def renderer(self) -> str:  # type: ignore[override]
        return f"process {os.getpid()}"


class FickleRunner(FakeRunner):
    """Never flies twice the same."""

    flights = 0

    def fly(self, episode: int, *, film: bool) -> Rollout:
        self.suite = replace(self.suite, digest=f"{self.suite.digest}{self.flights}")
        self.flights += 1
        return super().fly(episode, film=film)


def lasting(folder: Path) -> dict[str, Any]:
    """Of a run's results, what must be the same on every repetition."""
    document = json.loads((folder / "results.json").read_text())
    return {key: value for key, value in document.items() if key not in ("timing", "platform")}


def text_of(table: Any, width: int = 80) -> str:
    """What a terminal of this width shows of it."""
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


def frame_of(task: Task, step: int) -> FilmFrame:
    image = np.full((64, 64, 3), 4 * step % 256, dtype=np.uint8)
    guidance = Guidance(task.directive, task.target, 0.5)
    return FilmFrame(image, task.directive, guidance, np.array([1.0, -0.5, 0.1, 0.2], np.float32), step / 10, 0)


def ended(task: Task, outcome: Outcome, gate: int, rng: np.random.Generator) -> StageResult:
    flown_through = outcome in ("passed", "wrong_gate")
    return StageResult(
        task_id=task.id, category=task.category, family=task.family, target=task.target, outcome=outcome,
        chosen=gate if outcome not in ("timeout", "out_of_bounds") else None,
        time_s=4 + float(rng.random()), path_m=6 + float(rng.random()),
        path_ratio=1 + float(rng.random()) / 10 if flown_through else None,
        clearance_m=float(rng.random()) / 2 if flown_through else None,
        gate_distance_m=float(rng.random()) * (0.5 if outcome == "passed" else 3.0),
        directive=task.directive,
    )  # fmt: skip


def not_reached(task: Task) -> StageResult:
    return StageResult(
        task.id, task.category, task.family, task.target, "not_reached", None, 0.0, 0.0, None, None, None
    )


def way(stage: Stage, gate: int, start: np.ndarray, outcome: Outcome, rng: np.random.Generator) -> np.ndarray:
    """A curve from start to a gate, cut short or gone astray where the outcome says so."""
    goal = geometry.gate_centers(stage)[gate] + [0, 0, rng.normal(0, 0.1)]
    if outcome in ("missed", "out_of_bounds"):
        goal = goal + np.array([1.3 * np.cos(stage.yaw), 1.3 * np.sin(stage.yaw), 0.3])
    part = np.linspace(0, 1 if outcome in ("passed", "wrong_gate") else 0.9, 45)[1:, None]
    ahead = start + np.array([3 * np.cos(stage.yaw), 3 * np.sin(stage.yaw), rng.normal(0, 0.2)])
    return (1 - part) ** 2 * start + 2 * part * (1 - part) * ahead + part**2 * goal
