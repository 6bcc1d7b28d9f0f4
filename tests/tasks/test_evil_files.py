"""Task files that somebody else wrote, on purpose or with a broken tool: rejected when read, or read as they say."""

import copy
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from cognitivedrone.benchmark.reports.tables import as_text
from cognitivedrone.cli import main
from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import load_suite, read_tasks, suite_from_files, task_to_json

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import faults_input

TASK: dict[str, Any] = task_to_json(load_suite("open-v1:smoke").tracks[0][0]) | {"id": "mine"}
UNFIT = {
    "\x1b[31m": "control character U+001B",
    "\ud800": "lone surrogate U+D800",
}


def written(folder: Path, *tasks: dict[str, Any], name: str = "tasks.json") -> Path:
    path = folder / name
    path.write_text(json.dumps([{**copy.deepcopy(TASK), "id": "first"}, *tasks]))
    return path


@pytest.mark.parametrize("unfit", UNFIT, ids=ascii)
@pytest.mark.parametrize(
    ("field", "said"),
    [
        ("prompt", "prompt"), ("prompt_simpler", "prompt_simpler"), ("background", "background"), ("id", "id"),
        ("family", "family"), ("board", "board"), ("options", "an entry of options"),
        ("labels", "an entry of labels"),
    ],
)  # fmt: skip
def test_an_unfit_character_is_told_with_file_index_field_and_fix(tmp_path, field, said, unfit):
    text = f"animal/{unfit}cat@noto"
    path = written(tmp_path, TASK | {field: ["a", text, "c"] if field in ("options", "labels") else text})
    with pytest.raises(TaskError) as told:
        suite_from_files(path)
    assert str(told.value) == f"{path}[1]: {said} contains the {UNFIT[unfit]} at position 8; remove it"


@pytest.mark.parametrize(
    "sum_", [("1", "+", "2@inter/../../x"), ("1", "+", "2@x\x1b"), ("١", "+", "2"), ("1/../", "+", "2")]
)
def test_a_sum_is_two_numbers_and_a_sign(tmp_path, sum_):
    task = {key: value for key, value in TASK.items() if key != "board"}
    asked = dict(zip(("d1", "operator", "d2"), sum_, strict=True))
    with pytest.raises(TaskError, match="use two numbers"):
        read_tasks(written(tmp_path, task | {"task": asked}))


def test_a_sum_and_its_board_say_the_same(tmp_path):
    task = {"task": {"d1": "1", "operator": "+", "d2": "2"}, "board": "sum/1+3@inter"}
    with pytest.raises(TaskError, match=r"task asks 1\+2, but board shows 'sum/1\+3@inter'; correct one of them"):
        read_tasks(written(tmp_path, TASK | task))
    (_, read) = read_tasks(written(tmp_path, TASK | task | {"board": "sum/1+2@lora"}))
    assert read.board == "sum/1+2@lora"


def test_a_key_that_stands_twice_is_ambiguous(tmp_path):
    path = tmp_path / "tasks.json"
    path.write_text(json.dumps([TASK]).replace('"correct":', '"correct": 1, "correct":'))
    with pytest.raises(TaskError, match="the name 'correct' is given twice in an object"):
        read_tasks(path)


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("Labels", "labels"), ("only ", "only"), ("board\x1b", "board"), ("PROMPT", "prompt"), ("lables", "labels"),
        ("prompt_simple", "prompt_simpler"), ("layot", "layout"), ("catagory", "category"), ("bord", "board"),
    ],
)  # fmt: skip
def test_a_misspelled_key_is_not_overlooked(tmp_path, key, meant):
    with pytest.raises(TaskError, match=r"tasks.json\[1\] has the unknown key .*; did you mean") as told:
        read_tasks(written(tmp_path, TASK | {key: "x"}))
    assert str(told.value).endswith(f"; did you mean {meant!r}?")


def test_a_misspelled_key_explains_one_that_is_missing(tmp_path):
    task = {"promt" if key == "prompt" else key: value for key, value in TASK.items()}
    with pytest.raises(TaskError, match="has the unknown key 'promt'; did you mean 'prompt'"):
        read_tasks(written(tmp_path, task))


@pytest.mark.parametrize(
    "key", ["prompt_id", "task_id", "category_id", "idx", "name", "note", "difficulty", "gate_types"]
)
def test_another_key_is_not_taken_for_a_misspelling(tmp_path, key):
    read_tasks(written(tmp_path, TASK | {key: "x"}))


def test_keys_of_others_are_left_alone(tmp_path):
    assert read_tasks(written(tmp_path, TASK | {"weather": "\x1b[2J", "x": {"y": []}}))[1].id == "mine"
    with pytest.raises(TaskError, match=r"the key 'a\\x1bb' contains the control character"):
        read_tasks(written(tmp_path, TASK | {"a\x1bb": 1}))


@pytest.mark.parametrize("name", ["a\x1b[31m.json", "a\u202e.json", os.fsdecode(b"a\xff.json")], ids=ascii)
def test_the_name_of_a_file_is_a_text_too(tmp_path, name):
    path = written(tmp_path, name=name)
    for given in (path, tmp_path):
        with pytest.raises(TaskError, match=r"name holds the .*give .* another name"):
            suite_from_files(given)


def test_an_error_that_names_an_evil_file_is_safe_to_print(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = os.fsdecode(b"a\x1b[31m\xff.json")
    with pytest.raises(SystemExit, match="2"):
        main(["bench", "--tasks", name])
    said = capsys.readouterr().err
    assert said.startswith(r"cognitivedrone: a\x1b[31m\udcff.json: ")
    said.encode("utf-8")
    assert said.count("\n") == 1


def test_a_sample_of_mutated_files_is_rejected_or_read_as_it_says(tmp_path):
    found = faults_input.task_files(120, seed=1, folder=tmp_path)
    assert faults_input.bad(found, {"rejected", "same meaning"}) == 0
    ends = {end for counts in found.values() for end in counts}
    assert ends == {"rejected", "same meaning"}
    printed = as_text(faults_input.table("mutated", found), width=120)
    assert "120" in printed
