"""The published files of tasks, by name: which they are, which are flown, and what is refused."""

import json
import shutil
import zipfile

import pytest
from published_checkout import VALIDATION, make_checkout, tasks_of

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import read_tasks, suite_from_files
from cognitivedrone.tasks.published import is_published_test, published_type, task_files

NAMES = {
    "Celebrities_valid": ("human_recognition", "people", "Celebrities"),
    "Patterns_valid": ("human_recognition", "attributes", "Patterns"),
    "letters_validation": ("symbol_understanding", "letters", "Letters"),
    "validation_digit": ("symbol_understanding", "digits", "Digits"),
    "validation_animal": ("symbol_understanding", "animals", "Animals"),
    "validation_logo": ("symbol_understanding", "logos", "Logos"),
    "validation_food": ("reasoning", "food", "Food"),
    "Math_prompt_valid": ("reasoning", "math", "Digits"),
}


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    return make_checkout(tmp_path_factory.mktemp("published"))


def test_every_validation_file_has_its_category_family_and_panels(checkout):
    for name, facts in NAMES.items():
        for task in read_tasks(checkout / "Validation" / f"{name}.json"):
            assert (task.category, task.family, task.labels[0].partition("/")[0]) == facts
        assert is_published_test(name)
        assert is_published_test(name.upper())


@pytest.mark.parametrize("name", ["Celebrities", "math_prompt", "Math_desk", "Food_updated", "letters"])
def test_training_files_and_answers_are_no_test(name):
    assert published_type(name)
    assert not is_published_test(name)


def test_names_of_ones_own_are_not_published():
    assert not any(published_type(name) for name in ("valid", "birds", "my_tasks", "digital_letters"))


def test_folder_and_checkout_give_the_validation_tasks_alone(checkout):
    for folder in (checkout / "Validation", checkout):
        suite = suite_from_files(folder)
        assert suite.n_tasks == 3 * len(VALIDATION)
        assert {track[0].id.partition("/")[0] for track in suite.tracks} == set(VALIDATION)


def test_for_training_the_others_are_taken_and_never_those_for_validation(checkout):
    taken = {file.stem for file in task_files(checkout, training=True)}
    assert taken == {"Celebrities", "Patterns", "Letters", "Digits", "Animals", "Logos", "Food", "math_prompt"}
    with pytest.raises(TaskError, match="the paper's validation tasks"):
        task_files(checkout / "Validation" / "validation_digit.json", training=True)


def test_answers_given_alone_are_tasks(checkout):
    assert suite_from_files(checkout / "eval_after_reasoning").n_tasks == 3 * 7 + 3


def test_one_task_one_file_and_a_recorded_flights_task(tmp_path):
    task = tasks_of("validation_digit")[0]
    (tmp_path / "validation_digit.json").write_text(json.dumps(task))
    assert suite_from_files(tmp_path / "validation_digit.json").tracks[0][0].family == "digits"
    setup = tmp_path / "Validation_reasoning" / "validation_digit" / "2025-02-28 12:12:28.747449" / "setup.json"
    setup.parent.mkdir(parents=True)
    setup.write_text(json.dumps(task))
    for path in (setup, setup.parent, setup.parents[1], setup.parents[2]):
        ((one,),) = suite_from_files(path).tracks
        assert (one.family, one.id) == ("digits", "validation_digit/2025-02-28 12:12:28.747449")


def test_a_type_of_ones_own_has_the_category_of_its_folder(tmp_path):
    folder = tmp_path / "Symbol Understanding"
    (folder / "Shapes").mkdir(parents=True)
    (folder / "Shapes.json").write_text(json.dumps(tasks_of("validation_digit")))
    assert {track[0].category for track in suite_from_files(tmp_path).tracks} == {"symbol_understanding"}


def test_two_files_of_the_same_tasks_and_an_archive_are_refused(checkout, tmp_path):
    twice = tmp_path / "twice"
    shutil.copytree(checkout / "Validation", twice)
    shutil.copy(twice / "letters_validation.json", twice / "letters_valid.json")
    with pytest.raises(TaskError, match=r"letters_valid\.json and .*letters_validation\.json hold the same tasks"):
        suite_from_files(twice)
    with zipfile.ZipFile(tmp_path / "Validation.zip", "w") as archive:
        archive.writestr("x.json", "[]")
    with pytest.raises(TaskError, match=r"Validation\.zip is an archive; unpack it"):
        suite_from_files(tmp_path / "Validation.zip")
