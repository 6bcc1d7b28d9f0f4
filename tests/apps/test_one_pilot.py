"""What `fly` shows is what `bench` scores: the same task, seed and pilot give the same flight, bit for bit."""

from contextlib import closing

import numpy as np
import pytest
from app_fakes import events_of, flown, steps_of

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import resolve

SURE, UNSURE = {"suite": "open-v1:smoke", "episode": 4}, {"suite": "open-v3:photos", "episode": 6}


@pytest.mark.parametrize("scene", [SURE, UNSURE])
def test_fly_and_bench_fly_the_same(tmp_path, scene):
    options = {"suite": scene["suite"], "appearance": "plain", "reasoner": "small", "seed": 3}
    with closing(PilotRunner(resolve(Plan.of(**options), named=False))) as runner:
        scored = runner.fly(scene["episode"], film=False)
    shown = flown(pace="lockstep", out=tmp_path / "f", episode=scene["episode"], time_limit=60.0, **options)
    steps = steps_of(tmp_path / "f")
    path = np.array([steps[axis] for axis in ("x_m", "y_m", "z_m")], np.float32).T
    assert np.array_equal(path, scored.trace.path[: len(path)])
    assert len(path) == len(scored.trace.path) - 1
    assert [(end.outcome, end.chosen, end.time_s) for end in shown.results] == [
        (end.outcome, end.chosen, end.time_s) for end in scored.result.stages
    ]
    assert any(event["kind"] == "hold" for event in events_of(tmp_path / "f")) == (scene is UNSURE)
