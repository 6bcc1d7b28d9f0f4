"""A flight in real time whose server falls silent: the drone holds its position, and the log says so."""

import io
import threading

import numpy as np
import pyarrow.parquet as pq
from policy_clients import openpi_server
from rich.console import Console

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.fly import fly_mission

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
