"""The export command: which task, which folder, and what it says when it cannot."""

import re

import numpy as np
import pytest
from sdf_reading import models, read_world, values

from cognitivedrone.cli import main
from cognitivedrone.errors import GazeboError, LabelError, TaskError
from cognitivedrone.tasks import load_suite
from cognitivedrone.vehicles.gazebo.worlds.export import export, find_track, stages_of
from cognitivedrone.world import geometry


def test_one_task_is_one_world_with_all_its_files(tmp_path, capsys):
    main(["gazebo", "export", "--suite", "open-v1:test", "--task", "open-v1:test/0007", "--out", str(tmp_path / "w")])
    task = next(track[0] for track in load_suite("open-v1:test").tracks if track[0].id == "open-v1:test/0007")
    assert task.instruction in capsys.readouterr().out
    folder = tmp_path / "w"
    world = read_world(folder / "world.sdf")
    uris = [element.text for tag in ("uri", "albedo_map", "emissive_map") for element in world.iter(tag)]
    assert uris
    assert all((folder / uri).is_file() for uri in uris)
    for place, gate in enumerate(task.gates, start=1):
        emissive = values(models(world)[f"gate_{place}"], ".//emissive")[:3]
        assert emissive.index(max(emissive)) == ["red", "green", "blue"].index(gate.color)
    readme = (folder / "README.md").read_text()
    assert task.instruction in readme
    assert "gz sim -v 3 -r world.sdf" in readme
    assert "gz-harmonic" in readme
    assert "$" not in re.sub(r"\$(HOME|ARDUPILOT|GZ_SIM_SYSTEM_PLUGIN_PATH)\b", "", readme)


def test_the_stages_of_a_track_lie_behind_the_right_gates(track_folder):
    track = load_suite("open-v1:track").tracks[0]
    stages = stages_of(track)
    assert len(stages) == len(list(track_folder.glob("stage_*.sdf"))) == len(track)
    for before, after, task in zip(stages, stages[1:], track, strict=False):
        assert (after.origin, after.yaw) == geometry.next_stage_origin(before, task.target)
    for number, stage in enumerate(stages, start=1):
        found = models(read_world(track_folder / f"stage_{number}.sdf"))
        vehicle = values(found["iris"], "pose")
        start = geometry.to_gate_frame(np.array(vehicle[:3]), np.array([*stage.origin, 0.0]), stage.yaw)
        assert start[:2] == pytest.approx(geometry.START[:2], abs=1e-6)
        assert vehicle[5] == pytest.approx(stage.yaw)
        for place, center in enumerate(geometry.gate_centers(stage), start=1):
            assert values(found[f"gate_{place}"], "pose")[:2] == pytest.approx(center[:2], abs=1e-6)


def test_a_track_is_found_by_its_number_and_by_any_of_its_tasks():
    suite = load_suite("open-v1:track")
    assert find_track(suite, track="3") is find_track(suite, track=suite.tracks[3][2].id) is suite.tracks[3]
    assert find_track(suite, task=suite.tracks[3][2].id) == (suite.tracks[3][2],)


def test_the_same_export_is_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        export("open-v1:smoke", task="open-v1:smoke/0003", out=tmp_path / name, version="jetty")
    files = [path.relative_to(tmp_path / "a") for path in sorted((tmp_path / "a").rglob("*")) if path.is_file()]
    assert len(files) > 10
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)
    assert "python3-gz-transport15" in (tmp_path / "a" / "README.md").read_text()


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"task": "open-v1:smoke/00003"}, TaskError, "did you mean .*open-v1:smoke/0003"),
        ({"track": "30"}, TaskError, "has no track 30; it has 0 to 29"),
        ({}, TaskError, "give --task ID .* or --track ID"),
        ({"task": "a", "track": "b"}, TaskError, "one of the two"),
        ({"task": "open-v1:smoke/0003", "version": "harmony"}, GazeboError, "did you mean 'harmonic'"),
        ({"task": "open-v1:smoke/0003", "labels": "nowhere"}, LabelError, "no label pack 'nowhere'"),
    ],
)
def test_what_cannot_be_exported_is_reported_in_one_sentence(tmp_path, options, error, says):
    with pytest.raises(error, match=says):
        export("open-v1:smoke", out=tmp_path / "w", **options)
    assert not (tmp_path / "w").exists()


def test_a_folder_in_use_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(GazeboError, match="is not empty"):
        export("open-v1:smoke", task="open-v1:smoke/0003", out=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_texture_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(
        GazeboError, match=r"file/w: cannot be written \(Not a directory\); make room there or give another"
    ):
        export("open-v1:smoke", task="open-v1:smoke/0003", out=tmp_path / "file" / "w")
