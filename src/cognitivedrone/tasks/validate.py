"""Validation of tasks. Every error is one sentence that names the place and the fix."""

from __future__ import annotations

import math

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.layout import LOWEST_M, START
from cognitivedrone.printable import unprintable
from cognitivedrone.tasks.directives import HOLD, declines, parse_directive
from cognitivedrone.types import ALL_CATEGORIES, COLORS, SHAPES, SIZES, Gate, Layout, Task

MAX_TEXT = 1000
"""Longest instruction, directive or name, in characters."""


def right_gate(task: Task) -> int:
    """Index of the right gate, 0 to 2; raises `TaskError` for a task without one."""
    if task.target is None:
        raise TaskError(f"{task.id}: no gate matches the instruction; take other tasks")
    return task.target


def check_word(value: object, known: tuple[str, ...], what: str, where: str) -> None:
    """Raise `TaskError` unless `value` is one of `known`."""
    if not isinstance(value, str) or value not in known:
        raise TaskError(f"{where}: unknown {what} {str(value)[:40]!r}; {did_you_mean(str(value)[:40], known)}")


def check_text(value: object, what: str, where: str) -> None:
    """Raise `TaskError` unless `value` is a printable sentence or name of reasonable length."""
    if not isinstance(value, str):
        raise TaskError(f"{where}: {what} must be a string, not {type(value).__name__}")
    if not value.strip():
        raise TaskError(f"{where}: {what} is empty; write it down")
    if len(value) > MAX_TEXT:
        raise TaskError(f"{where}: {what} has {len(value)} characters; shorten it to {MAX_TEXT} at most")
    if problem := unprintable(value):
        raise TaskError(f"{where}: {what} contains {problem}; remove it")


def check_gates(gates: tuple[Gate, Gate, Gate], where: str) -> None:
    """Raise `TaskError` unless the gates have known attributes and three different colours."""
    for number, gate in enumerate(gates, 1):
        check_word(gate.size, SIZES, f"size of gate {number}", where)
        check_word(gate.shape, SHAPES, f"shape of gate {number}", where)
        check_word(gate.color, COLORS, f"color of gate {number}", where)
    for first, second in ((0, 1), (0, 2), (1, 2)):
        if gates[first].color == gates[second].color:
            raise TaskError(
                f"{where}: gates {first + 1} and {second + 1} are both {gates[first].color}; "
                "give the three gates three different colors"
            )


def check_layout(layout: Layout, gates: tuple[Gate, Gate, Gate], where: str) -> None:
    """Raise `TaskError` unless the gates are inside the stage, above its floor, and left to right from the start."""
    for number, (place, gate) in enumerate(zip(layout, gates, strict=True), 1):
        lowest = LOWEST_M[gate.size]
        for name, value, low, high in (
            ("x", place.x, 1.0, 8.0),
            ("y", place.y, -7.0, 7.0),
            ("height", place.height, lowest, 3.0),
            ("yaw", place.yaw, -math.pi / 2, math.pi / 2),
        ):
            if not low <= value <= high:
                raise TaskError(
                    f"{where}: {name} of gate {number} is {value:g}; it must be from {low:g} to {high:.3g}"
                    + (f" for a {gate.size} gate" if name == "height" else "")
                )
    bearings = [math.atan2(place.y - START[1], place.x - START[0]) for place in layout]
    if not bearings[0] > bearings[1] > bearings[2]:
        raise TaskError(f"{where}: the gates of the layout must be numbered from left to right, as seen from the start")


def _check_absent(task: Task, where: str) -> None:
    if task.family != "absent":
        raise TaskError(
            f"{where}: correct is null, so no gate is right; that is for the family 'absent', "
            f"not {task.family!r}: give 1, 2 or 3"
        )
    if not declines(task.directive):
        raise TaskError(f"{where}: prompt_simpler is {task.directive[:40]!r}; in the family 'absent' it is {HOLD!r}")


def _shown(target: int | None) -> str:
    return "none" if target is None else str(target + 1)


def validate_task(task: Task, where: str) -> None:
    """Raise `TaskError` at the first fault of a task; `where` names it, for example "Animals.json[12]"."""
    for what, text in (("id", task.id), ("prompt", task.instruction), ("prompt_simpler", task.directive)):
        check_text(text, what, where)
    for what, text in (("family", task.family), ("background", task.background)):
        check_text(text, what, where)
    check_word(task.category, ALL_CATEGORIES, "category", where)
    if (task.family == "absent") != (task.category == "absent"):
        raise TaskError(f"{where}: family and category must both be 'absent', or neither of them")
    if task.target is None:
        _check_absent(task, where)
    elif task.family == "absent":
        raise TaskError(
            f"{where}: correct is {task.target + 1}, but in the family 'absent' no gate is right; make it null"
        )
    elif type(task.target) is not int or task.target not in (0, 1, 2):
        shown = task.target + 1 if isinstance(task.target, int) else task.target
        raise TaskError(f"{where}: correct is {shown!r}; it must be 1, 2 or 3, the number of the right gate")
    if task.only is not None and (type(task.only) is not int or task.only != task.target):
        shown = task.only + 1 if isinstance(task.only, int) else task.only
        raise TaskError(
            f"{where}: only gate {shown!r} stands, but the right gate is {_shown(task.target)}; make only equal to "
            "correct, or leave it out"
        )
    check_gates(task.gates, where)
    for names, what in ((task.options, "options"), (task.labels, "labels")):
        if len(names) != 3:
            raise TaskError(f"{where}: {what} has {len(names)} entries; a task has one for each of its 3 gates")
        for name in names:
            check_text(name, f"an entry of {what}", where)
    shown_as = tuple(label.rpartition("@")[0] or label for label in task.labels)
    for entries in (task.options, shown_as):
        for first, second in ((0, 1), (0, 2), (1, 2)):
            if entries[first] == entries[second]:
                right = ", so there are two right answers" if task.target in (first, second) else ""
                raise TaskError(
                    f"{where}: options {first + 1} and {second + 1} are both {entries[first]!r}{right}; "
                    "give each gate an option of its own"
                )
    if task.board is not None:
        check_text(task.board, "board", where)
    if task.layout is not None:
        check_layout(task.layout, task.gates, where)
    _, color, _ = parse_directive(task.directive)
    if task.target is not None and color is not None and color != task.gates[task.target].color:
        raise TaskError(
            f"{where}: prompt_simpler names the {color} gate, but the right gate {task.target + 1} is "
            f"{task.gates[task.target].color}; correct one of them"
        )
