"""The files of the published benchmark (arXiv 2503.01378) as they are on disk: what each holds, told by its name.

CHECKOUT/Validation/Celebrities_valid.json, letters_validation.json, ...    the benchmark: eight files, 218 tasks
CHECKOUT/Validation/math_prompt.json                                        training tasks
CHECKOUT/Validation/**/<Type>/<time stamp>/setup.json                       one task, beside its recorded flight
CHECKOUT/model_for_data_collection/<Category>/<Type>.json                   training tasks
CHECKOUT/model_for_data_collection/<Category>/<Type>/*.dae                  panels, each with its picture
CHECKOUT/eval_after_reasoning/after_reasoning/<Type>_updated.json           the tasks with a reasoner's answers
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path, PurePath

from cognitivedrone.errors import TaskError
from cognitivedrone.files import own_files
from cognitivedrone.types import ALL_CATEGORIES, CATEGORIES, Category

SETUP_FILE = "setup.json"
"""The task of a recorded flight."""
ARCHIVES = (".zip", ".tar", ".gz", ".tgz", ".7z", ".rar")


@dataclass(frozen=True, slots=True)
class PublishedType:
    """What the tasks of a published file are."""

    folder: str
    """Of their panels, in the label folder: the kind of their label references."""
    category: Category
    family: str


TYPES: dict[str, PublishedType] = {
    "celebritie": PublishedType("Celebrities", "human_recognition", "people"),
    "pattern": PublishedType("Patterns", "human_recognition", "attributes"),
    "animal": PublishedType("Animals", "symbol_understanding", "animals"),
    "digit": PublishedType("Digits", "symbol_understanding", "digits"),
    "letter": PublishedType("Letters", "symbol_understanding", "letters"),
    "logo": PublishedType("Logos", "symbol_understanding", "logos"),
    "food": PublishedType("Food", "reasoning", "food"),
    "mathdesk": PublishedType("Math_desk", "reasoning", "math_board"),
    "mathprompt": PublishedType("Digits", "reasoning", "math"),
}
"""By the words of a file's or folder's name, without those in `_ASIDE` and the plural's s."""
_ASIDE = frozenset({"valid", "validation", "updated"})


def _words(name: str) -> list[str]:
    return re.findall("[a-z]+", name.lower())


def published_type(name: str) -> PublishedType | None:
    """The type that a file's stem or a folder's name stands for: `Letters`, `validation_digit`, `Food_updated`."""
    return TYPES.get("".join(word for word in _words(name) if word not in _ASIDE).removesuffix("s"))


def is_published_test(name: str) -> bool:
    """Whether a file's stem is that of published validation tasks, the benchmark of the paper."""
    words = _words(name)
    return published_type(name) is not None and not _ASIDE.isdisjoint(words) and "updated" not in words


def category_of_folder(name: str) -> Category | None:
    """The paper's category that a folder's name stands for, such as `Human Recognition`."""
    plain = "_".join(_words(name))
    return next((category for category in CATEGORIES if category == plain), None)


def type_of(path: PurePath) -> tuple[str, PublishedType | None]:
    """The name of a task file's type, and the type where it is known.

    A recorded flight's is the nearest folder above it with such a name; a type that is not published has the category
    of its folder.
    """
    if path.name == SETUP_FILE:
        names = [parent.name for parent in path.parents if published_type(parent.name)]
        name = names[0] if names else path.parent.parent.name
    else:
        name = path.stem
    known = published_type(name)
    if known is None and (category := category_of_folder(path.parent.name)) in ALL_CATEGORIES:
        known = PublishedType(name, category, name.lower())
    return name, known


def task_files(path: Path, *, training: bool = False) -> list[Path]:
    """The files that hold the tasks of a file or folder, sorted.

    Of a folder these are its `*.json`; or those below it that have a published name or lie beside or in a folder of
    their name; or the `setup.json` of recorded flights. Where published validation tasks are among them, the other
    published files, which are for training or repeat them, are not taken; for `training`, the others are, and never
    those, and none are no error. Raises `TaskError` where there is none.
    """
    if path.suffix.lower() in ARCHIVES and path.is_file():
        raise TaskError(f"{path} is an archive; unpack it and give the folder")
    if not path.is_dir():
        if training and is_published_test(path.stem):
            raise TaskError(f"{path}: these are the paper's validation tasks, no training tasks; give others")
        return [path]
    files = [file for file in own_files(path, "*.json") if file.name != SETUP_FILE]
    if training or not files:
        files += [file for file in own_files(path, "**/*.json") if _holds_tasks(file) and file not in files]
    tests = [file for file in files if is_published_test(file.stem)]
    if training:
        files = [file for file in files if file not in tests and "updated" not in _words(file.stem)]
    elif tests:
        files = [file for file in files if file in tests or published_type(file.stem) is None]
    elif originals := [file for file in files if "updated" not in _words(file.stem)]:
        files = originals
    files = files or ([] if training else own_files(path, f"**/{SETUP_FILE}"))
    if not files and not training:
        raise TaskError(f"{path}: holds no task file; put *.json task files there")
    return files


def _holds_tasks(file: Path) -> bool:
    if file.name == SETUP_FILE:
        return False
    return published_type(file.stem) is not None or file.stem == file.parent.name or file.with_suffix("").is_dir()
