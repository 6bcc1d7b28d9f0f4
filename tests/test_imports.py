"""What importing the package loads, and what it must not."""

from __future__ import annotations

import subprocess
import sys

import pytest

from cognitivedrone import benchmark
from cognitivedrone.cli import TARGETS


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


HEAVY = {"mujoco", "scipy", "gymnasium", "av", "PIL", "pyarrow", "onnxruntime", "torch", "rich", "numpy", "jinja2"}


def loaded_by(*arguments: str) -> set[str]:
    code = f"""
import sys
from cognitivedrone.cli import main
try:
    main({list(arguments)!r})
except SystemExit:
    pass
print('\\n'.join(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize("command", [[], ["--version"], ["data"], *(name.split() for name in TARGETS)], ids=" ".join)
def test_help_loads_nothing_heavy(command):
    arguments = command if command == ["--version"] else [*command, "--help"]
    assert not loaded_by(*arguments) & HEAVY


def test_a_command_loads_none_of_the_others():
    loaded = loaded_by("bench", "--help")
    assert "cognitivedrone.cli.scoring" in loaded
    assert not loaded & {"cognitivedrone.cli.data", "cognitivedrone.cli.flying", "cognitivedrone.cli.training"}


def test_what_the_benchmark_names_is_there_when_it_is_asked_for():
    loaded = modules_after("import cognitivedrone.benchmark")
    assert "cognitivedrone.benchmark.runner" not in loaded
    assert all(getattr(benchmark, name) is not None for name in benchmark.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        benchmark.nothing  # noqa: B018
