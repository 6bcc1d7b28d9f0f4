"""CognitiveDrone in AllenAI's harness: `pip install vla-eval`, github.com/allenai/vla-evaluation-harness.

`CognitiveDrone` is a benchmark of the harness, named in its configuration by an import string:

    benchmark: "cognitivedrone.integrations.vla_eval:CognitiveDrone"

`PolicyServer` is a model server of the harness for any policy of ours, also `remote:ws://...`:

    python -m cognitivedrone.integrations.vla_eval --args.policy=small --address=127.0.0.1:8000

See docs/gymnasium.md. Only this module needs the package `vla-eval`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.model_servers.base import SessionContext
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.render import apply_env
from vla_eval.specs import IMAGE_RGB, LANGUAGE, DimSpec

from cognitivedrone.control.calls import begin_stage, check_chunk
from cognitivedrone.errors import GroundTruthError, PolicyError
from cognitivedrone.integrations.flights import CAMERA, OUTCOMES, STATE, HarnessFlights, StepView, family_of, metrics_of
from cognitivedrone.interfaces import Policy
from cognitivedrone.plan import Scenario
from cognitivedrone.policies import make_policy
from cognitivedrone.types import ACTION_LIMITS, CONTROL_HZ, Action, EpisodeContext, Observation

_ACTIONS = "velocity_xyz3_yaw_rate1"
ACTION_SPEC = {
    "actions": DimSpec(
        "actions",
        4,
        _ACTIONS,
        (-max(ACTION_LIMITS), max(ACTION_LIMITS)),
        accepts=frozenset({_ACTIONS, "raw"}),
        description="vx, vy, vz in m/s (forward, left, up in the heading frame), yaw rate in rad/s; clipped",
    )
}
OBSERVATION_SPEC = {
    "image": IMAGE_RGB,
    "language": LANGUAGE,
    "state": DimSpec("state", len(STATE), "velocity_xyz3_height1_yaw_rate1", description=", ".join(STATE)),
}


class CognitiveDrone(StepBenchmark):
    """The suites of CognitiveDrone. One task of the harness is one track of the suite; episode n of it starts as with
    the benchmark's seed `seed` + n.

    Args:
        suite: name of a suite, such as "open-v1:test".
        tasks: task file, or folder of them, in place of a suite.
        labels: folder of label images that take precedence over the shipped ones.
        seed: seed of start, appearance and wind, as of `cognitivedrone bench --seed`.
        track: chain single tasks into tracks of five.
        appearance: "plain", "varied" or "photo".
        place: with "photo", "training", "kept", a place's name or a panorama's file.
        airframe: "racer" or "iris".
        wind: speed of a steady wind, m/s.
        time_limit_s: seconds for each stage.
        send_state: whether observations hold the drone's own state.
    """

    render_backends: ClassVar[frozenset[str]] = frozenset({"gpu", "cpu"})
    _ALL_RECORD_FIELDS: ClassVar[frozenset[str]] = frozenset({"action", "reward", "done", "stage", "time_s", "state"})

    def __init__(
        self,
        suite: str = "open-v1:test",
        tasks: str | None = None,
        labels: str | None = None,
        seed: int = 0,
        track: bool = False,
        appearance: str = "plain",
        place: str = "",
        airframe: str = "racer",
        wind: float = 0.0,
        time_limit_s: float = 30.0,
        send_state: bool = True,
    ) -> None:
        super().__init__()
        self._send_state = send_state
        scenario = Scenario.of(
            suite=suite,
            tasks=None if tasks is None else Path(tasks),
            labels=None if labels is None else Path(labels),
            seed=seed,
            track=track,
            appearance=appearance,
            place=place,
            airframe=airframe,
            wind=wind,
        )
        self.flights = HarnessFlights(scenario, time_limit_s)

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:
        """`gpu`: the first renderer that works, which may be Mesa's software renderer. `cpu`: only the latter."""
        applied: dict[str, str] = apply_env({"LIBGL_ALWAYS_SOFTWARE": "1"}) if mode == "cpu" else {}
        return applied

    def get_tasks(self) -> list[dict[str, Any]]:
        """One for every track, named after its family, so that the harness reports success by family."""
        suite = self.flights.suite
        return [
            {"name": family_of(track), "suite": suite.name, "episode": index, "stages": len(track)}
            for index, track in enumerate(suite.tracks)
        ]

    def reset(self, task: dict[str, Any]) -> StepView:
        """Begin the task's track."""
        view = self.flights.begin(task["episode"], self.flights.scenario.seed + task.get("episode_idx", 0))
        self._recorder.record_video(view.image)
        return view

    def step(self, action: dict[str, Any]) -> StepResult:
        """Fly `action["actions"]`, (4,), for 0.1 s; `action["declines"]`: no gate matches the instruction."""
        commands = action.get("actions", action.get("action"))
        view, reward, done = self.flights.step(commands, declines=action.get("declines") is True)
        self._recorder.record_video(view.image)
        self._recorder.record_step(
            action=np.asarray(commands, dtype=object).ravel().tolist(),
            reward=reward,
            done=done,
            stage=view.stage,
            time_s=view.time_s,
            state=view.state.tolist(),
        )
        return StepResult(obs=view, reward=reward, done=done, info={})

    def make_obs(self, raw_obs: StepView, task: dict[str, Any]) -> dict[str, Any]:  # noqa: ARG002
        """Image, instruction, state; and stage and time, for policies that begin anew with every stage."""
        seen = {
            "images": {CAMERA: raw_obs.image},
            "task_description": raw_obs.instruction,
            "stage": raw_obs.stage,
            "time_s": raw_obs.time_s,
        }
        return seen | ({"state": raw_obs.state} if self._send_state else {})

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:  # noqa: ARG002
        """`metrics_of` the episode."""
        return metrics_of(self.flights.results())

    def get_metric_keys(self) -> dict[str, str]:
        """Success, score and choice as means; every outcome as a count of stages."""
        return {"success": "mean", "score": "mean", "choice": "mean"} | dict.fromkeys(OUTCOMES, "sum")

    def get_hold_action(self, last_action: dict[str, Any] | None) -> dict[str, Any]:  # noqa: ARG002
        """Hover: actions are velocities, so repeating the last one would fly on blindly."""
        return {"actions": np.zeros(4, dtype=np.float32)}

    async def get_time(self) -> float:
        """Simulated seconds since the start of the episode."""
        view: StepView = self._last_result.obs
        return view.time_s

    def get_metadata(self) -> dict[str, Any]:
        """The longest episode, and what was flown."""
        flights = self.flights
        return {
            "max_steps": flights.max_steps,
            "control_hz": CONTROL_HZ,
            "suite": flights.suite.name,
            "digest": flights.suite.digest,
        }

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Velocity setpoint."""
        return ACTION_SPEC

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Image, instruction, state."""
        return {key: spec for key, spec in OBSERVATION_SPEC.items() if self._send_state or key != "state"}

    def render(self) -> Any:
        """The first-person view."""
        view: StepView | None = self._last_result.obs
        return None if view is None else view.image

    def cleanup(self) -> None:
        """Free the simulator."""
        self.flights.close()


@dataclass
class _Session:
    """One episode of one client."""

    policy: Policy
    seed: int
    real_time: bool
    stage: int | None = None
    pending: deque[Action] = field(default_factory=deque)


class PolicyServer(PredictModelServer):
    """Any policy of ours as a model server of the harness; every client has a fork of it.

    As in our control loop, a new stage resets the policy, and a chunk of actions is flown to its end.

    Args:
        policy: as `--policy` of `cognitivedrone bench`: a name with arguments, or "remote:ws://HOST:PORT".
    """

    def __init__(self, policy: str = "small") -> None:
        super().__init__()
        self._name = policy
        self._policy = make_policy(policy)
        if self._policy.needs_ground_truth:
            raise GroundTruthError(f"the policy {policy!r} uses privileged state, which the harness does not send")
        if self._policy.needs_down_camera:
            raise PolicyError(f"the policy {policy!r} needs a camera that looks down, which the harness does not have")
        self._policy.check()
        self._free: list[Policy] = []
        self._sessions: dict[str, _Session] = {}

    async def on_episode_start(self, config: dict[str, Any], ctx: SessionContext) -> None:
        """Take a policy for the episode."""
        await self.on_episode_end({}, ctx)
        policy = self._free.pop() if self._free else self._forked()
        seed, real_time = config.get("task", {}).get("episode", 0), config.get("mode") == "live"
        self._sessions[ctx.session_id] = _Session(policy, seed, real_time)

    async def on_episode_end(self, result: dict[str, Any], ctx: SessionContext) -> None:  # noqa: ARG002
        """Return the episode's policy."""
        if session := self._sessions.pop(ctx.session_id, None):
            self._free.append(session.policy)

    def _forked(self) -> Policy:
        policy = self._policy.fork()
        if policy is None:
            policy = make_policy(self._name)
            policy.check()
        return policy

    def predict(self, obs: dict[str, Any], ctx: SessionContext) -> dict[str, Any]:
        """The next action, (4,); with `declines` where the policy reports that no gate matches the instruction."""
        session = self._sessions[ctx.session_id]
        instruction, stage = obs["task_description"], obs.get("stage", 0)
        if stage != session.stage:
            context = EpisodeContext(instruction, session.seed, stage, real_time=session.real_time)
            begin_stage(session.policy, context)
            session.stage = stage
            session.pending.clear()
        if not session.pending:
            state = np.asarray(obs["state"], dtype=np.float32)
            session.pending.extend(
                check_chunk(
                    session.policy.act(
                        Observation(
                            image=obs["images"][CAMERA],
                            instruction=instruction,
                            velocity=state[:3],
                            height=float(state[3]),
                            yaw_rate=float(state[4]),
                            time=obs.get("time_s", ctx.step / CONTROL_HZ),
                        )
                    )
                )
            )
        return {"actions": session.pending.popleft(), "declines": session.policy.declines}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Velocity setpoint."""
        return ACTION_SPEC

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Image, instruction, state."""
        return OBSERVATION_SPEC


if __name__ == "__main__":
    from vla_eval.model_servers.serve import run_server

    run_server(PolicyServer)
