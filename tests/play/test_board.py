"""What the page is told of a scene."""

from __future__ import annotations

import numpy as np
import pytest

from cognitivedrone.film.frame import Scene
from cognitivedrone.play.board import scene_table
from cognitivedrone.sim.drone_world import Scenery
from cognitivedrone.types import Gate, Stage

GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue"))


@pytest.mark.parametrize(("left_out", "numbers"), [({}, [1, 2, 3]), ({"missing": 0}, [2, 3]), ({"only": 1}, [2])])
def test_gates_keep_their_numbers_where_others_are_missing(left_out, numbers):
    scene = Scene(
        Stage(GATES, ("",) * 3, **left_out), Scenery((np.zeros((8, 8, 3), np.uint8),) * 3), ("cat", "dog", "owl")
    )
    shown = scene_table(scene)["gates"]
    assert [gate["number"] for gate in shown] == numbers
    assert [gate["color"] for gate in shown] == [GATES[number - 1].color for number in numbers]
