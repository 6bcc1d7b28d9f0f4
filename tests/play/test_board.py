"""What the page is told of a scene."""

from dataclasses import replace

import numpy as np
import pytest

from cognitivedrone.film.frame import Scene
from cognitivedrone.play.board import scene_table
from cognitivedrone.sim.simulator import Scenery
from cognitivedrone.types import Gate, GatePlace, Stage

GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue"))


@pytest.mark.parametrize(("left_out", "numbers"), [({}, [1, 2, 3]), ({"missing": 0}, [2, 3]), ({"only": 1}, [2])])
def test_gates_keep_their_numbers_where_others_are_missing(left_out, numbers):
    scene = Scene(
        Stage(GATES, ("",) * 3, **left_out), Scenery((np.zeros((8, 8, 3), np.uint8),) * 3), ("cat", "dog", "owl")
    )
    shown = scene_table(scene)["gates"]
    assert [gate["number"] for gate in shown] == numbers
    assert [gate["color"] for gate in shown] == [GATES[number - 1].color for number in numbers]


def test_the_way_of_a_gate_that_moves_is_shown():
    places = [GatePlace(4.0, 4.0 - 4.0 * index, 0.9, 0.0) for index in range(3)]
    stage = Stage(GATES, ("",) * 3, layout=(places[0], replace(places[1], sway=0.5), places[2]))
    scene = Scene(stage, Scenery((np.zeros((8, 8, 3), np.uint8),) * 3), ("cat", "dog", "owl"))
    assert [gate["way"] for gate in scene_table(scene)["gates"]] == [[], [[4.0, 1.025, 0.9], [4.0, -1.025, 0.9]], []]
