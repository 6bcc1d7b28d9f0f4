"""The published layout: one folder per flight, read and written, with its action convention converted both ways.

    OUT/<Type>/<episode>/{setup.json, data.csv, images/image_<frame_id>.jpg}

`data.csv` has the columns `frame_id,dx,dy,dz,angle,x,y,z,qx,qy,qz,qw`: frames count from 1, positions in metres in the
world, quaternions scalar last. `dx..angle` are not velocities: they are the displacement over the next three samples,
with reversed sign, in a frame along the direction of movement, and the yaw error towards it. We write, with p the
position, yaw the heading and s = min(t + 3, last):

    d = p[s] - p[t]        dx = -hypot(d.x, d.y)        dy = 0        dz = -d.z
    angle = wrap(atan2(d.y, d.x) - yaw[t]), or 0 where the drone moves less than a millimetre sideways

`setup.json` is the task in the published layout. Our own exports add the key `flight` with everything else, so that
they are read back exactly (including pictures, if they were JPEG). For third-party flights, velocities are rebuilt by
differences. The layout has no place for frames of a camera that looks down: they are left out.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
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
from cognitivedrone.pictures import MAX_FRAME_BYTES
from cognitivedrone.tasks import task_from_json, task_to_json
from cognitivedrone.tasks.format import PUBLISHED_TYPES
from cognitivedrone.types import CONTROL_HZ, FloatArray, Quaternions

COLUMNS = ("frame_id", "dx", "dy", "dz", "angle", "x", "y", "z", "qx", "qy", "qz", "qw")
LOOKAHEAD = 3
"""Samples that a published action spans."""
FRAME_LAG = 1
"""Samples by which published pictures lag behind their pose."""
STILL_M = 1e-3

_TYPES = {family: name for name, (_, family) in PUBLISHED_TYPES.items()}
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
        if not count:
            raise DataError(f"{out}: there is no episode to export")
    return count


def published_actions(position: NDArray[np.float64], quaternion: Quaternions) -> NDArray[np.float64]:
    """(T, 4) published dx, dy, dz in m and angle in rad for positions (T or T + 1, 3) and quaternions (T, 4)."""
    steps = np.arange(len(quaternion))
    ahead = np.minimum(steps + LOOKAHEAD, len(position) - 1)
    displacement = position[ahead] - position[steps]
    distance = np.hypot(displacement[:, 0], displacement[:, 1])
    heading = np.arctan2(displacement[:, 1], displacement[:, 0])
    angle = np.where(distance < STILL_M, 0.0, wrap_angle(heading - yaw_of(quaternion)))
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
    setups = own_files(path, "*/*/setup.json") or own_files(path, "*/setup.json")
    if not setups:
        raise DataError(f"{path}: no <Type>/<episode>/setup.json below it; is this a published data set?")
    for index, setup_path in enumerate(setups):
        folder = setup_path.parent
        setup = read_json(setup_path)
        rows = _read_rows(folder / "data.csv")
        images = tuple(_read_frame(folder, number) for number in range(1, len(rows) + 1))
        if isinstance(setup, dict) and "flight" in setup:
            yield _own_flight(setup, rows, images, setup_path)
        else:
            yield "train", _foreign_flight(setup, rows, images, index, folder, frame_lag)


def _write_flight(folder: Path, split: Split, episode: Episode) -> None:
    flight: dict[str, Any] = {name: value for name, value in record_of(split, episode).items() if name != "task"}
    flight |= {name: getattr(episode, name).tolist() for name in STEP_ARRAYS if name not in _IN_CSV}
    write_json(folder / "setup.json", task_to_json(episode.task) | {"flight": flight})
    path = np.vstack([episode.position, episode.final_position])
    actions = published_actions(path, episode.quaternion)
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
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({reason_of(error)})") from None
    except (ValueError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read ({error})") from None
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


def _own_flight(
    setup: Mapping[str, Any], rows: NDArray[np.float64], images: tuple[bytes, ...], where: Path
) -> tuple[Split, Episode]:
    flight = setup["flight"] if isinstance(setup["flight"], dict) else {}
    arrays: dict[str, Any] = {name: flight[name] for name in STEP_ARRAYS if name in flight}
    arrays["position"], arrays["quaternion"] = _pose(rows)
    record = flight | {"task": {name: value for name, value in setup.items() if name != "flight"}}
    return episode_from(record, images, arrays, str(where))


def _foreign_flight(
    setup: object, rows: NDArray[np.float64], images: tuple[bytes, ...], index: int, folder: Path, frame_lag: int
) -> Episode:
    kind = folder.resolve().parent.name
    try:
        task = task_from_json(setup, where=str(folder / "setup.json"), kind=kind, default_id=f"{kind}/{folder.name}")
    except TaskError as error:
        raise DataError(str(error)) from None
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
        conditions=Conditions(
            seed=0,
            airframe="published",
            look="published",
            start_position=(x, y, z),
            start_yaw=float(yaw[0]),
            wind=(0.0, 0.0, 0.0),
        ),
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
