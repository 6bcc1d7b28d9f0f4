import shlex
import sys

import pytest

from cognitivedrone import checkout
from cognitivedrone.benchmark.runs.job import platform_facts


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A user's modules in a folder with a blank in its name, below the current folder."""
    folder = tmp_path / "my code"
    (folder / "pilots").mkdir(parents=True)
    (folder / "straight_on.py").write_text("class Straight: ...\n")
    (folder / "pilots" / "__init__.py").write_text("")
    (folder / "pilots" / "best.py").write_text("class Best: ...\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(folder), *sys.path])
    yield folder
    for name in ("pilots", "pilots.best", "straight_on"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("policy", "reasoner", "key", "file"),
    [
        ("straight_on:Straight", "none", "policy_file", "my code/straight_on.py"),
        ("small", "pilots.best:Best", "reasoner_file", "my code/pilots/best.py"),  # found from the package's folder
    ],
)
def test_an_own_module_is_reported_with_its_file_and_how_to_find_it(own, policy, reasoner, key, file):
    facts = platform_facts(f"cognitivedrone bench --policy {policy}", policy, reasoner)
    assert {name: facts[name] for name in ("policy_file", "reasoner_file") if name in facts} == {key: file}
    assert shlex.split(facts["command"])[:3] == ["PYTHONPATH=my code", "cognitivedrone", "bench"]


@pytest.mark.parametrize("policy", ["small", "small:weights.onnx", "no_such_module:Policy", "json:loads"])
def test_policies_that_need_no_path_leave_the_command_as_it_is(policy):
    assert platform_facts("cognitivedrone bench", policy, "none")["command"] == "cognitivedrone bench"


def test_the_commit_is_reported(monkeypatch):
    monkeypatch.setattr(checkout, "commit", lambda: "abc-dirty")
    assert platform_facts("x")["commit"] == "abc-dirty"
    monkeypatch.setattr(checkout, "commit", lambda: None)
    assert platform_facts("x")["commit"] == "none"
