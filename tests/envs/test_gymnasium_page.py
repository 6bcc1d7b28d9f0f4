"""What docs/gymnasium.md shows runs, and what it says of spaces, arguments and tables is so."""

import inspect
import re
import runpy
from pathlib import Path

import av
import gymnasium
import numpy as np
import pytest

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.options import observation_space
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv
from cognitivedrone.plan import Scenario

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "gymnasium.md").read_text()
ELSEWHERE = {"own_policy.py", "sb3_ppo.py", "gym_mission.py", "gym_policy.py", "gym_video.py"}
"""Run by the tests of the README, of the wrappers and of missions, and below."""
EXAMPLES = re.findall(r"\]\(\.\./examples/(\w+\.py)\) \|", PAGE)


def first_column(heading: str) -> list[str]:
    """The code in the first column of the first table under a heading."""
    section = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE)


@pytest.mark.parametrize("code", re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL))
def test_its_python_runs(code, capsys):
    exec(code, {})  # noqa: S102 - ours
    printed, complaints = capsys.readouterr()
    assert printed
    assert not complaints


def test_it_lists_the_arguments():
    own = [name for name in inspect.signature(CognitiveDroneEnv).parameters if name not in ("self", "suite", "options")]
    assert first_column("Create an environment") == [*Scenario().values(), *own]
    more = {name for name in inspect.signature(CognitiveDroneVectorEnv).parameters if name not in own}
    assert more == {"num_envs", "max_episode_steps", "autoreset_mode", "threads", "copy", "suite", "options"}


def test_it_lists_the_observation():
    assert sorted(first_column("Observation")) == sorted(observation_space())


@pytest.mark.parametrize("example", sorted({*EXAMPLES} - ELSEWHERE))
def test_its_examples_run(example, capsys):
    runpy.run_path(str(ROOT / "examples" / example), run_name="__main__")
    assert capsys.readouterr().out


def test_it_lists_the_examples():
    assert {*EXAMPLES, "openvla_registration.py"} == {file.name for file in (ROOT / "examples").glob("*.py")}


def test_the_example_of_a_video_shows_the_flight_from_its_start(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(ROOT / "examples" / "gym_video.py"))["main"]("flight.mp4")
    with av.open("flight.mp4") as file:
        frames = [frame.to_ndarray(format="rgb24").astype(int) for frame in file.decode(video=0)]
    assert 30 < len(frames) < 300
    assert frames[0].shape == (256, 256, 3)
    env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v1:smoke")
    start = env.reset(seed=0)[0]["image"].astype(int)
    env.close()
    assert np.abs(frames[0] - start).mean() < 5
    assert np.abs(frames[len(frames) // 2] - start).mean() > 10


def test_the_example_of_a_policy_counts_what_the_environment_says(capsys):
    runpy.run_path(str(ROOT / "examples" / "gym_policy.py"))["main"](2)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert {line.rpartition(": ")[2] for line in lines} <= {"passed", "wrong_gate", "missed", "collision"}
