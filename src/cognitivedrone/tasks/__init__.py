"""Tasks: families, vocabulary, facts, suites and task files. Pure data, no pixels."""

from cognitivedrone.tasks.directives import parse_directive, write_directive
from cognitivedrone.tasks.families import BASE_FAMILIES, FAMILIES, HARD_FAMILIES, TASKS
from cognitivedrone.tasks.families.racing import race_task
from cognitivedrone.tasks.format import read_tasks, task_from_json, task_to_json, write_tasks
from cognitivedrone.tasks.suites import (
    ABOUT,
    SUITES,
    TEST_ONLY,
    TRAIN_NAME,
    UNLIMITED,
    Suite,
    load_suite,
    open_suite,
    suite_from_files,
    track_at,
    train_task,
)
from cognitivedrone.tasks.validate import validate_task

__all__ = [
    "ABOUT",
    "BASE_FAMILIES",
    "FAMILIES",
    "HARD_FAMILIES",
    "SUITES",
    "TASKS",
    "TEST_ONLY",
    "TRAIN_NAME",
    "UNLIMITED",
    "Suite",
    "load_suite",
    "open_suite",
    "parse_directive",
    "race_task",
    "read_tasks",
    "suite_from_files",
    "task_from_json",
    "task_to_json",
    "track_at",
    "train_task",
    "validate_task",
    "write_directive",
    "write_tasks",
]
