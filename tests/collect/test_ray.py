"""A two-node Ray cluster on this machine makes the same bytes. Needs the extra `ray`."""

import hashlib
from pathlib import Path
from typing import Any

import pytest

from cognitivedrone.collect.collector import CollectPlan, Job, collect
from cognitivedrone.collect.recipe import RECIPES
from cognitivedrone.errors import TaskError
from cognitivedrone.plan import TaskSource
from cognitivedrone.rollout.ray_pool import RayPool

ray = pytest.importorskip("ray", reason="the extra 'ray' is not installed")


@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_cluster_makes_the_same_bytes_as_local_workers(tmp_path):
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
    ours, theirs = (
        {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in out.rglob("*") if path.is_file()}
        for out in folders.values()
    )
    assert len(ours) >= 4 + 4 + 2
    assert ours == theirs
