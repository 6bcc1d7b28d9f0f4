"""The published layout: one folder per flight, read and written, with its action convention converted both ways.

    OUT/<Type>/<episode>/{setup.json, data.csv, images/image_<frame_id>.jpg}

`data.csv` has the columns `frame_id,dx,dy,dz,angle,x,y,z,qx,qy,qz,qw`: frames count from 1, positions in metres in the
world, quaternions scalar last. `dx..angle` are not velocities: they are the displacement over the next three samples,
with reversed sign, in a frame along the direction of movement, and the yaw error towards the right gate from there. We
write, with p the position, yaw the heading, g the place of the right gate and s = min(t + 3, last):

    d = p[s] - p[t]        dx = -hypot(d.x, d.y)        dy = 0        dz = -d.z
    angle = wrap(atan2(g.y - p[s].y, g.x - p[s].x) - yaw[t]), or 0 where no gate is right

Flights are found at any depth; the nearest folder above one with a published name is its type.

`setup.json` is the task in the published layout. Our own exports add the key `flight` with everything else, so that
they are read back exactly (including pictures, if they were JPEG). For third-party flights, velocities are rebuilt by
differences. The layout has no place for frames of a camera that looks down: they are left out.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Conditions, Episode, Split, decode_image, encode_image
from cognitivedrone.data.formats.exchange import (
    MAX_JSON_BYTES,
    STEP_ARRAYS,
    check_image,
    encoding_of,
    episode_from,
    new_folder,
    read_json,
    record_of,
    write_json,
)
from cognitivedrone.errors import DataError, TaskError
from cognitivedrone.files import create, own_files, read_regular, reason_of, safe_name
from cognitivedrone.files.texts import decoded, read_table
from cognitivedrone.frames import world_to_heading, wrap_angle, yaw_of
from cognitivedrone.layout import GATE_XY
from cognitivedrone.pictures import MAX_FRAME_BYTES
from cognitivedrone.tasks import task_from_json, task_to_json
from cognitivedrone.tasks.published import ARCHIVES, SETUP_FILE, TYPES, type_of
from cognitivedrone.types import CONTROL_HZ, FloatArray, Quaternions, Task
from cognitivedrone.world.geometry import PAD_XY

COLUMNS = ("frame_id", "dx", "dy", "dz", "angle", "x", "y", "z", "qx", "qy", "qz", "qw")
LOOKAHEAD = 3
"""Samples that a published action spans."""
FRAME_LAG = 1
"""Samples by which published pictures lag behind their pose."""
AGREES = 1e-6
"""Largest difference of a written action from that of its poses, m and rad, for which they agree."""

_TYPES = {each.family: each.folder for each in TYPES.values()} | {"math": "Math_prompt"}
_IN_CSV = ("position", "quaternion")


def export(episodes: Iterable[tuple[Split, Episode]], out: Path) -> int:
    """Write the episodes in the published layout; returns their number.

    The folder of a flight is named by its index, so that names sort like timestamps. Frames that are not JPEG become
    JPEG of quality 95. Raises `DataError` if `out` is not empty or cannot be written.
    """
    count = 0
    with new_folder(out) as partial:
        for split, episode in episodes:
            family = episode.task.family
            folder = partial / safe_name(_TYPES.get(family, family.title())) / f"{episode.index:08d}"
            (folder / "images").mkdir(parents=True)
            _write_flight(folder, split, episode)
            count += 1
    return count


def place_of(task: Task) -> tuple[float, float] | None:
    """X and y of a task's right gate or pad, m; none if no gate is right."""
    if task.target is None:
        return None
    if task.layout is not None:
        return task.layout[task.target].x, task.layout[task.target].y
    x, y = (PAD_XY if task.landing else GATE_XY)[task.target].tolist()
    return x, y


def published_actions(
    position: NDArray[np.float64], quaternion: Quaternions, goal: tuple[float, float] | None
) -> NDArray[np.float64]:
    """(T, 4) published dx, dy, dz in m and angle in rad for positions (T or T + 1, 3) and quaternions (T, 4).

    `goal` is the place of the right gate, m (`place_of`).
    """
    steps = np.arange(len(quaternion))
    ahead = np.minimum(steps + LOOKAHEAD, len(position) - 1)
    displacement = position[ahead] - position[steps]
    distance = np.hypot(displacement[:, 0], displacement[:, 1])
    angle = np.zeros_like(distance)
    if goal is not None:
        x, y = (np.array(goal) - position[ahead, :2]).T
        angle = wrap_angle(np.arctan2(y, x) - yaw_of(quaternion))
    return np.column_stack([-distance, np.zeros_like(distance), -displacement[:, 2], angle])


def velocities(position: FloatArray, yaw: FloatArray, period: float) -> NDArray[np.float32]:
    """(T - 1, 4) mean heading-frame velocity and yaw rate between consecutive samples (T), m/s and rad/s."""
    linear = world_to_heading(np.diff(position, axis=0) / period, yaw[:-1])
    return np.column_stack([linear, wrap_angle(np.diff(yaw)) / period]).astype(np.float32)


def read(path: Path, *, frame_lag: int = FRAME_LAG) -> Iterator[tuple[Split, Episode]]:
    """The flights below a folder, in the order of their paths.

    Our own exports are read back exactly. Third-party flights are assumed to be sampled at 10 Hz, with pictures
    `frame_lag` samples behind their pose. A flight of n rows gives n - max(1, frame_lag) steps. The commands are
    unknown, so the label of a step is the velocity flown from it to the next, and the state is the velocity that led to
    it. All of them are in the split `train`, of suite "published", numbered as found.

    Raises `DataError` with the file and the row or frame that is missing or broken.
    """
    for number, setup_path in enumerate(setups_of(path)):
        yield split_at(setup_path), flight_at(setup_path, number, frame_lag)


def flight_at(setup_path: Path, number: int, frame_lag: int) -> Episode:
    """The flight of a `setup.json`, numbered; see `read`."""
    folder = setup_path.parent
    setup, rows = read_json(setup_path), _read_rows(folder / "data.csv")
    images = tuple(_read_frame(folder, frame) for frame in range(1, len(rows) + 1))
    if isinstance(setup, dict) and "flight" in setup:
        flight = setup["flight"] if isinstance(setup["flight"], dict) else {}
        arrays: dict[str, Any] = {name: flight[name] for name in STEP_ARRAYS if name in flight}
        arrays["position"], arrays["quaternion"] = _pose(rows)
        record = flight | {"task": {name: value for name, value in setup.items() if name != "flight"}}
        return episode_from(record, images, arrays, str(setup_path))[1]
    return _foreign_flight(task_at(setup_path, setup), rows, images, number, folder, frame_lag)


def split_at(setup_path: Path) -> Split:
    """The split that our own export names, else `train`."""
    setup = read_json(setup_path)
    flight = setup.get("flight") if isinstance(setup, dict) else None
    return "val" if isinstance(flight, dict) and flight.get("split") == "val" else "train"


def setups_of(path: Path) -> list[Path]:
    """The `setup.json` of every flight below a folder, sorted; raises `DataError` if there is none."""
    if setups := own_files(path, f"**/{SETUP_FILE}") if path.is_dir() else []:
        return setups
    if path.suffix.lower() in ARCHIVES:
        raise DataError(f"{path} is an archive; unpack it and give the folder")
    raise DataError(f"{path}: no <Type>/<episode>/{SETUP_FILE} below it; is this a published data set?")


def agreement(path: Path) -> str:
    """What the actions of the flights below a folder are worth, in a sentence: whether they follow from their poses.

    Flights whose angle points to another gate than the task's are named.
    """
    largest = np.zeros(4)
    disagreeing, elsewhere, count = list[str](), list[str](), 0
    for setup_path in setups_of(path):
        setup = read_json(setup_path)
        task, rows = task_at(setup_path, setup), _read_rows(setup_path.parent / "data.csv")
        known = rows[: len(rows) - LOOKAHEAD]
        if not len(known):
            continue
        count += 1
        position, quaternion = _pose(rows)

        def difference(goal: tuple[float, float] | None, of: tuple[Any, ...] = (position, quaternion, known)) -> Any:
            made = published_actions(of[0], of[1], goal)[: len(of[2])] - of[2][:, 1:5]
            made[:, 3] = wrap_angle(made[:, 3])
            return np.abs(made).max(axis=0)

        goal = place_of(task)
        far = difference(goal)
        others = [gate for gate in range(3) if gate != task.target and not task.landing and task.layout is None]
        other = [gate + 1 for gate in others if difference(tuple(GATE_XY[gate].tolist()))[3] <= AGREES]
        if other and far[3] > AGREES:
            elsewhere.append(f"{setup_path.parent} (its angle points to gate {other[0]})")
        elif far.max() > AGREES:
            disagreeing.append(str(setup_path.parent))
        else:
            largest = np.maximum(largest, far)
    agreeing = count - len(disagreeing) - len(elsewhere)
    text = f"in {agreeing} of {count} flights dx, dy, dz and angle follow from the poses, to {largest.max():.1g}"
    if elsewhere:
        text += f"; another gate than that of its {SETUP_FILE}, which was taken, is flown at in {_some(elsewhere)}"
    if disagreeing:
        text += f"; they do not in {_some(disagreeing)}: the poses were taken"
    return text


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def task_at(where: Path, setup: object = None) -> Task:
    """The task of a flight, of its `setup.json` or of what was read of that; raises `DataError`."""
    setup = read_json(where) if setup is None else setup
    name, known = type_of(where.resolve())
    try:
        return task_from_json(setup, where=str(where), kind=known or name, default_id=f"{name}/{where.parent.name}")
    except TaskError as error:
        raise DataError(str(error)) from None


def _write_flight(folder: Path, split: Split, episode: Episode) -> None:
    flight: dict[str, Any] = {name: value for name, value in record_of(split, episode).items() if name != "task"}
    flight |= {name: getattr(episode, name).tolist() for name in STEP_ARRAYS if name not in _IN_CSV}
    write_json(folder / "setup.json", task_to_json(episode.task) | {"flight": flight})
    path = np.vstack([episode.position, episode.final_position])
    actions = published_actions(path, episode.quaternion, place_of(episode.task))
    table = np.column_stack([actions, episode.position, episode.quaternion[:, [1, 2, 3, 0]]])
    file = StringIO(newline="")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([number, *row] for number, row in enumerate(table.tolist(), 1))
    with create(folder / "data.csv") as written:  # in a new folder, which is whole or not there
        written.write(file.getvalue().encode("ascii"))
    for number, image in enumerate(episode.images, 1):
        jpeg = image if episode.encoding == "jpeg" else encode_image(decode_image(image), "jpeg")
        with create(_frame_path(folder, number)) as frame:
            frame.write(jpeg)


def _frame_path(folder: Path, number: int) -> Path:
    return folder / "images" / f"image_{number}.jpg"


def _read_rows(path: Path) -> NDArray[np.float64]:
    """(T, 12) the table; frames must count 1, 2, 3, ... without a gap."""
    try:
        rows_of_text = read_table(decoded(read_regular(path, MAX_JSON_BYTES)), COLUMNS)
        header, *lines = [[cell.strip() for cell in line] for line in rows_of_text if line] or [[]]
    except (OSError, ValueError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read ({reason_of(error)})") from None
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise DataError(f"{path}: column {missing[0]!r} is missing; it needs {','.join(COLUMNS)}")
    order = [header.index(name) for name in COLUMNS]
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = [float(line[column]) for column in order]
        except (IndexError, ValueError):
            raise DataError(
                f"{path}: row {number} is not {len(COLUMNS)} numbers; it reads {','.join(line)[:60]!r}"
            ) from None
        if row[0] != number:
            raise DataError(f"{path}: row {number} is frame {row[0]:g}; frame {number} is missing or out of order")
        if not np.isfinite(row).all() or abs(np.linalg.norm(row[8:]) - 1) > 1e-2:
            raise DataError(f"{path}: row {number} has no finite pose with a unit quaternion")
        rows.append(row)
    if not rows:
        raise DataError(f"{path}: holds no row")
    return np.array(rows)


def _read_frame(folder: Path, number: int) -> bytes:
    path = _frame_path(folder, number)
    try:
        data = read_regular(path, MAX_FRAME_BYTES)
    except OSError as error:
        reason = reason_of(error)
        raise DataError(f"{path}: the frame of row {number} of data.csv cannot be read ({reason})") from None
    check_image(data, str(path))
    return data


def _pose(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return rows[:, 5:8].copy(), rows[:, [11, 8, 9, 10]]


def _foreign_flight(
    task: Task, rows: NDArray[np.float64], images: tuple[bytes, ...], index: int, folder: Path, frame_lag: int
) -> Episode:
    length = len(rows) - max(1, frame_lag)
    if length < 1:
        raise DataError(f"{folder / 'data.csv'}: {len(rows)} rows are too few for a step; velocities are differences")
    position, quaternion = _pose(rows)
    yaw = yaw_of(quaternion)
    flown = velocities(position, yaw, 1 / CONTROL_HZ)[:length]
    # The velocity before a step is that flown from the previous step; before the first, the drone was at rest.
    before = np.vstack([np.zeros((1, 3)), np.diff(position, axis=0) * CONTROL_HZ])[:length]
    frames = images[frame_lag : frame_lag + length]
    x, y, z = position[0].tolist()
    return Episode(
        index=index,
        suite="published",
        task=task,
        conditions=Conditions(0, "published", "published", (x, y, z), float(yaw[0]), (0.0, 0.0, 0.0)),
        encoding=encoding_of(frames, str(folder / "images")),
        images=frames,
        action=flown,
        sent=flown,
        velocity=world_to_heading(before, yaw[:length]).astype(np.float32),
        height=position[:length, 2].astype(np.float32),
        yaw_rate=np.concatenate([[0], flown[:-1, 3]]).astype(np.float32),
        position=position[:length],
        quaternion=quaternion[:length],
        final_position=position[length],
    )
