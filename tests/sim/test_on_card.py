"""What only a card that draws can show: make test-card."""

import numpy as np
import pytest

from cognitivedrone.sim.drawing import gl, renderers
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.readback import OneByOne, TwoBuffers
from cognitivedrone.types import Gate, Stage
from cognitivedrone.world.geometry import START

pytestmark = pytest.mark.card
STAGE = Stage(
    (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue")), ("",) * 3
)


def test_a_card_draws_by_one_context_the_same_by_either_way_to_read() -> None:
    if renderers.on_processor(gl.renderer_name()):
        pytest.skip(f"no card draws here: {gl.renderer_name()} ({renderers.why(gl.renderer_name())})")
    with Cameras(4, threads=4) as cameras:
        assert len(cameras._threads) == 1
        for slot in range(4):
            cameras.set_stage(slot, STAGE, [np.full((64, 64, 3), 60 * slot, np.uint8)] * 3)
        poses = START + np.linspace(0, 0.5, 4)[:, None], np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
        thread, renderer = cameras._threads[0], cameras._renderers[0]
        assert isinstance(renderer._readback, TwoBuffers)
        frames = cameras.first_person(*poses)
        renderer._readback = thread.call(lambda: OneByOne(renderer._context, 256, 256)).result()
        np.testing.assert_array_equal(cameras.first_person(*poses), frames)
    assert frames.std(axis=(1, 2, 3)).min() > 10
