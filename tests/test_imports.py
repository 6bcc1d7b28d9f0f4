"""What importing the package loads, and what it must not."""

from __future__ import annotations

import subprocess
import sys

import pytest


def modules_after(statement: str) -> set[str]:
    code = f"{statement}\nimport sys; print('\\n'.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_importing_the_package_loads_next_to_nothing():
    loaded = modules_after("import cognitivedrone")
    assert not loaded & {"torch", "mujoco", "gymnasium", "numpy", "PIL"}


@pytest.mark.parametrize("room", ["tasks", "labels", "envs.gym", "envs.vector", "benchmark.runner", "cli"])
def test_no_room_of_the_base_loads_a_learning_framework(room):
    assert not modules_after(f"import cognitivedrone.{room}") & {"torch", "transformers", "tensorflow", "jax"}
