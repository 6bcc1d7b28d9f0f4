import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from factory import make_episode

from cognitivedrone.data.episode import Episode, Split, decode_image
from cognitivedrone.data.formats import export, import_
from cognitivedrone.data.formats.published import published_actions, read, velocities
from cognitivedrone.errors import DataError
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.tasks import read_tasks

FLIGHTS: list[tuple[Split, Episode]] = [
    ("val" if index == 1 else "train", make_episode(index, 5 + index, encoding="jpeg")) for index in range(10)
]
UPSTREAM = Path(__file__).resolve().parents[3] / "shared" / "upstream" / "tasks"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    out = tmp_path_factory.mktemp("published") / "set"
    assert export(iter(FLIGHTS), "published", out) == len(FLIGHTS)
    return out


@pytest.fixture
def foreign(tmp_path):
    """One flight as others have it: nothing of ours in setup.json, gates as a list, another order of columns."""
    export(FLIGHTS[2:3], "published", tmp_path / "set")
    (setup_path,) = tmp_path.rglob("setup.json")
    setup = json.loads(setup_path.read_text())
    gates = [{"gate": number, **gate} for number, gate in setup["gates"].items()]
    keys = ("prompt", "prompt_simpler", "options", "correct", "background")
    setup_path.write_text(json.dumps({key: setup[key] for key in keys} | {"gates": gates}))
    folder = tmp_path / "set" / "Animals" / "2025-02-11_10-31-07"
    folder.parent.mkdir(exist_ok=True)
    return setup_path.parent.rename(folder)


def test_the_folder_is_laid_out_as_published(exported):
    episode = next(episode for _, episode in FLIGHTS if episode.task.family == "digits")
    folder = exported / "Digits" / f"{episode.index:08d}"
    assert {path.name for path in folder.iterdir()} == {"setup.json", "data.csv", "images"}
    images = {path.name for path in (folder / "images").iterdir()}
    assert images == {f"image_{number}.jpg" for number in range(1, len(episode) + 1)}
    header, first, *_ = csv.reader((folder / "data.csv").read_text().splitlines())
    assert header == ["frame_id", "dx", "dy", "dz", "angle", "x", "y", "z", "qx", "qy", "qz", "qw"]
    assert first[0] == "1"
    w, x, y, z = episode.quaternion[0]
    assert [float(cell) for cell in first[5:]] == [*episode.position[0], x, y, z, w]
    setup = json.loads((folder / "setup.json").read_text())
    task = episode.task
    assert (setup["prompt"], setup["prompt_simpler"], setup["correct"]) == (
        task.instruction,
        task.directive,
        task.target + 1,
    )


def test_frames_that_are_not_jpeg_become_jpeg(tmp_path):
    episode = make_episode(3, 2, encoding="png")
    export([("train", episode)], "published", tmp_path / "set")
    ((_, back),) = import_(tmp_path / "set", "published")
    assert back.encoding == "jpeg"
    np.testing.assert_array_equal(back.action, episode.action)
    for before, after in zip(episode.images, back.images, strict=True):
        assert np.abs(decode_image(before).astype(int) - decode_image(after)).mean() < 3


def test_published_actions_are_backward_displacements_and_the_turn_to_the_right_gate():
    """Flying 0.2 m a sample to the north and climbing, looking north-east, with the gate in the east."""
    steps = np.arange(6)
    position = np.column_stack([np.zeros(6), 0.2 * steps, 1 + 0.1 * steps])
    actions = published_actions(position, quaternion_from_yaw(np.full(5, np.pi / 4)), (3.0, 0.6))
    np.testing.assert_allclose(actions[0], [-0.6, 0, -0.3, -np.pi / 4], atol=1e-12)  # from 0.6 m it is due east
    turn = np.arctan2(-0.4, 3.0) - np.pi / 4
    np.testing.assert_allclose(actions[3], [-0.4, 0, -0.2, turn], atol=1e-12)  # only two samples are left


def test_where_no_gate_is_right_there_is_no_turn():
    actions = published_actions(np.ones((4, 3)), quaternion_from_yaw(np.full(4, 2.0)), None)
    np.testing.assert_array_equal(actions, np.zeros((4, 4)))


def test_velocities_are_in_the_heading_frame():
    """A left turn at 1 rad/s through the cut at pi, flying forward at 2 m/s."""
    yaw = np.pi - 0.25 + 0.1 * np.arange(6)
    position = np.cumsum(0.2 * np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(6)]), axis=0)
    flown = velocities(position, (yaw + np.pi) % (2 * np.pi) - np.pi, 0.1)
    np.testing.assert_allclose(flown[:, 3], 1, atol=1e-5)
    np.testing.assert_allclose(np.hypot(flown[:, 0], flown[:, 1]), 2, atol=1e-5)
    np.testing.assert_allclose(flown[:, 1] / flown[:, 0], np.tan(0.1), atol=1e-5)


def test_a_flight_of_others_is_rebuilt_from_its_poses(foreign):
    original = FLIGHTS[2][1]
    ((split, episode),) = import_(foreign.parents[1], "published")
    assert (split, episode.suite, episode.task.family, episode.task.id) == (
        "train", "published", "animals", f"Animals/{foreign.name}",
    )  # fmt: skip
    assert len(episode) == len(original) - 1
    np.testing.assert_allclose(episode.action, original.action[:-1], atol=1e-5)
    np.testing.assert_allclose(episode.yaw_rate[1:], original.yaw_rate[:-2], atol=1e-5)
    np.testing.assert_array_equal(episode.final_position, original.position[-1])
    assert episode.images == original.images[1:], "pictures lag one sample behind their pose"
    ((_, without_lag),) = read(foreign.parents[1], frame_lag=0)
    assert without_lag.images == original.images[:-1]


def test_the_state_of_a_flight_of_others_is_what_led_to_each_step(foreign):
    ((_, episode),) = import_(foreign.parents[1], "published")
    np.testing.assert_array_equal(episode.velocity[0], np.zeros(3))
    speed = np.linalg.norm(episode.action[:-1, :3], axis=1)
    np.testing.assert_allclose(np.linalg.norm(episode.velocity[1:], axis=1), speed, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("images/image_4.jpg", None, r"image_4\.jpg: the frame of row 4"),
        *(
            ("images/image_2.jpg", content, r"image_2\.jpg: not a whole image")
            for content in (b"", b"no picture", FLIGHTS[0][1].images[0][:500])
        ),
        ("setup.json", b'{"prompt": "Fly"}', r"setup\.json: key 'prompt_simpler' is missing"),
    ],
)
def test_a_missing_or_broken_file_is_named(foreign, name, content, says):
    if content is None:
        (foreign / name).unlink()
    else:
        (foreign / name).write_bytes(content)
    with pytest.raises(DataError, match=says):
        list(import_(foreign.parents[1], "published"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:3] + rows[4:], "row 3 is frame 4; frame 3 is missing"),
        (lambda rows: [row[:-1] for row in rows], "column 'qw' is missing"),
        (lambda rows: [], "column 'frame_id' is missing"),
        (lambda rows: rows[:1], "holds no row"),
        (lambda rows: rows[:2], "1 rows are too few"),
        (lambda rows: [*rows[:2], rows[2][:5]], "row 2 is not 12 numbers"),
        (lambda rows: [*rows[:2], [*rows[2][:5], "nan", *rows[2][6:]]], "row 2 has no finite pose"),
        (lambda rows: [*rows[:2], [*rows[2][:-1], "7"]], "row 2 has no finite pose with a unit quaternion"),
    ],
)
def test_a_broken_table_is_reported(foreign, change, message):
    rows = list(csv.reader((foreign / "data.csv").read_text().splitlines()))
    (foreign / "data.csv").write_text("".join(",".join(row) + "\n" for row in change(rows)))
    with pytest.raises(DataError, match=rf"data\.csv: .*{message}"):
        list(import_(foreign.parents[1], "published"))


def test_a_damaged_record_of_ours_is_named(exported, tmp_path):
    copy = Path(shutil.copytree(exported, tmp_path / "copy"))
    path = next(copy.rglob("setup.json"))
    setup = json.loads(path.read_text())
    setup["flight"]["action"].pop()
    path.write_text(json.dumps(setup))
    with pytest.raises(DataError, match=r"setup\.json: not an episode of this format"):
        list(import_(copy, "published"))


@pytest.mark.skipif(not UPSTREAM.is_dir(), reason="the published tasks are not at hand")
def test_published_tasks_serve_as_setups(foreign):
    tasks = json.loads((UPSTREAM / "Animals.json").read_text())
    (foreign / "setup.json").write_text(json.dumps(tasks[7]))
    ((_, episode),) = import_(foreign.parents[1], "published")
    expected = read_tasks(UPSTREAM / "Animals.json")[7]
    assert (episode.task.instruction, episode.task.gates) == (expected.instruction, expected.gates)
