import numpy as np
import pytest

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.types import ACTION_LIMITS


@pytest.mark.parametrize("reasoner", ["none", "oracle"])
def test_a_film_holds_what_every_step_was_flown_by(reasoner):
    config = Plan.of(policy="colour_seeker", reasoner=reasoner, suite="open-v1:smoke")
    job = resolve(config)
    runner = PilotRunner(job)
    try:
        flown, plain = runner.fly(0, film=True), runner.fly(0, film=False)
    finally:
        runner.close()
    # Filming changes nothing of the flight.
    assert flown.result == plain.result
    assert plain.film is None
    film = flown.film
    assert len(film) == flown.result.steps
    task = job.suite.tracks[0][0]
    output = task.instruction if reasoner == "none" else task.directive
    assert {frame.instruction for frame in film} == {output}
    assert all((frame.guidance is None) == (reasoner == "none") for frame in film)
    assert np.diff([frame.time for frame in film]) == pytest.approx(0.1)
    actions = np.array([frame.action for frame in film])
    assert (np.abs(actions) <= ACTION_LIMITS).all()
    assert actions[:, 0].max() > 0.5
    # Frames are copies: the first is not overwritten by the last.
    assert (film[0].image != film[-1].image).any()
