"""Obstacles of tasks: the suite keeps its promises, files are read as written, and faults are said in one sentence."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cognitivedrone.envs.track_runner import stage_of
from cognitivedrone.errors import TaskError
from cognitivedrone.layout import draw_layout
from cognitivedrone.layout.obstacles import solids_of
from cognitivedrone.tasks import load_suite, train_task
from cognitivedrone.tasks.families.clutter import (
    CLEAR_M,
    KINDS,
    SEEN,
    cluttered,
    crossed,
    has_ways,
    is_free,
    is_in_the_way,
    seen_share,
)
from cognitivedrone.tasks.format import task_from_json, task_to_json
from cognitivedrone.world import geometry

MOVING = [task for (task,) in load_suite("open-v3:moving").tracks]
TASKS = [task for (task,) in load_suite("open-v3:clutter").tracks]
PLAIN = next(task for (task,) in load_suite("open-v1:test").tracks if task.board is None)
PILLAR = {"kind": "pillar", "x": 2.0, "y": 0.5, "width": 0.3, "height": 2.0}
WALL = {"kind": "wall", "x": 2.5, "y": -1.0, "width": 1.5, "height": 1.0}
BEAM = {"kind": "beam", "x": 2.5, "y": -1.0, "width": 1.5, "height": 0.1, "above": 1.2}
MARK = {"label": "animal/cat@noto", "x": 3.0, "y": 2.2, "height": 2.0, "yaw": 0.4}


@pytest.mark.parametrize("task", TASKS[::20], ids=lambda task: task.id)
def test_something_is_in_the_way_but_there_is_a_way_and_the_panels_are_seen(task):
    assert is_in_the_way(task)
    assert is_free(task)
    assert has_ways(task)
    assert CLEAR_M > 0.28 + 0.1
    assert seen_share(solids_of(task.obstacles, task.landmark), task.layout) >= SEEN


@pytest.mark.parametrize("task", MOVING[::20], ids=lambda task: task.id)
def test_wherever_the_moving_things_are_there_is_a_way_and_the_panels_are_seen(task):
    assert is_in_the_way(task)
    assert has_ways(task)
    solids = solids_of(task.obstacles, task.landmark)
    for time in np.linspace(0.0, task.obstacles[0].period, 12):
        assert seen_share(solids.at(time), task.layout) >= SEEN


@pytest.mark.parametrize(("missing", "message"), [
    (PLAIN.target + 1, "must be the number of a gate that is not the right one"),
    (4, "it must be 1, 2 or 3"),
    (True, "it must be 1, 2 or 3"),
])  # fmt: skip
def test_only_a_wrong_gate_can_be_missing(missing, message):
    with pytest.raises(TaskError, match=message):
        read([], missing=missing)


def test_a_missing_gate_comes_back_from_a_file_and_is_nowhere():
    wrong = (PLAIN.target + 1) % 3
    task = read([], missing=wrong + 1)
    assert task == replace(PLAIN, missing=wrong)
    assert task_to_json(task)["missing"] == wrong + 1
    stage = stage_of(task)
    assert wrong not in {*geometry.standing(stage), *geometry.panelled(stage), *geometry.choices(stage)}
    assert len(geometry.standing(stage)) == 2


def test_a_file_holds_how_something_moves():
    swaying = {**PILLAR, "sway": 0.5, "phase": 1.5}
    task = read([swaying, {**PILLAR, "kind": "person", "y": -2.0, "width": 0.5, "height": 1.8}])
    assert (task.obstacles[0].sway, task.obstacles[0].period, task.obstacles[0].yaw) == (0.5, 8.0, 0.0)
    entries = task_to_json(task)["obstacles"]
    assert entries[0] == {**swaying, "period": 8.0, "yaw": 0.0}
    assert entries[1].keys() == PILLAR.keys()
    assert task_from_json(json.loads(json.dumps(task_to_json(task))), where="x") == task


@pytest.mark.parametrize(("draw", "kind", "count"), [(cluttered, "frame", 4), (crossed, "person", 3)])
def test_equal_seeds_draw_equal_obstacles(draw, kind, count):
    first, second = (draw(np.random.default_rng(3), PLAIN, kind, count) for _ in range(2))
    assert first == second
    assert task_from_json(json.loads(json.dumps(task_to_json(first))), where="x") == first


def test_a_layout_without_room_for_obstacles_is_replaced():
    rng = np.random.default_rng(2945)
    task = train_task(2945, 0)
    assert rng.random() < 0.7
    task = replace(task, layout=draw_layout(rng, task.gates, board=task.board is not None))
    found = cluttered(rng, task, KINDS[rng.integers(4)], int(rng.integers(2, 9)))
    assert found.layout not in (None, task.layout)
    assert has_ways(found)


def test_defaults_of_a_file():
    task = read([PILLAR, WALL, BEAM], MARK)
    assert [each.depth for each in task.obstacles] == [0.1] * 3
    assert {"obstacles", "landmark"}.isdisjoint(task_to_json(PLAIN))


def read(obstacles, landmark=None, **more):
    return task_from_json(task_to_json(PLAIN) | {"obstacles": obstacles, "landmark": landmark} | more, where="f[0]")


@pytest.mark.parametrize(
    ("things", "message"),
    [
        ({}, "obstacles must be a list of objects, not dict"),
        ([PILLAR] * 1000, "1000 obstacles are too many; leave 20 at most"),
        ([3], "obstacle 1 has the unknown kind 3"),
        ([PILLAR, {**PILLAR, "kind": "pilar"}], "obstacle 2 has the unknown kind 'pilar'; did you mean 'pillar'"),
        ([{**PILLAR, "yaw": 1.0}], "obstacle 1, a pillar, has the unknown key 'yaw'; it has x, y, width, height"),
        ([{**PILLAR, "x": "2"}], "obstacle 1, a pillar, has x '2'; give it a number"),
        ([{key: value for key, value in BEAM.items() if key != "above"}], "a beam, has above None; give it a number"),
        ([{**PILLAR, "width": -0.3}], "obstacle 1, a pillar, has width -0.3; make it 0.05 to 6"),
        ([{**PILLAR, "height": float("nan")}], "has height nan; make it"),
        ([{**PILLAR, "x": 10**400}], "has x inf; make it -4 to 8.5"),
        ([{**PILLAR, "x": -0.5}], "obstacle 1, a pillar, overlaps the start box; move it away"),
        ([{**PILLAR, "x": 5.1, "y": 0.2}], "overlaps the opening or the panel of gate 2; move it away"),
        ([WALL, {**BEAM, "x": 4.0, "y": 4.0, "above": 2.6}], "obstacle 2, a beam, overlaps the opening or the panel"),
        ([{**BEAM, "kind": "frame"}], "too narrow for an opening"),
        ([{**PILLAR, "period": 3.0}], "has the unknown key 'period'; it has x, y, width, height"),
        ([{**PILLAR, "sway": 1.0, "perod": 3.0}], "has the unknown key 'perod'; it has x, y, width, height, yaw, sway"),
        ([{**PILLAR, "sway": -1.0}], "obstacle 1, a pillar, has sway -1; make it 0 to 3"),
        ([{**PILLAR, "sway": 0.5, "period": 0}], "obstacle 1, a pillar, has period 0; make it 1 to 60"),
        ([{**PILLAR, "sway": 2.0}], "obstacle 1, a pillar, moves at 1.57 m/s; make its period 12.6 s at least"),
        ([{**PILLAR, "x": 3.8, "sway": 1.0, "yaw": -1.57}], "a pillar, on its way overlaps the opening or the panel"),
        ((3,), "landmark must be an object, not int"),
        (({**MARK, "label": 3},), "the label of the landmark must be a string"),
        (({**MARK, "height": 0.2},), "the landmark has height 0.2; make it 1.2 to 4"),
        (({**MARK, "x": 5.0, "y": 0.0},), "the landmark overlaps the opening or the panel of gate 2"),
        (({**MARK, "wide": 3},), "the landmark has the unknown key 'wide'"),
    ],
)
def test_faults_of_obstacles_and_of_landmarks_are_said_in_one_sentence(things, message):
    with pytest.raises(TaskError, match=r"^f\[0\]: ") as caught:
        read([], *things) if isinstance(things, tuple) else read(things)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_landing_has_no_obstacles_and_a_board_no_landmark():
    with pytest.raises(TaskError, match="a board or a landmark"):
        read([], MARK, board="sum/1+2@inter")
    landing = next(task for track in load_suite("open-v3:missions").tracks for task in track if task.landing)
    with pytest.raises(TaskError, match="a landing has three pads and nothing else"):
        task_from_json(task_to_json(landing) | {"obstacles": [PILLAR]}, where="f[0]")
