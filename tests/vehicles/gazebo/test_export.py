"""The export: which task, which folder, what it says when it cannot; and what libsdformat's own parser says of it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from sdf_reading import models, read_world, values

from cognitivedrone.cli import main
from cognitivedrone.errors import GazeboError, LabelError, TaskError
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import Gate, Stage
from cognitivedrone.vehicles.gazebo.worlds import export as checking
from cognitivedrone.vehicles.gazebo.worlds.export import (
    PACKAGE,
    check,
    export,
    find_checker,
    find_track,
    world_of,
)
from cognitivedrone.vehicles.gazebo.worlds.sdf import PanelPicture, document, prop_model, props_of
from cognitivedrone.world.appearance import PLAIN, varied_appearance


def test_one_task_is_one_world_with_all_its_files(tmp_path, capsys):
    suite = load_suite("open-v1:track")
    assert find_track(suite, track="3") is find_track(suite, track=suite.tracks[3][2].id) is suite.tracks[3]
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


needs_parser = pytest.mark.skipif(
    find_checker() is None, reason=f"libsdformat is not on this machine: apt-get install {PACKAGE}"
)
STAGE = Stage(
    (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue")),
    ("letter/A@inter",) * 3,
)
PICTURES = (PanelPicture("a.png", 1.0), PanelPicture("b.png", 0.5), PanelPicture("c.png", 2.0))
BOARD = PanelPicture("sum.png", 1.0)


@needs_parser
def test_worlds_of_plain_and_of_varied_looks_pass_the_parser(tmp_path):
    files = [tmp_path / "plain.sdf", tmp_path / "varied.sdf"]
    for file, appearance in zip(files, (PLAIN, varied_appearance(np.random.default_rng(0))), strict=True):
        stage = replace(STAGE, board="sum/1+2@inter", origin=(3.0, -2.0), yaw=0.3)
        file.write_text(document(world_of(stage, props_of(stage, PICTURES, BOARD, appearance), appearance)))
    assert "sdf" in check(files)


@needs_parser
def test_an_exported_track_and_a_model_to_spawn_pass_the_parser(track_folder, tmp_path):
    model = tmp_path / "model.sdf"
    model.write_text(document(prop_model(props_of(STAGE, PICTURES, None, PLAIN)[3], "file:///somewhere/")))
    check([track_folder / "stage_2.sdf", model])


@needs_parser
@pytest.mark.parametrize(
    ("right", "wrong"),
    [("<child>rotor_0</child>", "<child>rotor_9</child>"), ("<horizontal_fov>", "<horizontal_view>"), ("</world>", "")],
    ids=["no such link", "no such element", "cut short"],
)
def test_what_is_broken_does_not_pass(track_folder, tmp_path, right, wrong):
    text = (track_folder / "stage_1.sdf").read_text()
    broken = tmp_path / "broken.sdf"
    broken.write_text(text.replace(right, wrong).replace(right.replace("<", "</"), wrong.replace("<", "</")))
    with pytest.raises(GazeboError, match=r"broken\.sdf does not pass"):
        check([broken])


def test_the_command_says_what_is_missing(tmp_path, capsys, monkeypatch):
    if find_checker() is not None:
        with pytest.raises(SystemExit):
            main(["gazebo", "check", str(tmp_path / "none.sdf")])
        assert "there is no SDF file" in capsys.readouterr().err
    monkeypatch.setattr(checking, "LIBRARIES", ())
    monkeypatch.setattr(checking, "COMMANDS", ())
    with pytest.raises(SystemExit, match=r"^2$"):
        main(["gazebo", "check", str(tmp_path / "none.sdf")])
    assert f"apt-get install {PACKAGE}" in capsys.readouterr().err
