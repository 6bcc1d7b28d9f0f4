"""DAgger from the command: a policy's flights, relabelled, are a set of their own, the same bytes every time."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from collect_pools import digests, flying, forwards
from tiny import DESCRIPTION, tiny_model

from cognitivedrone.collect import collector
from cognitivedrone.collect.collector import CollectPlan, Job, collect, learner_of
from cognitivedrone.collect.recipe import RECIPES
from cognitivedrone.data.store import Store
from cognitivedrone.data.verify import verify
from cognitivedrone.errors import DataError
from cognitivedrone.files import digest_of_files
from cognitivedrone.plan import TaskSource
from cognitivedrone.policies import policy_files

BETA = 0.4


@pytest.fixture(autouse=True)
def short_flights(monkeypatch):
    monkeypatch.setitem(RECIPES, "debug", replace(RECIPES["debug"], kicks_per_s=0.0, time_limit_s=0.8))


@pytest.fixture
def model(tiny_model_file, tmp_path):
    shutil.copy(tiny_model_file.with_name("eyes.onnx"), tmp_path)
    return shutil.copy(tiny_model_file, tmp_path / "model.onnx")


def config(out, model, **changes):
    settings = {"recipe": "debug", "episodes": 5, "episodes_per_shard": 2, "policy": f"small:{model}", "beta": BETA}
    return CollectPlan.of(out=out, **(settings | changes))


def test_a_policy_flies_and_the_expert_labels_whatever_comes_of_it(tmp_path, model, monkeypatch):
    monkeypatch.setattr(collector, "pool_of", flying(forwards))
    report = collect(config(tmp_path / "set", model), progress=False)
    assert report.outcomes == {"timeout": 5}
    assert (report.flown, report.success_rate) == (5, 0.0)
    store = Store.open(tmp_path / "set")
    assert verify(tmp_path / "set") == []
    output = digest_of_files(*policy_files(f"small:{model}"))
    assert store.manifest["policy"] == {"policy": f"small:{model}", "beta": BETA, "model": output}
    same = np.concatenate([(episode.action == episode.sent).all(axis=1) for episode in store.episodes()])
    assert 0.1 < same.mean() < 0.8
    assert verify(tmp_path / "set") == []


def test_two_workers_and_a_stop_give_the_same_bytes(tmp_path, model, monkeypatch):
    collect(config(tmp_path / "two", model, workers=2), progress=False)

    def stopped(*arguments):
        yield next(forwards(*arguments))
        raise KeyboardInterrupt

    monkeypatch.setattr(collector, "pool_of", flying(stopped))
    with pytest.raises(KeyboardInterrupt, match="1 of 5 episodes"):
        collect(config(tmp_path / "set", model), progress=False)
    monkeypatch.setattr(collector, "pool_of", flying(forwards))
    assert collect(config(tmp_path / "set", model, resume=True), progress=False).flown == 4
    assert digests(tmp_path / "set") == digests(tmp_path / "two")


def test_another_policy_share_or_model_is_another_set(tmp_path, model, monkeypatch):
    monkeypatch.setattr(collector, "pool_of", flying(forwards))
    collect(config(tmp_path / "set", model, episodes=1), progress=False)
    before = digests(tmp_path / "set")
    for changes in ({"policy": "hover"}, {"beta": 0.5}, {"policy": None, "beta": 0.0}):
        with pytest.raises(DataError, match="another policy"):
            collect(config(tmp_path / "set", model, episodes=1, resume=True, **changes), progress=False)
    tiny_model(tmp_path / "model.onnx", replace(DESCRIPTION, name="retrained"))
    with pytest.raises(DataError, match=r"another policy \(model: "):
        collect(config(tmp_path / "set", model, episodes=1, resume=True), progress=False)
    assert digests(tmp_path / "set") == before


def test_a_machine_with_another_model_file_flies_nothing(model):
    learner = replace(learner_of(f"small:{model}", 0.0), model="00" * 32)
    with pytest.raises(DataError, match="its model file is another one on this machine"):
        Job(TaskSource("open-v1:train"), RECIPES["debug"], 2, learner).open()
