"""A collection is the same bytes whoever flies it, whatever interrupts it, and has exactly what was asked for."""

import multiprocessing
import os
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collect_pools import digests, flying, forwards

from cognitivedrone.collect import collector
from cognitivedrone.collect.collector import CollectPlan, Job, collect
from cognitivedrone.collect.recipe import RECIPES
from cognitivedrone.data.store import Store
from cognitivedrone.errors import DataError, MissingExtra, PolicyError, TaskError, UsageError
from cognitivedrone.plan import TaskSource
from cognitivedrone.rollout.pool import WorkerLost
from cognitivedrone.rollout.process_pool import ProcessPool
from cognitivedrone.rollout.ray_pool import RayPool
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.format import write_tasks


def config(out, **changes):
    return CollectPlan.of(out=out, **({"recipe": "debug", "episodes": 6, "episodes_per_shard": 2} | changes))


def backwards(fleet, batches):
    """The last batch first."""
    return forwards(fleet, [batch[::-1] for batch in reversed(batches)])


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    out = tmp_path_factory.mktemp("collect") / "set"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collector, "pool_of", flying(backwards))
        return collect(config(out), progress=False)


def test_it_has_exactly_what_was_asked_for(flown):
    store = Store.open(flown.out)
    assert flown.episodes == flown.flown == len(store) == 6
    assert [episode.index for episode in store.episodes()] == list(range(6))
    assert len({episode.task.family for episode in store.episodes()}) == 6
    assert flown.success_rate == 6 / (6 + sum(flown.dropped.values()))
    assert store.manifest["dropped"] == flown.dropped
    assert flown.episodes_per_s > 0


def test_worker_processes_make_the_same_bytes(flown, tmp_path):
    report = collect(config(tmp_path / "set", workers=2), progress=False)
    assert report.dropped == flown.dropped
    assert digests(tmp_path / "set") == digests(flown.out)


def test_a_killed_collection_is_resumed_to_the_same_bytes(flown, tmp_path):
    out = tmp_path / "set"
    script = f"""
import os, signal
from pathlib import Path
from collect_pools import digests, flying
from cognitivedrone.collect import collector
def fly(fleet, batches):
    for count, batch in enumerate(batches):
        if count == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        yield from fleet.fly(batch)
collector.pool_of = flying(fly)
plan = collector.CollectPlan(Path({str(out)!r}), "debug", 6, episodes_per_shard=2)
collector.collect(plan, progress=False)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    killed = subprocess.run([sys.executable, "-c", script], env=environment, check=False)
    assert killed.returncode == -signal.SIGKILL
    with pytest.raises(DataError, match="not finished"):
        Store.open(out)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collector, "pool_of", flying(backwards))
        report = collect(config(out, resume=True), progress=False)
    assert (report.flown, report.episodes) == (2, 6)
    assert digests(out) == digests(flown.out)


def test_resuming_a_finished_set_flies_nothing_and_changes_nothing(flown):
    before = digests(flown.out)
    report = collect(config(flown.out, resume=True), progress=False)
    assert (report.flown, report.episodes, report.success_rate) == (0, 6, 1.0)
    assert digests(flown.out) == before


@pytest.mark.parametrize(
    "changes", [{"seed": 1}, {"episodes": 7}, {"recipe": "paper"}, {"suite": "open-v1:test"}, {"down_camera": True}]
)
def test_a_folder_of_another_making_is_refused(flown, changes):
    with pytest.raises(DataError, match="another"):
        collect(config(flown.out, resume=True, **changes), progress=False)


def stopped_after(count, error):
    """Flies so many episodes, and then raises."""

    def fly(fleet, batches):
        flown = forwards(fleet, batches)
        yield from (next(flown) for _ in range(count))
        raise error

    return flying(fly)


def test_ctrl_c_and_a_dead_worker_keep_every_finished_episode(flown, tmp_path, monkeypatch):
    out = tmp_path / "set"
    monkeypatch.setattr(collector, "pool_of", stopped_after(3, DataError("a worker was killed")))
    with pytest.raises(DataError, match="killed"):
        collect(config(out), progress=False)
    monkeypatch.setattr(collector, "pool_of", stopped_after(2, KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt, match=r"stopped; 5 of 6 episodes are kept in .*--resume"):
        collect(config(out, resume=True), progress=False)
    monkeypatch.setattr(collector, "pool_of", flying(backwards))
    report = collect(config(out, resume=True), progress=False)
    assert (report.flown, report.episodes) == (1, 6)
    assert digests(out) == digests(flown.out)


def test_progress_counts_episodes_while_a_shard_is_under_way(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(collector, "pool_of", flying(forwards))
    monkeypatch.setattr(collector, "_advance", lambda bar, line, gathered, begin: seen.append(gathered.there))
    collect(config(tmp_path / "set", episodes=4, episodes_per_shard=64), progress=False)
    assert seen == [1, 2, 3, 4]


def test_the_bar_is_readable_at_80_columns(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(collector, "pool_of", flying(backwards))
    collect(config(tmp_path / "set", episodes=1), progress=True)
    printed = capfd.readouterr()
    assert not printed.out
    (line,) = [line for line in printed.err.splitlines() if "episodes/s" in line]
    assert len(line) <= 80
    assert "1/1" in line


@pytest.mark.parametrize("place", ["/proc/set", "FILE", "FILE/set"])
def test_a_place_that_cannot_be_written_is_reported_in_one_sentence(tmp_path, place):
    (tmp_path / "file").write_text("mine")
    out = Path(place.replace("FILE", str(tmp_path / "file")))
    with pytest.raises(DataError, match=r"is a file; give a new folder|cannot be written") as reported:
        collect(config(out), progress=False)
    assert "\n" not in str(reported.value)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"recipe": "papr"}, DataError, "did you mean 'paper'"),
        ({"episodes": 0}, UsageError, "--episodes is 0"),
        ({"workers": 0}, UsageError, "--workers is 0"),
        ({"suite": "open-v2:words"}, DataError, "is only for testing"),
        ({"beta": 0.5}, DataError, "give a --policy"),
        ({"policy": "hovr"}, PolicyError, "did you mean 'hover'"),
        ({"policy": "small:no/such.onnx"}, PolicyError, "no model file no/such.onnx"),
        ({"executor": "rai"}, DataError, "unknown executor"),
        ({"suite": "open-v1:smok"}, TaskError, "did you mean 'open-v1:smoke'"),
        ({"suite": "open-v1:test", "episodes": 5000}, DataError, "has 300 tasks only; give --episodes 300, or fewer"),
        ({"suite": "open-v1:track", "episodes": 2}, DataError, "made of tracks.*give the stages in a task file"),
        ({"suite": "open-v3:missions", "episodes": 2}, DataError, "is only for testing"),
    ],
)
def test_mistakes_are_reported_before_anything_is_written(tmp_path, changes, error, message):
    with pytest.raises(error, match=message):
        collect(config(tmp_path / "set", **changes), progress=False)
    assert not (tmp_path / "set").exists()


def test_a_mistake_in_a_worker_comes_through(tmp_path):
    job = Job(TaskSource("open-v1:nowhere"), RECIPES["debug"], 5)
    with pytest.raises(TaskError, match="nowhere"), ProcessPool(job, 1):
        pass


def test_a_killed_worker_is_reported():
    with ProcessPool(Job(TaskSource("open-v1:train"), RECIPES["debug"], 1), 1) as pool:
        flown = pool.fly([[index] for index in range(20)])
        assert next(flown)[0].episode.index == 0
        (worker,) = multiprocessing.active_children()
        worker.kill()
        with pytest.raises(WorkerLost, match=r"the worker of episodes . to . was killed by SIGKILL.*--resume"):
            list(flown)
    assert not multiprocessing.active_children()


def test_without_ray_the_extra_is_named_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtra, match=r"cognitivedrone\[ray\]"):
        collect(config(tmp_path / "set", executor="ray"), progress=False)
    assert not (tmp_path / "set").exists()


def test_shards_share_out_all_indices():
    job = Job(TaskSource("open-v1:train"), RECIPES["paper"], 64)
    indices = np.concatenate([job.indices(number) for number in range(job.shards)])
    assert np.array_equal(indices, np.arange(8062))
    families = Counter(index % 10 for index in indices)
    assert max(families.values()) - min(families.values()) <= 1


def test_the_stages_of_a_mission_are_collected_as_tasks_of_their_own_and_a_landing_too(tmp_path, monkeypatch):
    monkeypatch.setattr(collector, "pool_of", flying(backwards))
    stages = load_suite("open-v3:missions").tracks[5]
    write_tasks(tmp_path / "whole.json", stages)
    mission = config(tmp_path / "set", tasks=tmp_path / "whole.json", episodes=1)
    with pytest.raises(DataError, match="without their 'mission'"):
        collect(mission, progress=False)
    write_tasks(tmp_path / "parts.json", [replace(stage, mission=None) for stage in stages])
    report = collect(config(tmp_path / "set", tasks=tmp_path / "parts.json", episodes=2), progress=False)
    assert report.outcomes == {"passed": 2}
    landing = list(Store.open(tmp_path / "set").episodes())[1]
    assert landing.task.landing
    assert landing.final_position[2] < 0.2


@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_cluster_makes_the_same_bytes_as_local_workers(tmp_path):
    ray = pytest.importorskip("ray", reason="the extra 'ray' is not installed")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        cluster.add_node(num_cpus=1)
        ray.init(address=cluster.address, log_to_driver=False)
        assert len([node for node in ray.nodes() if node["Alive"]]) == 2
        folders: dict[Any, Path] = {name: tmp_path / name for name in ("ray", "local")}
        for executor, out in folders.items():
            collect(
                CollectPlan.of(out=out, recipe="debug", episodes=8, workers=2, episodes_per_shard=2, executor=executor),
                progress=False,
            )
        nowhere = Job(TaskSource("open-v1:nowhere"), RECIPES["debug"], 5)
        with pytest.raises(TaskError, match="nowhere"), RayPool(nowhere, 1, 1):
            pass
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert len(digests(folders["ray"])) >= 4 + 4 + 2
    assert digests(folders["ray"]) == digests(folders["local"])
