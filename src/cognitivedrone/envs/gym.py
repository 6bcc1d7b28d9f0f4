"""`CognitiveDrone-v1`: one drone, one episode at a time, through Gymnasium's interface."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, TypeAlias, get_args

import gymnasium
import numpy as np

from cognitivedrone.envs.options import (
    Info,
    action_space,
    check_actions,
    check_begun,
    drawn,
    observation_space,
    read_options,
    scenario_of,
    seeds_of,
)
from cognitivedrone.envs.track_runner import TrackRunner, scenery_of
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.envs.wrappers import Observe, Progress, Reward, learns_by, state_space, states_of
from cognitivedrone.errors import SimulationError, TaskError, did_you_mean
from cognitivedrone.plan import Scenario
from cognitivedrone.sim.airframe import Airframe, find_airframe
from cognitivedrone.sim.drawing.chase import LIVE_SIZE, ChaseView
from cognitivedrone.tasks import UNLIMITED, Suite
from cognitivedrone.tasks.suites import TRAIN_NAME, suite_of
from cognitivedrone.types import CONTROL_HZ, Action, GroundTruth, Image, Stage, StageResult

Camera: TypeAlias = Literal["drone", "chase"]
CAMERAS: tuple[Camera, ...] = get_args(Camera)


class TaskView:
    """Shows the current stage of a `TrackRunner`; the chase view is made when it is first needed.

    Raises `SimulationError` for an unknown camera or mode.
    """

    def __init__(self, mode: str | None, camera: Camera, airframe: Airframe) -> None:
        if camera not in CAMERAS:
            raise SimulationError(f"unknown camera {camera!r}; {did_you_mean(str(camera), CAMERAS)}")
        if mode not in (None, "rgb_array"):
            way = 'gymnasium.make(..., render_mode="human") opens a window' if mode == "human" else "known: rgb_array"
            raise SimulationError(f"render_mode is {mode!r}, but the environment itself renders arrays; {way}")
        self._camera, self._airframe = camera, airframe
        self._chase: ChaseView | None = None
        self._stage: Stage | None = None

    def cut(self) -> None:
        """A new flight begins: move the camera there at once."""
        if self._chase is not None:
            self._chase.cut()

    def image(self, track: TrackRunner) -> Image:
        """(256, 256, 3) first-person, or (360, 640, 3) from behind; call it once a control period."""
        if self._camera == "drone":
            return track.world.frame()
        scenery = scenery_of(track.stage, track.labels, track.appearance)
        if self._chase is None:
            self._chase = ChaseView(track.stage, scenery, *LIVE_SIZE, airframe=self._airframe, samples=4)
        elif self._stage is not track.stage:
            self._chase.place(track.stage, scenery)
        self._stage, state = track.stage, track.world.state()
        return self._chase.frame(state.position, state.quaternion, 1 / CONTROL_HZ, track.world.time())

    def close(self) -> None:
        """Free the renderer."""
        if self._chase is not None:
            self._chase.close()


class CognitiveDroneEnv(gymnasium.Env[Any, Action]):
    """One episode is one track of the suite; a single task is a track of one stage.

    `suite` is a name or a `Suite`; every episode of "open-v1:train" is a new task, without end. The other options are
    those of `cognitivedrone.plan.Scenario`: tasks, labels, appearance, airframe, wind. `camera` is what `render` shows:
    the drone's own view or, with "chase", one from behind it.

    Reward: 1 for every stage flown through the right gate. `terminated` when the track is done or the flight ended by
    contact, miss or leaving the stage; `truncated` when the stage's time ran out. `info` holds `task`, and the
    `StageResult`s so far as `results`. `reset(options={"episode": i})` flies one chosen episode of the suite, and
    `reset(options={"episode": i, "seed": n})` the one that the benchmark flies as episode i with `--seed n`.
    Raises `TaskError`, `LabelError`, `SimulationError` or `UsageError` for a suite, labels, conditions or an option
    that cannot be, and `NotReset` for a step before the first reset. `observe="state"` and `reward="progress"` are for
    learning to fly (`envs.learning`): both know the right gate. `depth` adds, to each pixel of the image, how far ahead
    of the camera what it shows is, m.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # type: ignore[misc]

    def __init__(
        self,
        suite: str | Suite = "open-v1:train",
        *,
        time_limit_s: float = 30.0,
        render_mode: str | None = None,
        camera: Camera = "drone",
        down_camera: bool = False,
        depth: bool = False,
        observe: Observe = "camera",
        reward: Reward = "passed",
        **options: Any,
    ) -> None:
        scenario = scenario_of(type(self).__init__, suite, options)
        self._states, self._shaped = learns_by(observe, reward)
        self.suite = tasks_of(suite, scenario)
        pictures = observation_space(down_camera=down_camera, depth=depth)
        self.observation_space = state_space() if self._states else pictures
        self.action_space = action_space()  # type: ignore[assignment]
        self.view = TaskView(render_mode, camera, find_airframe(scenario.airframe))
        self.render_mode = render_mode
        self._down, self._depth = down_camera, depth
        self._worlds = Worlds.of(scenario, time_limit_s=time_limit_s)
        (self.track_runner,) = self._worlds.runners
        self._progress = Progress(self.track_runner)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Info]:
        """Begin an episode, drawn from the seed or given as `options["episode"]`, with `options["seed"]` as well.

        Raises `TaskError` for other options and for values that cannot be.
        """
        wanted = read_options(self.suite, options)
        (seed,) = seeds_of(seed, 1)
        super().reset(seed=seed)
        episode, draw = drawn(self.suite, self.np_random, wanted)
        self._worlds.begin(0, self.suite, episode, draw)
        self._progress.begin()
        self.view.cut()
        return self._observe(), self._info(episode_index=episode)

    def step(self, action: Action) -> tuple[Any, float, bool, bool, Info]:
        """Fly one control period, 0.1 s."""
        check_begun(self.track_runner, "step")
        check_actions(action, (4,))
        self._worlds.command(np.asarray(action)[None])
        (result,) = self._worlds.advance()
        reward, terminated, truncated = score(result, self.track_runner.finished)
        reward = self._progress.score(result) if self._shaped else reward
        return self._observe(), reward, terminated, truncated, self._info()

    def render(self) -> Any:
        """The view, (256, 256, 3) uint8 or, from behind, (360, 640, 3); None without a `render_mode`."""
        if self.render_mode is None:
            return None
        check_begun(self.track_runner, "render")
        return self.view.image(self.track_runner)

    def close(self) -> None:
        """Free the renderers."""
        self.view.close()
        self._worlds.close()

    def decline(self, declined: bool = True) -> None:
        """Report that no gate matches the instruction, or cease to; after 3 s in a row the stage ends (`absent`)."""
        check_begun(self.track_runner, "decline")
        self.track_runner.decline(declined)

    def truth(self) -> GroundTruth:
        """Ground truth, for experts that make training data."""
        check_begun(self.track_runner, "truth")
        return self.track_runner.truth()

    def _observe(self) -> Any:
        if self._states:
            return states_of([self.track_runner])[0]
        return {name: values[0] for name, values in self._worlds.observe(down=self._down, depth=self._depth).items()}

    def _info(self, **more: Any) -> Info:
        return {"task": self.track_runner.task, "results": tuple(self.track_runner.results), **more}


def tasks_of(suite: str | Suite, scenario: Scenario) -> Suite:
    """The tasks of an environment; the training suite has no end. Raises `TaskError`."""
    if isinstance(suite, Suite):
        return suite
    if scenario.track and scenario.tasks is None and scenario.suite == TRAIN_NAME:
        raise TaskError(f"{TRAIN_NAME} has no end, so it cannot be chained into tracks; leave track=True out")
    return suite_of(scenario, UNLIMITED)


def score(result: StageResult | None, finished: bool) -> tuple[float, bool, bool]:
    """Reward, terminated, truncated."""
    timed_out = result is not None and result.outcome in ("timeout", "hesitated")
    return float(result is not None and result.outcome == "passed"), finished and not timed_out, timed_out
