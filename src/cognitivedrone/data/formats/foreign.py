"""Episodes of data sets that this package did not make: frames, sentences and actions, and little else.

What their records lack is filled in, and `MISSING` says so: the path by integrating the velocities, and the scene from
the plain directive (the right gate) and from where the flight goes (which of the three it is). The other two gates are
placeholders: such flights train and score actions; they cannot be flown again in their own scene (`has_scene`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Conditions, Episode
from cognitivedrone.data.formats.exchange import encoding_of
from cognitivedrone.errors import DataError, TaskError
from cognitivedrone.frames import rotate_yaw
from cognitivedrone.layout import START
from cognitivedrone.tasks.directives import parse_directive, write_directive
from cognitivedrone.tasks.published import PublishedType, published_type
from cognitivedrone.tasks.validate import validate_task
from cognitivedrone.types import COLORS, CONTROL_HZ, Gate, Task

WIDTHS = {"action": 4, "state": 5}
"""vx, vy, vz m/s and yaw rate rad/s in the heading frame; velocity, height m, yaw rate."""
MISSING = (
    "poses and scenes are not recorded there: paths are integrated from the actions, and of the gates only the right"
    " one is known, from its directive"
)
_NO_OPTIONS = ("first", "second", "third")
_PUBLISHED_SPAN_S = 0.3
"""Of a published displacement: three samples."""
_ASIDE_RAD = 0.35
"""A flight that ends farther to a side than this, seen from its start, is one to the gate of that side."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Which numbers of a record are ours: `action=0+1+2+5 state=0+1+2+3+4`, in the order of `WIDTHS`."""

    chosen: Mapping[str, tuple[int, ...]]
    convention: str = ""
    """`velocities`, or `published`: backward displacements over three samples."""

    @classmethod
    def parse(cls, text: str) -> Columns:
        """Read the option --columns; raises `DataError` with an example."""
        chosen, convention = {}, ""
        for part in text.split():
            if part in ("velocities", "published"):
                convention = part
                continue
            name, equals, numbers = part.partition("=")
            found = numbers.split("+")
            if name not in WIDTHS or not equals or not all(each.isdecimal() for each in found):
                raise DataError(f"--columns {text!r} cannot be read; write for example {example()!r}")
            if len(found) != WIDTHS[name]:
                raise DataError(f"--columns {part!r} names {len(found)} numbers; {name} has {WIDTHS[name]}")
            chosen[name] = tuple(map(int, found))
        return cls(chosen, convention)

    def of(self, name: str, table: NDArray[Any], where: str) -> NDArray[np.float32]:
        """(T, 4) or (T, 5) of a table (T, width); raises `DataError` that shows the line to type."""
        wanted, width = self.chosen.get(name), table.shape[1]
        if max(wanted) >= width if wanted else width != WIDTHS[name]:
            raise DataError(
                f"{where}: its {name} has {width} numbers a step, not {WIDTHS[name]}; say which they are, such as"
                f" --columns {example()!r}"
            )
        return np.ascontiguousarray(table if wanted is None else table[:, wanted], dtype=np.float32)

    def action(self, table: NDArray[Any], where: str) -> NDArray[np.float32]:
        """(T, 4) m/s and rad/s of a table of actions; those that fly backward must be said to be which they are."""
        found = self.of("action", table, where)
        if not self.convention and len(found) and found[:, 0].mean() < 0:
            raise DataError(
                f"{where}: its actions lead backward on average; add `published` to --columns where they are"
                " displacements of the published convention, or `velocities`"
            )
        if self.convention == "published":
            found = found * np.array([-1, -1, -1, _PUBLISHED_SPAN_S], np.float32) / np.float32(_PUBLISHED_SPAN_S)
        return found

    def state(self, table: NDArray[Any], where: str) -> NDArray[np.float32] | None:
        """(T, 5) of a table of states, if it has as many or --columns says which; else none."""
        known = table.shape[1] == WIDTHS["state"] or "state" in self.chosen
        return self.of("state", table, where) if known else None


def has_scene(task: Task) -> bool:
    """Whether the gates of a task are known; of an imported flight of others they may not be."""
    return task.options != _NO_OPTIONS


def example() -> str:
    """A line of --columns."""
    return " ".join(f"{name}=" + "+".join(map(str, range(width))) for name, width in WIDTHS.items())


def foreign_episode(
    index: int,
    images: Sequence[bytes],
    instruction: str,
    action: NDArray[np.float32],
    where: str,
    *,
    state: NDArray[np.float32] | None = None,
    directive: str = "",
    kind: str = "",
) -> Episode:
    """An episode of T steps from frames, actions (T, 4) and, if recorded, states (T, 5); of the published `kind`.

    Raises `DataError`.
    """
    if not len(images) or len(images) != len(action) or not np.isfinite(action).all():
        raise DataError(f"{where}: has {len(images)} frames and {len(action)} actions; it needs one each, finite")
    yaw = np.concatenate([[0.0], np.cumsum(action[:, 3].astype(np.float64))]) / CONTROL_HZ
    steps = rotate_yaw(action[:, :3].astype(np.float64), yaw[:-1])
    path = np.vstack([START, START + np.cumsum(steps, axis=0) / CONTROL_HZ])
    if state is None:
        before = np.vstack([np.zeros((1, 4), np.float32), action[:-1]])
        state = np.column_stack([before[:, :3], path[:-1, 2], before[:, 3]]).astype(np.float32)
    else:
        path[:, 2] = np.concatenate([state[:, 3], state[-1:, 3]])
    half = yaw[:-1] / 2
    return Episode(
        index=index,
        suite="published",
        task=_task(index, instruction, directive, kind, path, where),
        conditions=Conditions(0, "published", "published", tuple(path[0].tolist()), 0.0, (0.0, 0.0, 0.0)),
        encoding=encoding_of(tuple(images), where),
        images=tuple(images),
        action=action,
        sent=action,
        velocity=state[:, :3].copy(),
        height=state[:, 3].copy(),
        yaw_rate=state[:, 4].copy(),
        position=path[:-1],
        quaternion=np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)]),
        final_position=path[-1],
    )


def _task(index: int, instruction: str, directive: str, kind: str, path: NDArray[np.float64], where: str) -> Task:
    known = published_type(kind) or PublishedType(kind or "recorded", "symbol_understanding", "recorded")
    size, color, shape = parse_directive(directive)
    ended = path[-1] - path[0]
    turn = float(np.arctan2(ended[1], ended[0]))
    target = 0 if turn > _ASIDE_RAD else 2 if turn < -_ASIDE_RAD else 1
    right = Gate(size or "big", shape or "square", color or "red")
    others = iter([each for each in COLORS if each != right.color])
    a, b, c = (right if gate == target else Gate("big", "square", next(others)) for gate in range(3))
    task = Task(
        id=f"{kind or 'recorded'}/{index:06d}",
        category=known.category,
        family=known.family,
        instruction=instruction,
        directive=directive or write_directive(right),
        options=_NO_OPTIONS,
        labels=tuple(f"{known.folder}/{option}" for option in _NO_OPTIONS),  # type: ignore[arg-type]
        target=target,
        gates=(a, b, c),
    )
    try:
        validate_task(task, where)
    except TaskError as error:
        raise DataError(str(error)) from None
    return task
