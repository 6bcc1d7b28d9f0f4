"""Task files: exact both ways, and clear about what is wrong."""

import copy
import itertools
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import format as task_format
from cognitivedrone.tasks import (
    load_suite,
    parse_directive,
    read_tasks,
    task_from_json,
    task_to_json,
    train_task,
    write_directive,
    write_tasks,
)
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

UPSTREAM = Path(__file__).resolve().parents[3] / "shared" / "upstream" / "tasks"

PUBLISHED: dict[str, Any] = {
    "prompt": "Fly through the gate with correct answer",
    "prompt_simpler": "Fly through the big triangle red gate with 9",
    "task": {"d1": "1", "d2": "9", "operator": "*"},
    "options": ["nine.dae", "seven.dae", "six.dae"],
    "correct": 1,
    "gates": {
        "1": {"size": "big", "shape": "triangle", "color": "red"},
        "2": {"size": "small", "shape": "square", "color": "blue"},
        "3": {"size": "small", "shape": "round", "color": "green"},
    },
    "background": "room",
}


@given(st.integers(0, 10**6), st.integers(0, 10**6))
def test_a_task_survives_its_json(index: int, seed: int) -> None:
    task = train_task(index, seed)
    obj = json.loads(json.dumps(task_to_json(task)))
    assert task_from_json(obj, where="here") == task


def test_files_round_trip(tmp_path: Path) -> None:
    tasks = [task for name in ("smoke", "hard") for track in load_suite(f"open-v1:{name}").tracks for task in track]
    write_tasks(tmp_path / "all.json", tasks)
    assert read_tasks(tmp_path / "all.json") == tasks


def test_a_published_task_is_read_and_its_keys_written_as_they_were() -> None:
    task = task_from_json(PUBLISHED, where="here", kind="Math_desk", default_id="Math_desk/0000")
    assert task.labels == ("Math_desk/nine", "Math_desk/seven", "Math_desk/six")
    assert (task.category, task.family, task.target) == ("reasoning", "math_board", 0)
    assert task.board == "sum/1*9@inter"
    written = task_to_json(task)
    assert {key: written[key] for key in PUBLISHED} == PUBLISHED


def test_both_shapes_of_gates_mean_the_same() -> None:
    listed = copy.deepcopy(PUBLISHED)
    listed["gates"] = [{"gate": number, **gate} for number, gate in reversed(PUBLISHED["gates"].items())]
    both = [task_from_json(obj, where="here", kind="Math_desk") for obj in (PUBLISHED, listed)]
    assert both[0] == both[1]


def test_a_sum_in_the_prompt_is_mathematics() -> None:
    obj = PUBLISHED | {"prompt": "Fly through the gate with number equal 10-1"}
    del obj["task"]
    task = task_from_json(obj, where="here", kind="Math")
    assert (task.category, task.family, task.board) == ("reasoning", "math", None)


@pytest.mark.skipif(not UPSTREAM.is_dir(), reason="the published task files are not at hand")
def test_all_published_files_are_read_and_written_back() -> None:
    files = sorted(UPSTREAM.glob("*.json"))
    assert files
    for path in files:
        published = json.loads(path.read_text(encoding="utf-8"))
        tasks = read_tasks(path)
        assert len(tasks) == len(published)
        for task, obj in zip(tasks, published, strict=True):
            written = task_to_json(task)
            assert {key: written[key] for key in obj} == obj
            gate = task.gates[task.target]
            assert parse_directive(task.directive) == (gate.size, gate.color, gate.shape)


def test_what_is_no_task_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "tasks.json"
    for text, message in (
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("{}", "JSON list of tasks, not dict"),
        ("[]", "holds no task"),
        ("[3]", r"tasks\.json\[0\]: a task must be a JSON object, not int"),
    ):
        path.write_text(text)
        with pytest.raises(TaskError, match=message):
            read_tasks(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TaskError, match="not JSON"):
        read_tasks(path)
    monkeypatch.setattr(task_format, "MAX_TASKS", 2)
    path.write_text(json.dumps([PUBLISHED] * 3))
    with pytest.raises(TaskError, match="3 tasks are too many"):
        read_tasks(path)
    with pytest.raises(TaskError, match="and at most 10 are read"):
        task_format.read_json(path, max_bytes=10)


GATES = PUBLISHED["gates"]


def layout(**second):
    """A gate layout whose second gate is changed."""
    places = {str(n): {"x": 4.0, "y": 8.0 - 4.0 * n, "height": 0.9, "yaw": 0.0} for n in (1, 2, 3)}
    places["2"] |= second
    return places


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"correct": 0}, "correct is 0; it must be 1, 2 or 3"),
        ({"correct": True}, "correct is True"),
        ({"correct": 10**100}, r"correct is 1000\d{36}; it must be 1, 2 or 3"),
        ({"layout": layout(y=-float("inf"))}, "y of gate 2 is -inf; it must be from -7 to 7"),
        (
            {"layout": layout(phase=1.0)},
            "place of gate 2 must be x, y, height, yaw and, if it moves, sway, period, phase",
        ),
        ({"layout": layout(sway=True)}, "sway, period, phase: numbers in m, rad and s"),
        ({"layout": layout(sway=1.5)}, "sway of gate 2 is 1.5; it must be from 0 to 1"),
        ({"layout": layout(sway=0.5, period=0)}, "period of gate 2 is 0; it must be from 1 to 60"),
        ({"layout": layout(sway=0.5, phase=9)}, "phase of gate 2 is 9; it must be from -6.28 to 6.28"),
        ({"layout": layout(sway=0.5, period=2)}, "gate 2 moves at 1.57 m/s; make its period 3.1 s at least"),
        ({"layout": layout(x=4.0, y=3.5)}, "gates 1 and 2 touch; move them apart"),
        ({"layout": layout(x=7.9, y=5.5)}, "a gate of the layout hides another"),
        ({"layout": layout(sway=1.0, y=1.2)}, "gates 1 and 2 may meet on their ways; move them apart"),
        (
            {"options": ["nine.dae", "six.dae", "nine.dae"]},
            "options 1 and 3 are both 'nine.dae', so there are two right",
        ),
        ({"options": ["nine.dae", "six.dae", "six.dae"]}, "options 2 and 3 are both 'six.dae'; give each gate"),
        ({"options": ["nine.dae", "six.dae"]}, "options must be a list of 3 names, one a gate, not 2 entries"),
        ({"options": ["nine.dae", 3, "six.dae"]}, "an entry of options must be a string, not int"),
        ({"labels": ["number/9@inter", "number/9@lora", "number/7@lora"]}, "two right answers"),
        ({"prompt": 7}, "prompt must be a string"),
        ({"prompt": " "}, "prompt is empty"),
        ({"prompt": "fly " * 1000}, "prompt has 4000 characters"),
        ({"prompt_simpler": None}, "prompt_simpler must be a string"),
        ({"prompt_simpler": "Fly through the green gate"}, "names the green gate, but the right gate 1 is red"),
        ({"category": "reasonning"}, "unknown category 'reasonning'; did you mean 'reasoning'"),
        ({"family": {}}, "family must be a string"),
        ({"task": {"d1": 1}}, "task must have d1, operator and d2"),
        ({"task": {"d1": "1", "operator": "/", "d2": "2"}}, "the sum on the board reads '1/2'"),
        ({"gates": [{"gate": "1", **GATES["1"]}] * 3}, "gates must describe gate 1, 2 and 3"),
        ({"gates": GATES | {"2": {"size": "big"}}}, "gate 2 needs 'shape'"),
        ({"gates": GATES | {"2": GATES["2"] | {"size": "bgi"}}}, "unknown size of gate 2 'bgi'; did you mean 'big'"),
        (
            {"gates": GATES | {"2": GATES["2"] | {"shape": "hexagon"}}},
            "unknown shape of gate 2 'hexagon'; known: round",
        ),
        ({"gates": GATES | {"2": GATES["2"] | {"color": "pink"}}}, "unknown color of gate 2 'pink'; known: blue"),
        ({"gates": GATES | {"2": GATES["2"] | {"color": "red"}}}, "gates 1 and 2 are both red; give the three gates"),
    ],
)
def test_malformed_tasks_are_told_in_one_sentence(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = tmp_path / "Math_desk.json"
    path.write_text(json.dumps([PUBLISHED, PUBLISHED | change]))
    with pytest.raises(TaskError, match=message) as caught:
        read_tasks(path)
    assert "Math_desk.json[1]: " in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["prompt", "prompt_simpler", "options", "correct", "gates", "background"])
def test_missing_keys_are_named(key: str) -> None:
    obj = {name: value for name, value in PUBLISHED.items() if name != key}
    with pytest.raises(TaskError, match=f"here: key '{key}' is missing"):
        task_from_json(obj, where="here", kind="Math_desk")


def test_tasks_of_unknown_kinds_must_say_what_they_are() -> None:
    obj = {name: value for name, value in PUBLISHED.items() if name != "task"}
    with pytest.raises(TaskError, match='no category; add "category", one of human_recognition'):
        task_from_json(obj, where="here", kind="Mine")
    task = task_from_json(obj | {"category": "reasoning"}, where="here", kind="Mine")
    assert (task.family, task.labels[0]) == ("mine", "Mine/nine")
    with pytest.raises(TaskError, match="key 'labels' is missing"):
        task_from_json(obj | {"category": "reasoning", "family": "mine"}, where="here")


def test_directives_are_read_as_written() -> None:
    for size, color, shape in itertools.product(SIZES, COLORS, SHAPES):
        assert parse_directive(write_directive(Gate(size, shape, color))) == (size, color, shape)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Fly through the big triangle red gate with 9", ("big", "red", "triangle")),
        ("fly to the LARGE circular, blue gate.", ("big", "blue", "round")),
        ("the green one", (None, "green", None)),
        ("Fly through the gate with a big red circle", (None, None, None)),
        ("Fly through the blue gate with a red hat", (None, "blue", None)),
        ("", (None, None, None)),
    ],
)
def test_directives_are_read_tolerantly(text: str, expected: tuple[str | None, ...]) -> None:
    assert parse_directive(text) == expected


@given(st.text(max_size=200))
def test_reading_a_directive_never_fails(text: str) -> None:
    size, color, shape = parse_directive(text)
    assert size in (*SIZES, None)
    assert color in (*COLORS, None)
    assert shape in (*SHAPES, None)
