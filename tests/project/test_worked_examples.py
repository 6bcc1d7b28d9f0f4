"""The worked examples of docs/tutorials/extend.md, applied to a copy of the package: they work, in so few files."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = Path("src") / "cognitivedrone"
NUMBERS = {"one": 1, "two": 2}

OPTION = """
from cognitivedrone.errors import PluginError
from cognitivedrone.policies import make_policy
assert make_policy("random:speed=0.4")._speed == 0.4
try:
    make_policy("random:speed=fast")
except PluginError as error:
    assert "speed is 'fast'; it is a number" in str(error)
"""
FORMAT = """
import subprocess, sys
from cognitivedrone.data.formats import EXPORTS, IMPORTS
assert "npz" in EXPORTS and "npz" in IMPORTS
# A folder of its own: beside the others, it would first remove what earlier runs have left there.
tests = ["-q", "-p", "no:cacheprovider", "--basetemp", "kept", "-c", {config!r}, {tests!r}, "-k", "npz or every_export"]
sys.exit(subprocess.run([sys.executable, "-m", "pytest", *tests]).returncode)
"""
FAMILY = """
import numpy as np
from cognitivedrone.tasks.format import task_from_json, task_to_json
from cognitivedrone.tasks.suites import drawn_task
task = drawn_task("vowels", np.random.default_rng(0), "mine/0")
assert task.category == "symbol_understanding" and task.options[task.target] in "AEIOU"
assert task_from_json(task_to_json(task), where="task") == task
"""
USES = {
    "An option of a policy": OPTION,
    "An output format": FORMAT.format(
        config=str(ROOT / "pyproject.toml"), tests=str(ROOT / "tests" / "data" / "test_formats.py")
    ),
    "A task family": FAMILY,
}


def examples() -> dict[str, str]:
    """The examples by their titles."""
    (_, text) = (ROOT / "docs" / "tutorials" / "extend.md").read_text(encoding="utf-8").split("## Worked examples\n")
    parts = re.split(r"^\*\*(.+?)\*\*", text, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def linked(folder: Path) -> Path:
    """A copy of the package whose files are links, so that they can be replaced one by one.

    Compiled ones, too: no process has to compile the whole package again.
    """
    for path in (ROOT / SOURCE).rglob("*"):
        if path.is_file():
            copy = folder / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.symlink_to(path)
    return folder


def apply(example: str, folder: Path) -> set[str]:
    """Apply an example's diffs and new files; returns the files that it touches."""
    touched = set()
    for language, title, text in re.findall(r'^```(\w+)(?: title="(.+?)")?\n(.*?)^```$', example, re.M | re.S):
        if language == "diff":
            for name in re.findall(r"^\+\+\+ b/(.+)$", text, re.M):
                touched.add(name)
                content = (folder / name).read_bytes()
                (folder / name).unlink()
                (folder / name).write_bytes(content)
            subprocess.run(["git", "apply"], input=text, text=True, cwd=folder, check=True)
        else:
            touched.add(title)
            assert not (folder / title).exists()
            (folder / title).write_text(text, encoding="utf-8")
    return touched


@pytest.mark.parametrize("title", USES)
def test_an_example_works_and_touches_as_many_files_as_it_says(title, tmp_path):
    example = examples()[title]
    folder = linked(tmp_path)
    number = re.search(r": (one|two) files?\.", example.replace("\n", " ")).group(1)
    assert len(apply(example, folder)) == NUMBERS[number]
    environment = os.environ | {"PYTHONPATH": str(folder / "src")}
    command = [sys.executable, "-c", USES[title]]
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_example_is_tried():
    assert examples().keys() == USES.keys()
