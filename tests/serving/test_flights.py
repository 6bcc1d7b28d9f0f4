"""Flights of served pilots: to the bit as in the command's own process, and where the server falls silent."""

import io
import json
import threading
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from policy_clients import openpi_server
from rich.console import Console

from cognitivedrone import evaluate
from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.fly import fly_mission
from cognitivedrone.benchmark.config import Plan, ReasonPlan
from cognitivedrone.benchmark.reasoning.reason import score_reasoner
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import serving

SUITE = {"suite": "open-v1:smoke", "episodes": 2, "overwrite": True}


@pytest.fixture(scope="module")
def address():
    with serving(ServePlan.of(policy="colour_seeker", reasoner="small", port=0)) as where:
        yield where


def test_scores_do_not_depend_on_where_the_pilot_runs(address, tmp_path):
    plan = Plan.of(**SUITE, policy="colour_seeker", reasoner="small", workers=0, clips=0)
    plan = plan.changed(latency="policy=80ms,reasoner=250ms")
    here = run(plan.changed(out=tmp_path / "here"), progress=False)
    remote = f"remote:ws://{address}"
    there = run(plan.changed(policy=remote, reasoner=remote, out=tmp_path / "there"), progress=False)
    assert here.episodes
    assert any(stage.reasoner.answers > 0 for episode in here.episodes for stage in episode.stages)
    assert there.episodes == here.episodes


def test_a_served_reasoner_scores_as_a_local_one(address, tmp_path):
    plan = ReasonPlan.of(**SUITE, reasoner="small")
    here = score_reasoner(plan.changed(out=tmp_path / "here"), progress=False)
    there = score_reasoner(plan.changed(reasoner=f"remote:ws://{address}", out=tmp_path / "there"), progress=False)
    assert here.answers
    assert [replace(one, seconds=0) for one in there.answers] == [replace(one, seconds=0) for one in here.answers]


def test_a_server_whose_error_no_file_takes_costs_its_episodes_and_not_the_run(tmp_path):
    refusal = json.dumps({"error": {"code": "policy_error", "message": "bad \ud800 \u202e"}})
    with openpi_server(lambda _: refusal) as address:
        evaluation = evaluate(
            f"remote:ws://{address},warm_up=0", episodes=2, workers=0, out=tmp_path / "run", progress=False
        )
    assert evaluation.summary.overall.outcomes["policy_error"] == 2
    assert [episode.message for episode in evaluation.results.episodes] == [r"bad \ud800 \u202e"] * 2
    assert r"bad \\ud800" in (tmp_path / "run" / "results.json").read_text()


SILENT_S = 0.7


def test_the_flight_goes_on_when_the_server_answers_again(tmp_path):
    asked, nobody = 0, threading.Event()

    def infer(message):
        nonlocal asked
        asked += 1
        if asked == 4:
            nobody.wait(SILENT_S)
        return {"actions": np.array([[0.3, 0.0, 0.0, 0.0]])}

    with openpi_server(infer) as address:
        plan = FlyPlan.of(
            film=False, policy=f"remote:ws://{address}", reasoner="none", time_limit=3, view=False, out=tmp_path / "f"
        )
        summary = fly_mission(plan, console=Console(file=io.StringIO()), keyboard=io.StringIO())
    assert summary.ending.kind == "missed"
    events = pq.read_table(tmp_path / "f" / "events.parquet").to_pylist()
    found = [event for event in events if event["kind"] in ("lost", "back")]
    assert [event["kind"] for event in found[:2]] == ["lost", "back"]
    assert "has not answered in time" in found[0]["text"]
    assert found[1]["time_s"] > found[0]["time_s"]
    steps = pq.read_table(tmp_path / "f" / "steps.parquet").to_pylist()
    # The answer that is late was asked for with an earlier frame.
    lost, back = (event["time_s"] for event in found[:2])
    held = [step["sent_vx_m_s"] for step in steps if lost - 0.5 < step["time_s"] < back]
    after = [step["sent_vx_m_s"] for step in steps if step["time_s"] > back]
    assert 0.0 in held
    assert max(after) > 0
