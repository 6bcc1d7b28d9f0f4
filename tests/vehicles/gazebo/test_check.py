"""libsdformat's own parser on what is exported, and on what is broken."""

from typing import Any, cast

import numpy as np
import pytest

from cognitivedrone.cli import main
from cognitivedrone.errors import GazeboError
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate, Stage
from cognitivedrone.vehicles.gazebo.worlds import export as checking
from cognitivedrone.vehicles.gazebo.worlds.export import PACKAGE, check, find_checker, world_of
from cognitivedrone.vehicles.gazebo.worlds.sdf import PanelPicture, document, prop_model, props_of
from cognitivedrone.world.appearance import PLAIN, varied_appearance

needs_parser = pytest.mark.skipif(
    find_checker() is None, reason=f"libsdformat is not on this machine: apt-get install {PACKAGE}"
)
VARIANTS = [Gate(size, shape, color) for size in SIZES for shape in SHAPES for color in COLORS]
PICTURES = (PanelPicture("a.png", 1.0), PanelPicture("b.png", 0.5), PanelPicture("c.png", 2.0))
BOARD = PanelPicture("sum.png", 1.0)


@needs_parser
def test_worlds_of_every_gate_variant_pass_the_parser(tmp_path):
    files = []
    for first in range(0, len(VARIANTS), 3):
        appearance = PLAIN if first % 2 else varied_appearance(np.random.default_rng(first))
        gates = tuple(VARIANTS[first : first + 3])
        stage = Stage(cast(Any, gates), ("letter/A@inter",) * 3, "sum/1+2@inter", (float(first), -2.0), 0.1 * first)
        files.append(tmp_path / f"{first}.sdf")
        files[-1].write_text(document(world_of(stage, props_of(stage, PICTURES, BOARD, appearance), appearance)))
    assert "sdf" in check(files)


@needs_parser
def test_an_exported_track_and_a_model_to_spawn_pass_the_parser(track_folder, tmp_path):
    stage = Stage((VARIANTS[0], VARIANTS[1], VARIANTS[2]), ("letter/A@inter",) * 3)
    model = tmp_path / "model.sdf"
    model.write_text(document(prop_model(props_of(stage, PICTURES, None, PLAIN)[3], "file:///somewhere/")))
    check([track_folder / "stage_2.sdf", model])


@needs_parser
@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("<child>rotor_0</child>", "<child>rotor_9</child>"),
        ("<horizontal_fov>", "<horizontal_view>"),
        ("</world>", ""),
    ],
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
