"""Task files: the published JSON layout, read and written exactly, with additional keys of our own.

Published keys are `prompt`, `prompt_simpler`, `options`, `correct` (1 to 3), `gates` (a dict keyed "1" to "3", or a
list of `{"gate": "1", ...}`), `background`, and for sums on the board `task: {d1, operator, d2}`. Our optional keys
are `id`, `category`, `family`, `labels`, `board`, for a gate that stands alone its number `only`, for one that does not
stand its number `missing`, `layout` with the gate layout, keyed "1" to "3" as well, `landing` (true) for pads on the
floor instead of gates, `mission`, the sentence of a whole track, `obstacles`, a list of what is in the way, and
`landmark`, a panel without a gate. In the family `absent`, `correct` is null.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, cast, get_args

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.files import read_regular, reason_of, replace_file
from cognitivedrone.files.texts import decoded, load_json
from cognitivedrone.tasks.families import FAMILIES
from cognitivedrone.tasks.published import SETUP_FILE, PublishedType, published_type, type_of
from cognitivedrone.tasks.validate import check_text, validate_task
from cognitivedrone.text.printable import unprintable
from cognitivedrone.types import (
    ALL_CATEGORIES,
    Category,
    Gate,
    GatePlace,
    Landmark,
    Layout,
    Obstacle,
    ObstacleKind,
    Task,
)

MAX_FILE_BYTES = 64 * 2**20
MAX_TASKS = 200_000

_SUM = re.compile(r"([0-9]+)([-+*])([0-9]+)")
_BOARD = re.compile(rf"sum/{_SUM.pattern}@")
_SUM_IN_PROMPT = re.compile(r"\d\s*[-+*]\s*\d")
_KEYS = ("prompt", "prompt_simpler", "options", "correct", "gates", "background")
_OPTIONAL = (
    "task", "id", "category", "family", "labels", "board", "only", "layout", "landing", "mission", "obstacles",
    "landmark", "missing",
)  # fmt: skip
_PLACE = ("x", "y", "height", "yaw")
MAX_OBSTACLES = 20
_MEASURES: dict[str, dict[str, float | None]] = {
    "pillar": {},
    "wall": {"depth": 0.1, "yaw": 0.0},
    "beam": {"above": None, "depth": 0.1, "yaw": 0.0},
    "frame": {"above": None, "depth": 0.1, "yaw": 0.0},
    "person": {},
}
"""What an obstacle of each kind has besides x, y, width and height, with its default; none for what must be given."""
_MOVES: dict[str, float | None] = {"yaw": 0.0, "sway": 0.0, "period": 8.0, "phase": 0.0}
"""What one may have that moves."""
_SWAYS = ("sway", "period", "phase")
"""What the place of a gate has, too, if it moves."""
_MISSPELT = 0.82
"""A key that is so similar to a known one (difflib, 0 to 1) is a misspelling: `lables` is, `idx` is not."""
_PLAIN = {re.sub("[^a-z]", "", key): key for key in (*_KEYS, *_OPTIONAL)}


def task_to_json(task: Task) -> dict[str, Any]:
    """A task in the published layout with our keys; `task_from_json` is the inverse."""
    obj: dict[str, Any] = {
        "prompt": task.instruction,
        "prompt_simpler": task.directive,
        "options": list(task.options),
        "correct": None if task.target is None else task.target + 1,
        "gates": {
            str(number): {"size": gate.size, "shape": gate.shape, "color": gate.color}
            for number, gate in enumerate(task.gates, 1)
        },
        "background": task.background,
    }
    simple_sum = _BOARD.match(task.board or "")
    if simple_sum:
        obj["task"] = dict(zip(("d1", "operator", "d2"), simple_sum.groups(), strict=True))
    obj |= {"id": task.id, "category": task.category, "family": task.family, "labels": list(task.labels)}
    if task.board is not None:
        obj["board"] = task.board
    if task.only is not None:
        obj["only"] = task.only + 1
    if task.missing is not None:
        obj["missing"] = task.missing + 1
    if task.layout is not None:
        obj["layout"] = {
            str(number): {key: getattr(place, key) for key in (*_PLACE, *(_SWAYS if place.sway else ()))}
            for number, place in enumerate(task.layout, 1)
        }
    if task.landing:
        obj["landing"] = True
    if task.mission is not None:
        obj["mission"] = task.mission
    if task.obstacles:
        keys = {kind: ("kind", "x", "y", "width", "height", *more) for kind, more in _MEASURES.items()}
        obj["obstacles"] = [
            {key: getattr(each, key) for key in (*keys[each.kind], *(_MOVES if each.sway else ()))}
            for each in task.obstacles
        ]
    if task.landmark is not None:
        obj["landmark"] = asdict(task.landmark)
    return obj


def task_from_json(
    obj: object, *, where: str, kind: str | PublishedType | None = None, default_id: str | None = None
) -> Task:
    """The task that a JSON object describes, validated.

    `where` names the place in error messages. `kind` is the published type, or the file's stem, which names it: it
    names the label folder and supplies category and family if the object does not. Raises `TaskError` for anything
    malformed.
    """
    if not isinstance(obj, dict):
        raise TaskError(f"{where}: a task must be a JSON object, not {type(obj).__name__}")
    _check_keys(obj, where)
    for key in _KEYS:
        if key not in obj:
            raise TaskError(f"{where}: key {key!r} is missing; a task has {', '.join(_KEYS)}")
    correct = obj["correct"]
    if correct is not None and (type(correct) is not int or not 1 <= correct <= 3):
        raise TaskError(f"{where}: correct is {repr(correct)[:40]}; it must be 1, 2 or 3, the number of the right gate")
    options = _three(obj["options"], "options", where)
    known = published_type(kind) if isinstance(kind, str) else kind
    stem = kind if isinstance(kind, str) else None
    category, family = _category_and_family(obj, known, stem, where)
    labels = obj.get("labels")
    if labels is None:
        folder = known.folder if known else stem
        if folder is None:
            raise TaskError(f"{where}: key 'labels' is missing; add three label references such as 'animal/cat@noto'")
        labels = [f"{folder}/{option.removesuffix('.dae')}" for option in options]
    task = Task(
        id=obj.get("id", default_id or where),
        category=category,
        family=family,
        instruction=obj["prompt"],
        directive=obj["prompt_simpler"],
        options=options,
        labels=_three(labels, "labels", where),
        target=None if correct is None else correct - 1,
        gates=_gates(obj["gates"], where),
        board=_board(obj, where),
        background=obj["background"],
        only=_number(obj, "only", "the gate that stands alone", where),
        missing=_number(obj, "missing", "a gate that does not stand", where),
        layout=_layout(obj, where),
        landing=_landing(obj, where),
        mission=obj.get("mission"),
        obstacles=_obstacles(obj.get("obstacles", []), where),
        landmark=_landmark(obj.get("landmark"), where),
    )
    validate_task(task, where)
    return task


def _check_keys(obj: Mapping[str, Any], where: str) -> None:
    """Raise `TaskError` for a key that looks like a misspelling of a known one; other unknown keys are ignored."""
    for key in obj:
        if key not in _PLAIN.values() and (known := _meant_by(key)) is not None:
            raise TaskError(f"{where} has the unknown key {key[:40]!r}; did you mean {known!r}?")
        if problem := unprintable(key):
            raise TaskError(f"{where}: the key {key[:40]!r} contains {problem}; remove it")


def _meant_by(key: str) -> str | None:
    """The known key that an unknown one resembles; a name of more words, such as `prompt_id`, is another."""
    plain = re.sub("[^a-z]", "", key[:40].casefold())
    if plain in _PLAIN:
        return _PLAIN[plain]
    near = difflib.get_close_matches(plain, _PLAIN, n=1, cutoff=_MISSPELT)
    known = _PLAIN[near[0]] if near else None
    return None if known is None or len(re.split(r"[\s_-]", key)) > len(known.split("_")) else known


def _three(value: object, what: str, where: str) -> tuple[str, str, str]:
    if not isinstance(value, list) or len(value) != 3:
        size = f"{len(value)} entries" if isinstance(value, list) else type(value).__name__
        raise TaskError(f"{where}: {what} must be a list of 3 names, one a gate, not {size}")
    for name in value:
        check_text(name, f"an entry of {what}", where)
    return value[0], value[1], value[2]


def _gates(value: object, where: str) -> tuple[Gate, Gate, Gate]:
    """Gates in either published form: a dict by gate number, or a list whose entries carry the number."""
    if isinstance(value, list):
        entries = {str(entry.get("gate")): entry for entry in value if isinstance(entry, dict)}
        complete = len(value) == 3
    else:
        entries = value if isinstance(value, dict) else {}
        complete = len(entries) == 3
    if not complete or set(entries) != {"1", "2", "3"}:
        raise TaskError(f"{where}: gates must describe gate 1, 2 and 3, each once")
    gates = []
    for number in "123":
        entry = entries[number]
        for key in ("size", "shape", "color"):
            if not isinstance(entry, dict) or not isinstance(entry.get(key), str):
                raise TaskError(f"{where}: gate {number} needs {key!r}, a word such as 'small', 'round' or 'red'")
        gates.append(Gate(entry["size"], entry["shape"], entry["color"]))
    return gates[0], gates[1], gates[2]


def _number(obj: Mapping[str, Any], key: str, what: str, where: str) -> int | None:
    """The index of a gate whose number a task may have."""
    number = obj.get(key)
    if number is None:
        return None
    if type(number) is not int or not 1 <= number <= 3:
        raise TaskError(f"{where}: {key} is {repr(number)[:40]}; it must be 1, 2 or 3, the number of {what}")
    return number - 1


def _landing(obj: Mapping[str, Any], where: str) -> bool:
    landing = obj.get("landing", False)
    if type(landing) is not bool:
        raise TaskError(f"{where}: landing is {repr(landing)[:40]}; make it true, or leave it out")
    return landing


def _layout(obj: Mapping[str, Any], where: str) -> Layout | None:
    entries = obj.get("layout")
    if entries is None:
        return None
    if not isinstance(entries, dict) or set(entries) != {"1", "2", "3"}:
        raise TaskError(f"{where}: layout must describe the places of gate 1, 2 and 3, each once")
    places = []
    for number in "123":
        entry = entries[number]
        names = (*_PLACE, *_SWAYS) if isinstance(entry, dict) and "sway" in entry else _PLACE
        known = isinstance(entry, dict) and set(_PLACE) <= set(entry) <= {*names}
        if not known or not all(map(_is_number, entry.values())):
            raise TaskError(
                f"{where}: the place of gate {number} must be {', '.join(_PLACE)} and, if it moves, "
                f"{', '.join(_SWAYS)}: numbers in m, rad and s"
            )
        places.append(GatePlace(**{name: _as_float(value) for name, value in entry.items()}))
    return places[0], places[1], places[2]


def _obstacles(entries: object, where: str) -> tuple[Obstacle, ...]:
    if not isinstance(entries, list):
        raise TaskError(f"{where}: obstacles must be a list of objects, not {type(entries).__name__}")
    if len(entries) > MAX_OBSTACLES:
        raise TaskError(f"{where}: {len(entries)} obstacles are too many; leave {MAX_OBSTACLES} at most")
    return tuple(_obstacle(entry, f"{where}: obstacle {number}") for number, entry in enumerate(entries, 1))


def _obstacle(entry: object, which: str) -> Obstacle:
    kind = entry.get("kind") if isinstance(entry, dict) else None
    if not isinstance(entry, dict) or not isinstance(kind, str) or kind not in _MEASURES:
        shown = repr(kind if isinstance(entry, dict) else entry)[:40]
        raise TaskError(f"{which} has the unknown kind {shown}; {did_you_mean(str(kind)[:40], get_args(ObstacleKind))}")
    more = _MEASURES[kind] | (_MOVES if "sway" in entry else {})
    values = _measures(entry, ("x", "y", "width", "height"), more, f"{which}, a {kind},", {"kind"})
    return Obstacle(cast(ObstacleKind, kind), **values)


def _landmark(entry: object, where: str) -> Landmark | None:
    if entry is None:
        return None
    if not isinstance(entry, dict):
        raise TaskError(f"{where}: landmark must be an object, not {type(entry).__name__}")
    names = tuple(each.name for each in fields(Landmark) if each.name != "label")
    label = entry.get("label")
    check_text(label, "the label of the landmark", where)
    return Landmark(cast(str, label), **_measures(entry, names, {}, f"{where}: the landmark", {"label"}))


def _measures(
    entry: Mapping[str, Any], required: Iterable[str], more: Mapping[str, float | None], which: str, other: set[str]
) -> dict[str, float]:
    """The numbers of an object: those `required` and `more`, of which those with a default may be missing."""
    known = {**dict.fromkeys(required), **more}
    for key in entry:
        if key not in known and key not in other:
            raise TaskError(f"{which} has the unknown key {key[:40]!r}; it has {', '.join(known)}")
    values = {}
    for key, default in known.items():
        value = entry.get(key, default)
        if not _is_number(value):
            raise TaskError(f"{which} has {key} {repr(value)[:40]}; give it a number, in m, rad or s")
        values[key] = _as_float(value)
    return values


def _is_number(value: object) -> bool:
    return type(value) in (int, float)


def _as_float(number: int | float) -> float:
    """A number of a file; whole numbers beyond every float become infinite, which no place is."""
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def _board(obj: Mapping[str, Any], where: str) -> str | None:
    board: object = obj.get("board")
    if board is not None:
        check_text(board, "board", where)
    operation = obj.get("task")
    if operation is None:
        return cast("str | None", board)
    if not isinstance(operation, dict) or not all(key in operation for key in ("d1", "operator", "d2")):
        raise TaskError(f"{where}: task must have d1, operator and d2, the sum on the board")
    sum_ = f"{operation['d1']}{operation['operator']}{operation['d2']}"
    if not _SUM.fullmatch(sum_):
        raise TaskError(f"{where}: the sum on the board reads {sum_[:40]!r}; use two numbers and +, - or *")
    if board is None:
        return f"sum/{sum_}@inter"
    if not cast(str, board).startswith(f"sum/{sum_}@"):
        raise TaskError(f"{where}: task asks {sum_[:40]}, but board shows {board!r}; correct one of them")
    return cast(str, board)


def _category_and_family(
    obj: Mapping[str, Any], known: PublishedType | None, stem: str | None, where: str
) -> tuple[Category, str]:
    category, family = (known.category, known.family) if known else (None, None)
    if family is None and obj.get("task") is not None:
        category, family = "reasoning", "math_board"
    if family is None and isinstance(obj["prompt"], str) and _SUM_IN_PROMPT.search(obj["prompt"]):
        category, family = "reasoning", "math"
    family = obj.get("family", family or (stem or "").lower() or None)
    category = obj.get("category", category or (FAMILIES.get(family) if isinstance(family, str) else None))
    if category is None:
        raise TaskError(f'{where}: no category; add "category", one of {", ".join(ALL_CATEGORIES)}')
    return cast(Category, category), cast(str, family)


def read_json(path: Path, max_bytes: int = MAX_FILE_BYTES) -> object:
    """The content of a JSON file, in any encoding that `texts.decoded` reads, and with comments.

    Raises `TaskError` if it is unreadable, not a regular file, too large, not JSON, or repeats a key.
    """
    try:
        content = read_regular(path, max_bytes)
        return load_json(decoded(content), non_finite=True)  # the errors of a task name its field
    except OSError as error:
        raise TaskError(f"{path}: cannot be read ({reason_of(error)}); give a task file or a folder of them") from None
    except ValueError as error:
        raise TaskError(f"{path}: not JSON ({str(error)[:240]}); a task file is a list of tasks") from None


def read_tasks(path: Path) -> list[Task]:
    """The tasks of a file, in order: a list of them, or a single one. Its name, or for a recorded flight's task that of
    a folder above it, is the published type. Raises `TaskError` with file and index.
    """
    content = read_json(path)
    name, known = type_of(path if path.parent.name else path.absolute())
    if isinstance(content, dict) and (content.keys() & {"prompt"} or path.name == SETUP_FILE):
        single = f"{name}/{path.parent.name}" if path.name == SETUP_FILE else f"{name}/0000"
        return [task_from_json(content, where=str(path), kind=known or name, default_id=single)]
    if not isinstance(content, list):
        raise TaskError(f"{path}: a task file is a JSON list of tasks, not {type(content).__name__}")
    if not content:
        raise TaskError(f"{path}: holds no task")
    if len(content) > MAX_TASKS:
        raise TaskError(f"{path}: {len(content)} tasks are too many for one file; split it at {MAX_TASKS}")
    if problem := unprintable(path.name):
        raise TaskError(f"{path}: the file's name holds {problem}; give it another name")
    return [
        task_from_json(obj, where=f"{path}[{index}]", kind=known or name, default_id=f"{name}/{index:04d}")
        for index, obj in enumerate(content)
    ]


def write_tasks(path: Path, tasks: Iterable[Task]) -> None:
    """Write a task file in the published layout, one task per line."""
    lines = ",\n".join(json.dumps(task_to_json(task), ensure_ascii=False) for task in tasks)
    replace_file(path, f"[\n{lines}\n]\n".encode())
