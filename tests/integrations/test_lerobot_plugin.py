"""LeRobot's own evaluation flies the environment, and a checkpoint flies there as in the benchmark.

Needs lerobot and the plug-in, in an environment of their own (docs/gymnasium.md).
"""

import json
import sys

import pytest

from cognitivedrone import evaluate

REASON = "the plug-in of lerobot is not installed (docs/gymnasium.md)"
pytest.importorskip("lerobot", reason=REASON)
plugin = pytest.importorskip("lerobot_env_cognitivedrone", reason=REASON)
pytestmark = pytest.mark.filterwarnings("default")  # of other packages


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    from lerobot_checkpoints import save_act

    return save_act(tmp_path_factory.mktemp("act"))


def lerobot_eval(monkeypatch, *arguments):
    from lerobot.scripts.lerobot_eval import main

    monkeypatch.setattr(sys, "argv", ["lerobot-eval", "--env.type=cognitivedrone", *arguments])
    main()


def test_a_checkpoint_flies_under_lerobot_as_in_the_benchmark(checkpoint, tmp_path, monkeypatch):
    lerobot_eval(
        monkeypatch, "--env.discover_packages_path=lerobot_env_cognitivedrone", "--env.suite=open-v1:smoke",
        "--env.time_limit_s=30", f"--env.results={tmp_path / 'results.jsonl'}", f"--policy.path={checkpoint}",
        "--policy.device=cpu", f"--output_dir={tmp_path / 'out'}", "--seed=0", "--eval.n_episodes=2",
        "--eval.batch_size=1",
    )  # fmt: skip
    theirs = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    scored = evaluate(f"lerobot:{checkpoint},device=cpu", suite="open-v1:smoke", episodes=2, workers=0, progress=False)
    for ours, flown in zip(scored.results.episodes, theirs, strict=True):
        (stage,) = ours.stages
        assert (flown["episode"], flown["seed"]) == (ours.episode, ours.seed)
        assert flown["stages"][0]["outcome"] == stage.outcome
        assert flown["stages"][0]["path_m"] == stage.path_m
    info = json.loads((tmp_path / "out" / "eval_info.json").read_text())
    assert info["per_task"][0]["metrics"]["successes"] == [flown["success"] for flown in theirs]


def test_it_is_a_choice_of_lerobots_environments():
    from lerobot.envs.configs import EnvConfig
    from lerobot.envs.factory import make_env
    from lerobot.envs.utils import env_to_policy_features

    config = EnvConfig.get_choice_class("cognitivedrone")(suite="open-v1:smoke", task="letters")
    assert config.type == "cognitivedrone"
    features = env_to_policy_features(config)
    assert {key: tuple(feature.shape) for key, feature in features.items()} == {
        "action": (4,),
        "observation.state": (5,),
        "observation.images.front": (3, 256, 256),
    }
    made = make_env(config, n_envs=2)
    (vectors,) = (group[0] for group in made.values())
    assert vectors.call("_max_episode_steps") == (300, 300)
    assert vectors.call("task") == ("letters", "letters")
    assert all(hasattr(env, "task_description") for env in vectors.envs), "no wrapper hides the instruction"
    vectors.close()
