"""What docs/gymnasium.md shows runs, and what it says of spaces, arguments and tables is so."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.spaces import observation_space
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "gymnasium.md").read_text()


def first_column(heading: str) -> list[str]:
    """The code in the first column of the first table under a heading."""
    section = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE)


@pytest.mark.parametrize("code", re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL))
def test_its_python_runs(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert not done.stderr


def test_it_lists_the_arguments():
    parameters = [name for name in inspect.signature(CognitiveDroneEnv).parameters if name != "self"]
    assert first_column("Create an environment") == parameters
    more = {name for name in inspect.signature(CognitiveDroneVectorEnv).parameters if name not in parameters}
    assert more == {"num_envs", "threads", "copy"}


def test_it_lists_the_observation():
    assert sorted(first_column("Observation")) == sorted(observation_space())
