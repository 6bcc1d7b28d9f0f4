"""Imports tasks and panels of the published collector, which uses Gazebo classic, as a task file and a label pack.

    DIR/Reasoning/Animals.json          tasks; their options are panels of the folder of the same name
    DIR/Reasoning/Animals/fox.dae       a panel: a COLLADA model that names the picture on it
    DIR/Reasoning/Animals/fox.jpeg

becomes

    OUT/tasks.json                      all tasks, their labels named
    OUT/labels/Animals/fox.jpeg         the pictures, named as in the tasks: a folder pack

Layout: `doc/1_data_sctructure.md` of the collector of arXiv 2503.01378. A model's content takes precedence over its
file name: some models show a picture with another name, and some misspell the name of their picture slightly.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from cognitivedrone.errors import GazeboError, did_you_mean
from cognitivedrone.files import own_files, read_regular, reason_of, replace_file, safe_name
from cognitivedrone.files.texts import folded
from cognitivedrone.labels.images import SUFFIXES, read_image
from cognitivedrone.pictures import MAX_FILE_BYTES
from cognitivedrone.tasks.format import PUBLISHED_TYPES, read_json, task_from_json, write_tasks
from cognitivedrone.types import CATEGORIES, Task

TASKS_FILE, LABELS_FOLDER = "tasks.json", "labels"
MODEL = ".dae"
MAX_MODEL_BYTES = 20_000_000
_COLLADA = "{http://www.collada.org/2005/11/COLLADASchema}"


@dataclass(frozen=True, slots=True)
class Imported:
    """The files written."""

    tasks: Path
    labels: Path
    counts: dict[str, tuple[int, int]]
    """Tasks and pictures, by type."""


def import_collector(source: Path, out: Path) -> Imported:
    """Read every type in a folder of the collector, and write tasks and labels into `out`, new or empty.

    On any error nothing is written. Raises `TaskError` with file and index, `LabelError` for a picture that cannot be
    read, `GazeboError` for anything else.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise GazeboError(f"{out} is not an empty folder; give --out a new one, nothing is overwritten")
    tasks: list[Task] = []
    pictures: dict[PurePosixPath, Path] = {}
    counts: dict[str, tuple[int, int]] = {}
    try:
        for file in _task_files(source):
            own = list(_tasks_of(file))
            shown = _pictures_of(file, own)
            counts[file.stem] = len(own), len(shown)
            tasks += own
            pictures |= shown
    except OSError as error:
        raise GazeboError(f"cannot read {error.filename or source}: {reason_of(error)}") from None
    labels = out / LABELS_FOLDER
    try:
        for name, picture in pictures.items():
            (labels / name).parent.mkdir(parents=True, exist_ok=True)
            replace_file(labels / name, read_regular(picture, MAX_FILE_BYTES))
        write_tasks(out / TASKS_FILE, tasks)
    except OSError as error:
        raise GazeboError(f"cannot write {error.filename or out}: {error.strerror or error}") from None
    return Imported(out / TASKS_FILE, labels, counts)


def picture_of(model: Path) -> str:
    """The path of the picture that a COLLADA panel shows, as written there, relative to its folder.

    Raises `GazeboError` if it is not COLLADA, or shows no picture.
    """
    try:
        root = ET.fromstring(read_regular(model, MAX_MODEL_BYTES))  # noqa: S314 - expat bounds what entities expand to
    except OSError as error:
        raise GazeboError(f"{model}: cannot be read as a COLLADA model ({reason_of(error)})") from None
    except ET.ParseError as error:
        raise GazeboError(f"{model}: cannot be read as a COLLADA model ({error})") from None
    named = {image.get("id"): image.findtext(f"{_COLLADA}init_from") for image in root.iter(f"{_COLLADA}image")}
    used = [surface.findtext(f"{_COLLADA}init_from") for surface in root.iter(f"{_COLLADA}surface")]
    found = [named[key] for key in used if key in named] + list(named.values())
    picture = next((text.strip() for text in found if text and text.strip()), None)
    if picture is None:
        raise GazeboError(f"{model}: shows no picture; expected a texture in its library_images")
    return unquote(picture.removeprefix("file://"))


def _task_files(source: Path) -> list[Path]:
    """The task files beside a folder of models of the same name."""
    if not source.is_dir():
        raise GazeboError(f"{source} is not a folder; give that of the collector, or its model_for_data_collection")
    files = [file for file in own_files(source, "**/*.json") if any(file.with_suffix("").rglob(f"*{MODEL}"))]
    if not files:
        raise GazeboError(
            f"{source} holds no task file beside a folder of panels; expected such as"
            f" Reasoning/Animals.json and Reasoning/Animals/fox{MODEL}"
        )
    by_type: dict[str, Path] = {}
    for file in files:
        if safe_name(file.stem) != file.stem:
            raise GazeboError(f"{file}: a type has the name of its file, and no folder can have this name; rename it")
        if (other := by_type.setdefault(folded(file.stem), file)) != file:
            raise GazeboError(f"{other} and {file} have the same type; labels go by type, so rename one of them")
    return files


def _tasks_of(file: Path) -> Iterator[Task]:
    """The tasks of a type; an unpublished type belongs to the category named by its folder."""
    content = read_json(file)
    if not isinstance(content, list) or not content:
        raise GazeboError(f"{file}: holds no tasks; a task file is a JSON list of them")
    kind, category = file.stem, file.parent.name.lower().replace(" ", "_")
    ours = {"category": category} if kind not in PUBLISHED_TYPES and category in CATEGORIES else {}
    for index, obj in enumerate(content):
        table = {**ours, **obj} if isinstance(obj, dict) else obj
        yield task_from_json(table, where=f"{file}[{index}]", kind=kind, default_id=f"{kind}/{index:04d}")


def _pictures_of(file: Path, tasks: Iterable[Task]) -> dict[PurePosixPath, Path]:
    """For every option of a type: the path of its picture in the pack, and its current path."""
    folder = file.with_suffix("")
    found: dict[PurePosixPath, Path] = {}
    seen: set[str] = set()
    for index, task in enumerate(tasks):
        for option in set(task.options) - seen:
            seen.add(option)
            picture = _picture(folder, option, f"{file}[{index}]")
            read_image(picture)
            name = PurePosixPath(folder.name, option.removesuffix(MODEL))
            found[name.with_name(name.name + picture.suffix.lower())] = picture
    return found


def _picture(folder: Path, option: str, where: str) -> Path:
    """The picture of an option; slightly misspelled names are tolerated."""
    path = PurePosixPath(option)
    if path.is_absolute() or ".." in path.parts or not path.name:
        raise GazeboError(f"{where}: option {option!r} leads out of {folder}; name a panel in it")
    stem = path.name.removesuffix(MODEL)
    there = folder / path.parent
    beside = own_files(there, "*") if there.is_dir() else []
    models = {folded(file.stem): file for file in beside if file.suffix.lower() == MODEL}
    model = models.get(folded(stem)) or models.get(folded(f"{stem}{MODEL[1:]}"))
    named = "" if model is None else picture_of(model)
    exact = (there / named).resolve()
    if exact.is_file() and exact.suffix.lower() in SUFFIXES and exact.is_relative_to(folder.parent.resolve()):
        return exact
    pictures = [file for file in beside if file.suffix.lower() in SUFFIXES and file.resolve().parent == there.resolve()]
    for wanted in (folded(Path(named).name), folded(Path(named).stem), folded(stem)):
        for file in pictures:
            if wanted in (folded(file.name), folded(file.stem)):
                return file
    if model is None:
        raise GazeboError(
            f"{where}: there is no panel {path.with_suffix(MODEL)} in {folder}; {did_you_mean(stem, models)}"
        )
    raise GazeboError(
        f"{where}: {model} shows {named!r}, which is not beside it as {', '.join(SUFFIXES)}; put the picture there"
    )
