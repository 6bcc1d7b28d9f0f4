"""The suites in AllenAI's own harness: its orchestrator, its runners, its websocket protocol."""

import asyncio
import dataclasses

import numpy as np
import pytest

from cognitivedrone import evaluate
from cognitivedrone.adapters import as_policy
from cognitivedrone.errors import GroundTruthError
from cognitivedrone.integrations.flights import OUTCOMES
from cognitivedrone.tasks import SUITES, load_suite

api = pytest.importorskip("vla_eval.api", reason="vla-eval is not installed (docs/gymnasium.md)")
base = pytest.importorskip("vla_eval.model_servers.base")
predict = pytest.importorskip("vla_eval.model_servers.predict")
ours = pytest.importorskip("cognitivedrone.integrations.vla_eval")

BENCHMARK = "cognitivedrone.integrations.vla_eval:CognitiveDrone"


def flown(server, *, mode="sync", tasks=1, **params):
    """The harness's result of the first tasks."""
    entry = {"benchmark": BENCHMARK, "mode": mode, "max_tasks": tasks, "params": {"suite": "open-v1:smoke", **params}}
    config = {"server": {"timeout": 300}, "benchmarks": [entry | ({"paced": False} if mode == "live" else {})]}
    (result,) = api.evaluate(server, config, no_save=True)
    return result


def episodes(result):
    return [episode for task in result["tasks"] for episode in task["episodes"]]


class Answering(predict.PredictModelServer):  # type: ignore[misc, name-defined]
    """Answers the same whatever it sees."""

    def __init__(self, actions):
        super().__init__()
        self.actions = actions

    def predict(self, obs, ctx):
        return {"actions": self.actions}


class Silent(base.ModelServer):  # type: ignore[misc, name-defined]
    """Never answers."""

    async def on_observation(self, obs, ctx):
        pass


@pytest.mark.parametrize("seed", [0, 3])
def test_it_flies_what_the_benchmark_flies(seed):
    scored = evaluate("small", suite="open-v1:smoke", seed=seed, episodes=2, workers=0, progress=False)
    result = flown(ours.PolicyServer("small"), tasks=2, seed=seed)
    for ours_, theirs in zip(scored.results.episodes, episodes(result), strict=True):
        assert theirs["metrics"]["stages"] == [dataclasses.asdict(stage) for stage in ours_.stages]
        assert theirs["steps"] == ours_.steps
    passed = sum(stage.outcome == "passed" for episode in scored.results.episodes for stage in episode.stages)
    assert result["mean_success"] == result["mean_score"] == passed / 2
    assert result["sum_passed"] == passed


def test_while_the_model_computes_the_drone_hovers():
    result = flown(Silent(), mode="live", time_limit_s=1.0)
    (episode,) = episodes(result)
    (stage,) = episode["metrics"]["stages"]
    assert (stage["outcome"], episode["steps"]) == ("timeout", 10)
    assert stage["path_m"] < 0.1
    assert episode["rt_metrics"]["stale_count"] == 10
    hold = ours.CognitiveDrone("open-v1:smoke").get_hold_action({"actions": np.ones(4)})
    assert np.array_equal(hold["actions"], np.zeros(4))


def test_in_live_mode_answers_are_flown():
    result = flown(Answering(np.array([2.0, 0.0, 0.0, 0.0])), mode="live", time_limit_s=3.0)
    (episode,) = episodes(result)
    assert episode["rt_metrics"]["update_count"] > 0
    assert episode["metrics"]["stages"][0]["path_m"] > 0.1


@pytest.mark.parametrize("actions", [np.full(4, np.nan), np.zeros(7), np.zeros((2, 4))])
def test_an_answer_that_is_no_action_counts_as_policy_error(actions):
    result = flown(Answering(actions))
    assert result["sum_policy_error"] == 1
    assert result["mean_success"] == 0.0
    assert result["num_errors"] == 0


class Declines:
    """Hovers and says that it is not there."""

    declines = True

    def reset(self, context):
        pass

    def act(self, observation):
        return np.zeros((3, 4), np.float32)


def test_a_policy_can_decline(monkeypatch):
    monkeypatch.setattr(ours, "make_policy", lambda name: as_policy(name, Declines()))
    result = flown(ours.PolicyServer("declines"), suite="open-v2:absent")
    assert (result["mean_success"], result["mean_choice"], result["sum_passed"]) == (1.0, 1.0, 1)


@pytest.mark.parametrize("name", SUITES)
def test_every_suite_can_be_named(name):
    benchmark = ours.CognitiveDrone(name)
    tasks, suite = benchmark.get_tasks(), load_suite(name)
    assert [task["episode"] for task in tasks] == list(range(len(suite.tracks)))
    assert {task["name"] for task in tasks if task["stages"] == 1} <= {
        t.family for track in suite.tracks for t in track
    }
    assert benchmark.get_metadata()["max_steps"] == 300 * max(len(track) for track in suite.tracks)
    assert {key for task in tasks for key in task} == {"name", "suite", "episode", "stages"}, "nothing tells the answer"


def test_what_it_declares():
    benchmark = ours.CognitiveDrone("open-v1:smoke", send_state=False)
    assert set(benchmark.get_metric_keys()) == {"success", "score", "choice", *OUTCOMES}
    assert set(benchmark.get_observation_spec()) == {"image", "language"}
    assert benchmark.render() is None
    view = benchmark.flights.begin(0, 0)
    assert set(benchmark.make_obs(view, {})) == {"images", "task_description", "stage", "time_s"}
    benchmark.cleanup()


def test_its_time_is_the_simulations():
    benchmark = ours.CognitiveDrone("open-v1:smoke")

    async def one_step():
        await benchmark.start_episode(benchmark.get_tasks()[0])
        await benchmark.apply_action({"actions": np.zeros(4)})
        return await benchmark.get_time()

    assert asyncio.run(one_step()) == pytest.approx(0.1)
    benchmark.cleanup()


def test_rendering_can_be_kept_off_the_gpu(monkeypatch):
    monkeypatch.delenv("LIBGL_ALWAYS_SOFTWARE", raising=False)
    assert ours.CognitiveDrone.configure_render("gpu") == {}
    assert ours.CognitiveDrone.configure_render("cpu") == {"LIBGL_ALWAYS_SOFTWARE": "1"}


def test_an_oracle_is_refused():
    with pytest.raises(GroundTruthError, match="'oracle' uses privileged state"):
        ours.PolicyServer("oracle")
