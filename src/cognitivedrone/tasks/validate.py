"""Validation of tasks. Every error is one sentence that names the place and the fix."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.layout import (
    GATE_HEIGHT,
    GATE_XY,
    GATE_YAWS,
    LOWEST_M,
    PANEL_HEIGHT,
    PANEL_RISE,
    START,
    START_HALF_EXTENT,
    choices,
    is_clear,
)
from cognitivedrone.layout.obstacles import LANDMARK_SIDE, Solids, solids_of
from cognitivedrone.tasks.directives import HOLD, declines, parse_directive
from cognitivedrone.tasks.missions import lands
from cognitivedrone.text.printable import unprintable
from cognitivedrone.types import ALL_CATEGORIES, COLORS, SHAPES, SIZES, Gate, GatePlace, Layout, Obstacle, Task

MAX_TEXT = 1000
"""Longest instruction, directive or name, in characters."""
GATE_ROOM = (0.5, 1.05)
"""Half the depth and width of the column around a gate and its panel that obstacles stay out of, m."""
START_ROOM = 0.4
"""Between start box and obstacles, m."""
FASTEST_M_S: Final = 1.0
"""Of gates and obstacles that move."""
MAX_GATE_SWAY: Final = 1.0
"""How far a gate moves to either side, at most, m."""
_RANGES = {
    "x": (-4.0, 8.5), "y": (-7.0, 7.0), "width": (0.05, 6.0), "height": (0.05, 5.0), "depth": (0.02, 3.0),
    "yaw": (-math.pi, math.pi), "above": (0.0, 5.0), "sway": (0.0, 3.0), "period": (1.0, 60.0),
    "phase": (-2 * math.pi, 2 * math.pi),
}  # fmt: skip


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
    """Raise `TaskError` unless the gates are inside the stage, above its floor, and left to right from the start.

    They keep apart, and none hides another or is on the way to it. Those that move are slow.
    """
    for number, (place, gate) in enumerate(zip(layout, gates, strict=True), 1):
        lowest = LOWEST_M[gate.size]
        for name, value, low, high in (
            ("x", place.x, 1.0, 8.0),
            ("y", place.y, -7.0, 7.0),
            ("height", place.height, lowest, 3.0),
            ("yaw", place.yaw, -math.pi / 2, math.pi / 2),
            ("sway", place.sway, 0.0, MAX_GATE_SWAY),
            *((key, getattr(place, key), *_RANGES[key]) for key in ("period", "phase")),
        ):
            if not low <= value <= high:
                raise TaskError(
                    f"{where}: {name} of gate {number} is {value:g}; it must be from {low:.3g} to {high:.3g}"
                    + (f" for a {gate.size} gate" if name == "height" else "")
                )
        _check_speed(place, f"{where}: gate {number}")
    for first, second in ((0, 1), (0, 2), (1, 2)):
        a, b = layout[first], layout[second]
        if math.hypot(a.x - b.x, a.y - b.y) < 2 * GATE_ROOM[1] + a.sway + b.sway:
            meet = "may meet on their ways" if a.sway or b.sway else "touch"
            raise TaskError(f"{where}: gates {first + 1} and {second + 1} {meet}; move them apart")
    bearings = [math.atan2(place.y - START[1], place.x - START[0]) for place in layout]
    if not bearings[0] > bearings[1] > bearings[2]:
        raise TaskError(f"{where}: the gates of the layout must be numbered from left to right, as seen from the start")
    if not is_clear(layout, board=False):
        raise TaskError(
            f"{where}: a gate of the layout hides another, is in its way or out of view, so that flights there could"
            " not be judged; move them apart"
        )


def _check_speed(thing: Obstacle | GatePlace, which: str) -> None:
    if (fastest := 2 * math.pi * thing.sway / thing.period) > FASTEST_M_S:
        slow = 2 * math.pi * thing.sway / FASTEST_M_S
        raise TaskError(f"{which} moves at {fastest:.2f} m/s; make its period {slow:.1f} s at least")


def _check_absent(task: Task, where: str) -> None:
    if task.family != "absent":
        raise TaskError(
            f"{where}: correct is null, so no gate is right; that is for the family 'absent', "
            f"not {task.family!r}: give 1, 2 or 3"
        )
    if not declines(task.directive):
        raise TaskError(f"{where}: prompt_simpler is {task.directive[:40]!r}; in the family 'absent' it is {HOLD!r}")


def _check_missing(task: Task, where: str) -> None:
    if task.missing is None:
        return
    if type(task.missing) is not int or task.missing not in (0, 1, 2) or task.missing == task.target:
        shown = task.missing + 1 if isinstance(task.missing, int) else task.missing
        raise TaskError(f"{where}: missing is {shown!r}; it must be the number of a gate that is not the right one")
    if task.landing or task.only is not None:
        raise TaskError(f"{where}: missing is for stages with two gates; leave it out beside landing and only")


def _check_landing(task: Task, where: str) -> None:
    if task.landing and (task.layout or task.board or task.only is not None or task.target is None):
        raise TaskError(f"{where}: a landing has three pads and nothing else; leave out layout, board and only")
    landing, color = lands(task.directive)
    if task.landing != landing:
        right = "'Land on the red pad'" if task.landing else "'Fly through the small red round gate'"
        raise TaskError(f"{where}: prompt_simpler is {task.directive[:40]!r}; write it as {right}")
    if task.landing and task.target is not None and color != task.gates[task.target].color:
        raise TaskError(f"{where}: prompt_simpler must name the right pad, {task.gates[task.target].color}")


def _check_obstacles(task: Task, where: str) -> None:
    """What is in the way has sizes within the stage, and leaves start box and gates free."""
    if task.landing and (task.obstacles or task.landmark):
        raise TaskError(f"{where}: a landing has three pads and nothing else; leave out obstacles and landmark")
    if task.landmark and task.board:
        raise TaskError(f"{where}: a stage has a board or a landmark; leave out one of them")
    named = [(f"obstacle {number}, a {each.kind},", each) for number, each in enumerate(task.obstacles, 1)]
    for name, each in named:
        for key, (low, high) in _RANGES.items():
            _check_range(getattr(each, key), key, low, high, f"{where}: {name}")
        if each.kind == "frame" and min(each.width, each.height) < 0.5:
            raise TaskError(f"{where}: {name} is too narrow for an opening; make width and height 0.5 at least")
        _check_speed(each, f"{where}: {name}")
    parts = [(f"{name} on its way" if each.sway else name, solids_of((each,)).swept()) for name, each in named]
    if (mark := task.landmark) is not None:
        check_text(mark.label, "the label of the landmark", where)
        for key, low, high in (("x", *_RANGES["x"]), ("y", *_RANGES["y"]), ("yaw", *_RANGES["yaw"])):
            _check_range(getattr(mark, key), key, low, high, f"{where}: the landmark")
        _check_range(mark.height, "height", LANDMARK_SIDE, 4.0, f"{where}: the landmark")
        parts.append(("the landmark", solids_of((), mark)))
    for name, solids in parts:
        if space := occupied(task, solids):
            raise TaskError(f"{where}: {name} overlaps {space}; move it away")


def occupied(task: Task, solids: Solids) -> str:
    """What must stay free and is not; empty if all is."""
    side = START_HALF_EXTENT + START_ROOM
    low = np.array([START[0], START[1], (START[2] + side) / 2])
    if solids.meets(low, 0.0, np.array([side, side, low[2]])).any():
        return "the start box"
    for index in choices(task):
        place = None if task.layout is None else task.layout[index]
        x, y = GATE_XY[index] if place is None else (place.x, place.y)
        height, yaw = (GATE_HEIGHT, GATE_YAWS[index]) if place is None else (place.height, place.yaw)
        top, wide = height + PANEL_RISE + PANEL_HEIGHT / 2, GATE_ROOM[1] + (0.0 if place is None else place.sway)
        if solids.meets(np.array([x, y, top / 2]), float(yaw), np.array([GATE_ROOM[0], wide, top / 2])).any():
            return f"the opening or the panel of gate {index + 1}"
    return ""


def _check_range(value: float, name: str, low: float, high: float, which: str) -> None:
    if not low <= value <= high:
        raise TaskError(f"{which} has {name} {value:g}; make it {low:.3g} to {high:.3g}")


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
            f"{where}: only gate {shown!r} stands, but the right gate is "
            f"{'none' if task.target is None else task.target + 1}; make only equal to "
            "correct, or leave it out"
        )
    _check_missing(task, where)
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
    if task.mission is not None:
        check_text(task.mission, "mission", where)
    _check_landing(task, where)
    if task.obstacles or task.landmark:
        _check_obstacles(task, where)
    _, color, _ = parse_directive(task.directive)
    if task.target is not None and color is not None and color != task.gates[task.target].color:
        raise TaskError(
            f"{where}: prompt_simpler names the {color} gate, but the right gate {task.target + 1} is "
            f"{task.gates[task.target].color}; correct one of them"
        )
