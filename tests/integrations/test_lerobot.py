"""The environment that LeRobot flies, and the names by which other packages find ours."""

import ast
import inspect
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import cognitivedrone
from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.errors import RunError, TaskError
from cognitivedrone.integrations.lerobot import LeRobotEnv
from cognitivedrone.plan import Scenario
from cognitivedrone.tasks import load_suite

FORWARD = np.array([2.0, 0.0, 0.0, 0.0], np.float32)


@pytest.fixture(scope="module")
def env():
    made = LeRobotEnv("open-v1:smoke")
    yield made
    made.close()


@pytest.mark.filterwarnings("ignore:.*normalized space")
@pytest.mark.filterwarnings("ignore:.*Not able to test alternative render modes")
def test_gymnasiums_own_checker_is_content(env):
    check_env(env)


def test_seeds_count_through_the_tracks_and_then_through_starts(env):
    plain = CognitiveDroneEnv("open-v1:smoke")
    for seed, episode, draw in ((0, 0, 0), (7, 7, 0), (31, 1, 1), (1000, 10, 33)):
        seen, info = env.reset(seed=seed)
        expected, _ = plain.reset(options={"episode": episode, "seed": draw})
        assert info == {"episode_index": episode, "is_success": False}
        assert np.array_equal(seen["pixels"]["front"], expected["image"])
        assert seen["agent_pos"][3] == expected["height"][0]
        assert env.task_description == expected["instruction"]
    assert env.reset()[1]["episode_index"] == 11, "without a seed, the next track"
    plain.close()


def test_the_instruction_is_not_an_observation_and_the_answer_is_nowhere(env):
    seen, info = env.reset(seed=0)
    assert set(seen) == {"pixels", "agent_pos"}
    assert set(info) == {"episode_index", "is_success"}


def test_a_mission_is_told_as_a_whole():
    missions = LeRobotEnv("open-v3:missions")
    missions.reset(seed=5)
    assert missions.task_description == load_suite("open-v3:missions").tracks[5][0].mission
    missions.close()


def test_a_family_can_be_flown_alone():
    letters = LeRobotEnv("open-v1:smoke", task="letters")
    tracks = load_suite("open-v1:smoke").tracks
    flown = [letters.reset(seed=seed)[1]["episode_index"] for seed in range(3)]
    letters.close()
    assert letters.task == "letters"
    assert flown == [i for i, track in enumerate(tracks) if track[0].family == "letters"][:3]
    with pytest.raises(TaskError, match="no family 'zebras'"):
        LeRobotEnv("open-v1:smoke", task="zebras")


def test_before_the_first_reset_nothing_is_simulated():
    made = LeRobotEnv("open-v1:smoke")
    assert made.task_description == ""
    assert made._max_episode_steps == 300
    with pytest.raises(TaskError, match="call reset first"):
        made.render()
    made.close()


def test_a_vector_of_them_reports_success_as_lerobot_reads_it():
    # An action that is no action ends an episode at once; the other flies on.
    many = SyncVectorEnv([lambda: LeRobotEnv("open-v1:smoke")] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    many.reset(seed=[0, 1])
    assert many.call("_max_episode_steps") == (300, 300)
    assert all(many.call("task_description"))
    _, reward, terminated, truncated, info = many.step(np.stack([FORWARD, FORWARD * np.nan]))
    assert reward.tolist() == [0.0, 0.0]
    assert terminated.tolist() == [False, True]
    assert not truncated.any()
    assert info["final_info"]["is_success"].tolist() == [False, False]
    assert info["final_info"]["outcome"][1] == "policy_error"
    many.close()


def test_running_out_of_time_truncates():
    short = LeRobotEnv("open-v1:smoke", time_limit_s=0.2)
    short.reset(seed=0)
    first, second = (short.step(np.zeros(4, np.float32)) for _ in range(2))
    short.close()
    assert first[2:4] == (False, False)
    assert second[2:4] == (False, True)
    assert second[4]["outcome"] == "timeout"


def test_whole_results_can_be_kept(tmp_path):
    kept = LeRobotEnv("open-v1:smoke", seed=2, time_limit_s=0.1, results=tmp_path / "results.jsonl")
    for seed in (3, 31):
        kept.reset(seed=seed)
        kept.step(np.zeros(4, np.float32))
    kept.close()
    first, second = map(json.loads, (tmp_path / "results.jsonl").read_text().splitlines())
    assert (first["episode"], first["seed"], first["timeout"]) == (3, 2, 1)
    assert (second["episode"], second["seed"], second["success"]) == (1, 3, False)
    assert first["stages"][0]["task_id"] == "open-v1:smoke/0003"
    with pytest.raises(RunError, match=r"no folder .*nowhere"):
        LeRobotEnv("open-v1:smoke", results=tmp_path / "nowhere" / "x")


ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "lerobot_env_cognitivedrone"
SCENARIO = set(Scenario().values())


def class_in(file: Path, name: str) -> ast.ClassDef:
    (found,) = (node for node in ast.parse(file.read_text()).body if getattr(node, "name", None) == name)
    assert isinstance(found, ast.ClassDef)
    return found


def test_the_benchmark_of_vla_eval_takes_the_options_of_a_scenario():
    benchmark = class_in(Path(cognitivedrone.__file__).parent / "integrations" / "vla_eval.py", "CognitiveDrone")
    (init,) = (node for node in benchmark.body if isinstance(node, ast.FunctionDef) and node.name == "__init__")
    assert {argument.arg for argument in init.args.args} == {"self", "time_limit_s", "send_state"} | SCENARIO


def test_the_plug_in_of_lerobot_takes_the_options_of_the_environment():
    config = class_in(PLUGIN / "src" / PLUGIN.name / "__init__.py", "CognitiveDroneConfig")
    own = {
        node.target.id for node in config.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    taken = set(inspect.signature(LeRobotEnv).parameters) - {"render_mode", "options"}
    assert own - {"fps", "features", "features_map"} == taken | SCENARIO


def test_lerobot_finds_the_plug_in_by_its_name():
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text())["project"]
    assert project["name"] == PLUGIN.name
    assert project["name"].startswith("lerobot_env_"), "the prefix that register_third_party_plugins looks for"
    assert (PLUGIN / "src" / project["name"] / "__init__.py").is_file()
