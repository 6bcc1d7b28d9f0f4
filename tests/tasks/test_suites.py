"""The committed suites: hashes, balance, and that they can be built again."""

import json
from collections import Counter
from collections.abc import Iterable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import (
    ABOUT,
    BASE_FAMILIES,
    HARD_FAMILIES,
    SUITES,
    TEST_ONLY,
    UNLIMITED,
    Suite,
    build,
    load_suite,
    suite_from_files,
    suites,
    train_task,
    validate_task,
    write_tasks,
)
from cognitivedrone.tasks.build import build_suite, suite_text
from cognitivedrone.tasks.generate import HELD_OUT, TRAIN
from cognitivedrone.tasks.suites import AUTHORED, BUILT, FIXED, drawn_task
from cognitivedrone.types import CATEGORIES, COLORS, SHAPES, SIZES, Task


def tasks_of(suite: Suite) -> list[Task]:
    return [task for track in suite.tracks for task in track]


def spread(values: Iterable[object], known: Iterable[object]) -> int:
    counts = Counter(values)
    return max(counts[value] for value in known) - min(counts[value] for value in known)


CROWDED = ("open-v3:clutter", "open-v3:moving", "open-v3:gates")
"""Among whose obstacles ways are looked for, which takes long."""


@pytest.mark.parametrize(
    "name", [*(pytest.param(name, marks=[pytest.mark.slow] * (name in CROWDED)) for name in BUILT), *AUTHORED]
)
def test_committed_files_are_what_is_built_and_authored_ones_have_their_form(name):
    committed = resources.files("cognitivedrone.tasks").joinpath("suites", f"{name.replace(':', '/')}.json")
    tracks = build_suite(name) if name in BUILT else load_suite(name).tracks
    assert committed.read_text(encoding="utf-8") == suite_text(name, tracks)


@pytest.mark.parametrize("name", CROWDED)
def test_every_task_of_a_crowded_suite_gets_its_obstacles(name, monkeypatch):
    monkeypatch.setattr(build, "equal_shares", lambda total: {"animals": 5})
    tasks = [task for (task,) in build_suite(name)]
    assert len(tasks) == 5
    frames = [sum(obstacle.kind == "frame" for obstacle in task.obstacles) for task in tasks]
    if name == "open-v3:gates":  # two or three with a panel, and frames
        panels = [2 if task.missing is not None else 3 for task in tasks]
        assert sorted(map(sum, zip(panels, frames, strict=True))) == [2, 3, 4, 5, 6]
    else:
        assert all(task.obstacles for task in tasks)
    assert all(task.obstacles[0].sway > 0 for task in tasks) == (name == "open-v3:moving")


def test_the_command_writes_every_built_suite(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(build, "build_suite", lambda name: load_suite(name).tracks)
    build.main(tmp_path)
    assert len(capsys.readouterr().out.splitlines()) == len(BUILT)
    written = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.json")}
    assert written == {f"{name.replace(':', '/')}.json" for name in BUILT}
    assert json.loads((tmp_path / "open-v1" / "smoke.json").read_text())["name"] == "open-v1:smoke"


@pytest.mark.parametrize("name", FIXED)
def test_tasks_are_well_formed_with_ids_of_their_own(name):
    tasks = tasks_of(load_suite(name))
    for task in tasks:
        validate_task(task, task.id)
        assert task.id.startswith(f"{name}/")
    assert len({task.id for task in tasks}) == len(tasks)


@pytest.mark.parametrize("name", [name for name in FIXED if name != "open-v3:missions"])
def test_positions_colours_shapes_and_sizes_are_balanced(name):
    tasks = tasks_of(load_suite(name))
    every = [gate for task in tasks for gate in task.gates]
    if name == "open-v2:absent":  # there is no right gate, and one category
        right = every
    else:
        right = [task.gates[task.target] for task in tasks]
        assert spread((task.target for task in tasks), range(3)) <= 1
        if name not in ("open-v2:pictures", "open-v3:photos", "open-v3:wild"):  # they show no people
            assert spread((task.category for task in tasks), CATEGORIES) <= 1
    for gates in (right, every):
        assert spread((gate.color for gate in gates), COLORS) <= 1
        assert spread((gate.shape for gate in gates), SHAPES) <= 1
        assert spread((gate.size for gate in gates), SIZES) <= 1


def test_train_grows_to_any_size_and_each_task_stays_what_it_is():
    suite = load_suite("open-v1:train", size=10**9, seed=3)
    assert suite.n_tasks == len(suite.tracks) == 10**9
    assert suite.tracks[-1][0] == train_task(10**9 - 1, seed=3)
    assert suite.tracks[5:7] == [(train_task(5, 3),), (train_task(6, 3),)]
    assert suite.digest != load_suite("open-v1:train", size=10**9, seed=4).digest
    assert suite.digest == load_suite("open-v1:train", size=10**9, seed=3).digest
    assert load_suite("open-v1:train").n_tasks == 300
    assert load_suite("open-v1:train", size=UNLIMITED).tracks[-1][0] == train_task(UNLIMITED - 1)
    for name in FIXED:
        assert load_suite(name, size=UNLIMITED) is load_suite(name)


def test_the_beginning_of_a_fixed_suite_has_a_name_and_digest_of_its_own():
    part = load_suite("open-v1:smoke", size=7)
    assert part.n_tasks == 7
    assert part.name == "open-v1:smoke[:7]"
    assert part.digest != load_suite("open-v1:smoke").digest
    assert load_suite("open-v1:smoke", size=30) == load_suite("open-v1:smoke")


@pytest.mark.parametrize(
    ("name", "size", "message"),
    [
        ("open-v1:tset", None, "did you mean 'open-v1:test'"),
        ("open-v2:wrods", None, "did you mean 'open-v2:words'"),
        ("open-v1:test", 0, "at least 1"),
    ],
)
def test_unknown_suites_and_sizes(name, size, message):
    with pytest.raises(TaskError, match=message):
        load_suite(name, size=size)


def test_a_changed_suite_file_is_noticed(tmp_path, monkeypatch):
    text = resources.files("cognitivedrone.tasks").joinpath("suites/open-v1/smoke.json").read_text(encoding="utf-8")
    changed = tmp_path / "suites" / "open-v1" / "smoke.json"
    changed.parent.mkdir(parents=True)
    changed.write_text(text.replace('"correct":1', '"correct":2', 1), encoding="utf-8")
    monkeypatch.setattr(suites.resources, "files", lambda package: tmp_path)
    suites._fixed_suite.cache_clear()
    with pytest.raises(TaskError, match="does not match its hash"):
        load_suite("open-v1:smoke")


def test_sentences_typed_by_people_repeat_none_of_a_generator_or_of_another_suite():
    words = {plain(task.instruction) for name in AUTHORED for task in tasks_of(load_suite(name))}
    for name in BUILT:
        assert not words & {plain(task.instruction) for task in tasks_of(load_suite(name))}, name
    assert not words & {plain(train_task(index).instruction) for index in range(0, 20_000, 8)}
    families = [family for family in (*BASE_FAMILIES, *HARD_FAMILIES) if family != "memory"]
    for index in range(750):
        rng = np.random.default_rng([9, index])
        pools = HELD_OUT if index % 2 else TRAIN
        drawn = drawn_task(families[index // 2 % len(families)], rng, "?", pools)
        assert plain(drawn.instruction) not in words


def plain(text: str) -> str:
    """A sentence without upper case and closing marks."""
    return text.casefold().strip(" .!?")


def test_every_suite_says_what_it_tests_and_the_later_ones_are_for_tests_alone():
    assert {name for name in FIXED if not name.startswith("open-v1:")} == TEST_ONLY
    assert set(AUTHORED) <= TEST_ONLY
    assert set(ABOUT) == set(SUITES)
    assert "recur" in ABOUT["open-v1:hard"]


# ---- the user's own files


def test_a_file_and_a_folder_become_suites(tmp_path):
    tasks = [train_task(i) for i in range(4)]
    write_tasks(tmp_path / "a.json", tasks[:2])
    write_tasks(tmp_path / "b.json", tasks[2:])
    assert tasks_of(suite_from_files(tmp_path / "b.json")) == tasks[2:]
    both = suite_from_files(tmp_path)
    assert tasks_of(both) == tasks
    assert both.name == tmp_path.name
    assert len(both.digest) == 64


def test_what_systems_leave_in_a_folder_is_no_task_file(tmp_path):
    write_tasks(tmp_path / "a.json", [train_task(i) for i in range(2)])
    (tmp_path / "._a.json").write_bytes(b"\0\5\x16\7")
    assert suite_from_files(tmp_path).n_tasks == 2


def test_published_folders_are_read(tmp_path):
    (tmp_path / "Reasoning" / "Food").mkdir(parents=True)
    write_tasks(tmp_path / "Reasoning" / "Food" / "Food.json", [train_task(8)])
    (tmp_path / "Reasoning" / "Food" / "setup.json").write_text(json.dumps({"not": "tasks"}))
    assert suite_from_files(tmp_path).n_tasks == 1


def test_files_that_make_no_suite(tmp_path):
    with pytest.raises(TaskError, match="holds no task file"):
        suite_from_files(tmp_path)
    with pytest.raises(TaskError, match="cannot be read"):
        suite_from_files(tmp_path / "none.json")
    write_tasks(tmp_path / "a.json", [train_task(0), train_task(0)])
    with pytest.raises(TaskError, match=r"a\.json\[1\].*is taken"):
        suite_from_files(tmp_path)


def test_the_documentation_names_the_digests():
    text = (Path(__file__).resolve().parents[2] / "docs" / "suites.md").read_text(encoding="utf-8")
    for name in FIXED:
        suite = load_suite(name)
        assert f"| `{name}` | {suite.n_tasks} |" in text
        assert f"| `{name}` | `{suite.digest}` |" in text
