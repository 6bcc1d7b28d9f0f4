"""Episodes on a Ray cluster are those of a local run, whatever becomes of its nodes and workers: the extra `ray`."""

from dataclasses import replace
from typing import Any

import benchmark_fakes
import pytest
from benchmark_fakes import lasting

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs import runner
from cognitivedrone.benchmark.runs.records import read_records
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.errors import CognitiveDroneError, RunError

ray = pytest.importorskip("ray", reason="the extra 'ray' is not installed")
pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own
RUNNER = benchmark_fakes.FakeRunner


@pytest.fixture(scope="module")
def cluster():
    """One node of two cores; tests may add others."""
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
    try:
        ray.init(address=made.address, log_to_driver=False, logging_level="error")
        yield made
    finally:
        ray.shutdown()
        made.shutdown()


@pytest.fixture
def spread(config, cluster):
    """The twenty episodes, in two actors."""
    return config.changed(executor="ray", workers=2)


def local(config: Plan, name: Any = RUNNER, workers: int = 0) -> dict:
    here = config.changed(out=config.out.parent / "local", executor="local", workers=workers)
    run(here, progress=False, runner=name)
    return lasting(here.out)


def test_a_cluster_flies_what_a_local_run_flies(spread):
    spread = spread.changed(clips=3)
    results = run(spread, progress=False, runner=RUNNER)
    assert results.timing.workers == 2
    assert lasting(spread.out) == local(spread)
    assert (spread.out / "report.html").read_text().count("<video") == 3


def test_real_flights_are_the_same(spread):
    spread = spread.changed(suite="open-v1:smoke", policy="small", episodes=2)
    run(spread, progress=False)
    assert lasting(spread.out) == local(spread, runner.RUNNER)
    assert lasting(spread.out)["scores"]["through"]["overall"]["n"] == 2


def test_killing_a_node_loses_nothing(spread, cluster):
    node = cluster.add_node(num_cpus=1)
    (raylet,) = node.all_processes["raylet"]
    (spread.out.parent / "doomed").write_text(str(raylet.process.pid))
    spread = spread.changed(workers=3)
    results = run(spread, progress=False, runner=benchmark_fakes.NodeLosingRunner)
    assert raylet.process.wait(timeout=60) != 0
    assert results.timing.episodes_flown == 20
    assert lasting(spread.out) == local(spread)


@pytest.mark.parametrize("name", ["ActorLosingRunner", "OnceDyingRunner"])
def test_a_worker_that_is_killed_from_outside_is_replaced_and_its_episode_flown_again(spread, name):
    run(spread, progress=False, runner=getattr(benchmark_fakes, name))
    assert (spread.out.parent / "lost").exists()
    assert lasting(spread.out) == local(spread)


def test_an_episode_that_costs_every_worker_ends_the_run_which_goes_on_elsewhere(spread):
    with pytest.raises(RunError, match=r"episode 5 .* has lost its worker 3 times; .*--resume.*SIGKILL"):
        run(spread, progress=False, runner=benchmark_fakes.DyingRunner)
    assert 5 not in read_records(spread.out)
    results = run(spread.changed(executor="local", workers=0, resume=True), progress=False, runner=RUNNER)
    assert results.timing.episodes_flown < 20
    assert lasting(spread.out) == local(spread)


@pytest.mark.parametrize("name", ["CrashingRunner", "HangingRunner"])
def test_a_policy_that_takes_its_process_down_costs_the_same_as_locally(spread, name):
    spread = spread.changed(decision_timeout=1.0, episodes=7)
    run(spread, progress=False, runner=getattr(benchmark_fakes, name))
    assert lasting(spread.out) == local(spread, getattr(benchmark_fakes, name), workers=1)
    assert lasting(spread.out)["episodes"][5]["message"]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("UnlabelledRunner", r"^label 'zebr' is not in the pack; did you mean 'zebra'\?$"),
        ("BuggyRunner", r"episode 5 .* failed: ZeroDivisionError: a bug in a policy.*error\.txt"),
    ],
)
def test_errors_arrive_as_their_own_sentence(spread, name, says):
    with pytest.raises(CognitiveDroneError, match=says):
        run(spread, progress=False, runner=getattr(benchmark_fakes, name))


def test_a_node_of_another_version_does_not_fly(spread, monkeypatch):
    resolve = runner.resolve

    def elsewhere(plan, **options):
        job = resolve(plan, **options)
        return replace(job, facts=replace(job.facts, versions={**job.facts.versions, "mujoco": "9.9"}))

    monkeypatch.setattr(runner, "resolve", elsewhere)
    with pytest.raises(RunError, match=r"node .* would fly another run: versions\.mujoco is '.*' there and '9\.9'"):
        run(spread, progress=False, runner=RUNNER)
    assert not spread.out.exists()


def test_workers_that_no_node_has_room_for_are_refused(spread):
    with pytest.raises(RunError, match=r"no node of the Ray cluster has room for a worker \(2 CPU, 1 GPU\)"):
        run(spread.changed(cpus_per_worker=2, gpus_per_worker=1), progress=False, runner=RUNNER)


def test_as_many_workers_as_there_is_room_for(spread):
    assert run(spread.changed(workers=None), progress=False, runner=RUNNER).timing.workers == 2
    one = spread.changed(workers=None, cpus_per_worker=2, overwrite=True)
    assert run(one, progress=False, runner=RUNNER).timing.workers == 1
