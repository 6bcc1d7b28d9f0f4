"""Flies episodes of a suite one step at a time, for harnesses that run the loop themselves.

Episode i with seed n is the flight that `cognitivedrone bench --seed n` flies as episode i: the same start, appearance
and wind, the same frames, the same scoring.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from typing import Any, Final, get_args

import numpy as np

from cognitivedrone.envs.gym import score
from cognitivedrone.envs.options import check_actions, drawn, read_options
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import ActionError, TaskError, did_you_mean
from cognitivedrone.plan import Scenario
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.tasks import Suite
from cognitivedrone.tasks.suites import suite_of
from cognitivedrone.types import CONTROL_HZ, FloatArray, Image, Outcome, StageResult, Track

CAMERA: Final = "front"
"""Name of the only camera, as in our LeRobot export."""
STATE: Final = ("vx", "vy", "vz", "height", "yaw_rate")
"""The drone's own state: heading-frame velocity, m/s; height, m; yaw rate, rad/s. As in our exports."""
OUTCOMES: Final[tuple[Outcome, ...]] = get_args(Outcome)


@dataclasses.dataclass(frozen=True, slots=True)
class StepView:
    """What a policy may see before a step."""

    image: Image
    """(256, 256, 3) first-person view."""
    state: FloatArray
    """(5,) float32, see `STATE`."""
    instruction: str
    """Of the current stage."""
    stage: int
    """Index of the current stage; 0 for single tasks."""
    time_s: float
    """Since the start of the flight."""


class HarnessFlights:
    """The episodes of a scenario's suite, flown one after the other.

    The simulator starts with the first episode. Raises `TaskError`, `LabelError` or `SimulationError` for a suite,
    labels or conditions that cannot be.
    """

    def __init__(self, scenario: Scenario, time_limit_s: float = 30.0) -> None:
        self.scenario = scenario
        self.time_limit_s = time_limit_s
        self.suite: Suite = suite_of(scenario)
        TrackConfig.of(scenario, time_limit_s)
        find_airframe(scenario.airframe)
        self._worlds: Worlds | None = None
        self._view: StepView

    @property
    def max_steps(self) -> int:
        """Control steps of 0.1 s after which every episode has ended."""
        return math.ceil(self.time_limit_s * CONTROL_HZ) * max(map(len, self.suite.tracks))

    def episodes(self, family: str | None = None) -> list[int]:
        """Indices of the episodes, or of those with a stage of this family; raises `TaskError` if there are none."""
        tracks = self.suite.tracks
        chosen = [i for i in range(len(tracks)) if family is None or family in {task.family for task in tracks[i]}]
        if not chosen:
            known = {task.family for track in tracks for task in track}
            raise TaskError(f"suite {self.suite.name!r} has no family {family!r}; {did_you_mean(str(family), known)}")
        return chosen

    def begin(self, episode: int, seed: int) -> StepView:
        """Begin an episode under the conditions of a benchmark's seed; raises `TaskError` if there is no such one."""
        if self._worlds is None:
            self._worlds = Worlds.of(self.scenario, time_limit_s=self.time_limit_s)
        options = {"episode": episode, "seed": seed}
        self._worlds.begin(
            0, self.suite, *drawn(self.suite, np.random.default_rng(), read_options(self.suite, options))
        )
        return self._look(self._worlds)

    def step(self, action: object, *, declines: bool = False) -> tuple[StepView, float, bool]:
        """Fly one control period, 0.1 s: the view after it, the reward, and whether the episode is over.

        `action` is (4,) numbers: vx, vy, vz in m/s and yaw rate in rad/s. Anything else, and NaN, ends the episode as
        `policy_error`, as in the benchmark. `declines` reports that no gate matches the instruction.
        """
        worlds, runner = self._begun()
        runner.decline(declines)
        try:
            worlds.command(_numbers(action)[None])
        except ActionError:
            runner.end("policy_error")
            return self._view, 0.0, True
        (result,) = worlds.advance()
        return self._look(worlds), score(result, runner.finished)[0], runner.finished

    def results(self) -> tuple[StageResult, ...]:
        """One result for every stage; an episode that is still flying ends here, as `timeout`."""
        _, runner = self._begun()
        if not runner.finished:
            runner.end("timeout" if runner.task.target is not None else "hesitated")
        return tuple(runner.results)

    def close(self) -> None:
        """Free the simulator."""
        if self._worlds is not None:
            self._worlds.close()
        self._worlds = None

    def _begun(self) -> tuple[Worlds, TrackRunner]:
        if self._worlds is None or not self._worlds.runners[0].track:
            raise TaskError("no episode has begun; call begin first")
        return self._worlds, self._worlds.runners[0]

    def _look(self, worlds: Worlds) -> StepView:
        """The view of now, which is kept."""
        (runner,), seen = worlds.runners, {name: values[0] for name, values in worlds.observe().items()}
        state = np.concatenate([seen[name] for name in ("velocity", "height", "yaw_rate")])
        stage = min(runner.index, len(runner.track) - 1)
        self._view = StepView(seen["image"], state, seen["instruction"], stage, runner.world.time())
        return self._view


def family_of(track: Track) -> str:
    """The family of a single task; "track" where several stages follow each other."""
    return track[0].family if len(track) == 1 else "track"


def metrics_of(results: tuple[StageResult, ...]) -> dict[str, Any]:
    """An episode's result as plain values.

    `success`: all stages passed. `score`: share of the stages passed; its mean over single tasks is the benchmark's
    success rate. `choice`: share of the stages that headed for the right gate or, where none is right, declined. One
    count for every outcome. `stages`: the benchmark's own result of every stage.
    """
    passed = [result.outcome == "passed" for result in results]
    right = [
        result.outcome == "passed" if result.target is None else result.chosen == result.target for result in results
    ]
    tally = Counter(result.outcome for result in results)
    return {
        "success": all(passed),
        "score": sum(passed) / len(results),
        "choice": sum(right) / len(results),
        **{outcome: tally[outcome] for outcome in OUTCOMES},
        "stages": [dataclasses.asdict(result) for result in results],
    }


def _numbers(action: object) -> FloatArray:
    try:
        numbers = np.asarray(action, dtype=np.float32)
    except (TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor that is not on the host
        raise ActionError(f"the action is a {type(action).__name__!r}, not an array of numbers") from None
    check_actions(numbers, (4,))
    return numbers
