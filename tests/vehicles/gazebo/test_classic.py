"""The published collector's layout, made small here: pictures find their tasks, and what is wrong is said."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cognitivedrone.cli import main
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import read_tasks, suite_from_files
from cognitivedrone.vehicles.gazebo.worlds.classic import import_collector

COLORS = {"fox": (200, 90, 10), "owl": (90, 60, 40), "cheetah": (220, 180, 60), "healthy_1": (20, 160, 20)}
COLORS |= {"unhealthy_1": (160, 20, 20), "unhealthy_2": (90, 20, 160), "A": (0, 0, 0), "B": (0, 0, 90), "C": (0, 90, 0)}
COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <library_effects><effect id="e"><profile_COMMON>
    <newparam sid="s"><surface type="2D"><init_from>shown</init_from></surface></newparam>
  </profile_COMMON></effect></library_effects>
  <library_images>
    <image id="other"><init_from>somewhere_else.jpg</init_from></image>
    <image id="shown"><init_from>{picture}</init_from></image>
  </library_images>
</COLLADA>
"""


def panel(folder: Path, name: str, picture: str, *, stored: str | None = None, color: str | None = None) -> None:
    """A model called `name` that shows `picture`, which lies beside it as `stored`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.dae").write_text(COLLADA.format(picture=picture), encoding="utf-8")
    image = Image.new("RGB", (64, 48), COLORS[color or name])
    image.save(folder / (stored or picture), "PNG")


def task(options: list[str], prompt: str = "Fly through the gate with a fox", **more: object) -> dict[str, object]:
    gates = [("big", "round", "red"), ("small", "square", "green"), ("big", "triangle", "blue")]
    return {
        "prompt": prompt,
        "prompt_simpler": "Fly through the big round red gate",
        "options": options,
        "correct": 1,
        "gates": {
            str(number): dict(zip(("size", "shape", "color"), gate, strict=True))
            for number, gate in enumerate(gates, 1)
        },
        "background": "room",
        **more,
    }


@pytest.fixture
def collector(tmp_path) -> Path:
    """Three types in two categories, with the kinds of spelling that the published ones have."""
    root = tmp_path / "model_for_data_collection"
    animals, food, symbols = root / "Reasoning/Animals", root / "Reasoning/Food", root / "Symbol Understanding/Symbols"
    panel(animals, "fox", "fox.PNG")
    panel(animals, "owl", "Great%20Owl.jpeg", stored="great owl.png", color="owl")  # another case and suffix
    panel(animals, "cheetahdae", "cheetah.png", color="cheetah")
    panel(animals, "unasked", "fox.PNG", color="fox")
    for name in ("healthy_1", "unhealthy_1", "unhealthy_2"):
        panel(food / name.partition("_")[0].capitalize(), name, f"{name}.png")
    for name in "ABC":
        panel(symbols, name, f"{name}.png")
    (root / "Reasoning/Animals.json").write_text(json.dumps([task(["fox.dae", "owl.dae", "cheetah.dae"])] * 2))
    options = ["Healthy/healthy_1.dae", "Unhealthy/unhealthy_1.dae", "Unhealthy/unhealthy_2.dae"]
    (root / "Reasoning/Food.json").write_text(json.dumps([task(options, "Fly to the gate with healthy food")]))
    symbol = task(["A.dae", "B.dae", "C.dae"], "Fly through the gate with A")
    (root / "Symbol Understanding/Symbols.json").write_text(json.dumps([symbol]))
    (root / "config.json").write_text("{}")  # no task file: there is no folder of panels beside it
    return root


def test_tasks_and_pictures_find_each_other(collector, tmp_path):
    done = import_collector(collector, tmp_path / "out")
    assert done.counts == {"Animals": (2, 3), "Food": (1, 3), "Symbols": (1, 3)}
    names = sorted(path.relative_to(done.labels).as_posix() for path in done.labels.rglob("*.*"))
    assert names == [
        "Animals/cheetah.png", "Animals/fox.png", "Animals/owl.png", "Food/Healthy/healthy_1.png",
        "Food/Unhealthy/unhealthy_1.png", "Food/Unhealthy/unhealthy_2.png",
        "Symbols/A.png", "Symbols/B.png", "Symbols/C.png",
    ]  # fmt: skip
    tasks, pack = read_tasks(done.tasks), load_pack(str(done.labels))
    assert [task.id for task in tasks] == ["Animals/0000", "Animals/0001", "Food/0000", "Symbols/0000"]
    assert [(t.category, t.family) for t in tasks[1:]] == [
        ("symbol_understanding", "animals"), ("reasoning", "food"), ("symbol_understanding", "symbols")
    ]  # fmt: skip
    for one in tasks:
        for option, reference in zip(one.options, one.labels, strict=True):
            color = COLORS[Path(option).stem]
            np.testing.assert_array_equal(pack.image(reference)[0, 0], color)
    assert len(suite_from_files(done.tasks).tracks) == 4


def test_the_command_says_what_it_took_and_how_to_fly_it(collector, tmp_path, capsys):
    out = tmp_path / "out"
    main(["gazebo", "import", str(collector.parent), "--out", str(out)])
    output = capsys.readouterr().out
    assert "Animals: 2 tasks, 3 labels" in output
    assert f"bench --tasks {out / 'tasks.json'} --labels {out / 'labels'}" in output
    with pytest.raises(SystemExit) as stop:
        main(["gazebo", "import", str(collector), "--out", str(out)])
    assert stop.value.code == 2
    assert "is not an empty folder" in capsys.readouterr().err


def rewrite(root: Path, options: list[str]) -> None:
    (root / "Reasoning/Animals.json").write_text(json.dumps([task(options)]))


@pytest.mark.parametrize(
    ("breaking", "says"),
    [
        (lambda root: rewrite(root, ["foxx.dae", "owl.dae", "cheetah.dae"]),
         r"Animals\.json\[0\]: there is no panel foxx\.dae in .*did you mean 'fox'"),
        (lambda root: rewrite(root, ["../Food/fox.dae", "owl.dae", "cheetah.dae"]), "leads out of"),
        (lambda root: rewrite(root, ["fox.dae", "fox.dae", "cheetah.dae"]), "options 1 and 2 are both 'fox.dae'"),
        (lambda root: (root / "Reasoning/Animals.json").write_text("[{}]"), r"Animals\.json\[0\]: key 'prompt'"),
        (lambda root: (root / "Reasoning/Animals.json").write_text("[]"), "holds no tasks"),
        (lambda root: (root / "Reasoning/Animals.json").write_text("{"), "not JSON"),
        (lambda root: (root / "Reasoning/Animals/fox.PNG").unlink(), r"fox\.dae shows 'fox\.PNG', which is not beside"),
        (lambda root: (root / "Reasoning/Animals/fox.PNG").write_text("no"), r"fox\.PNG cannot be read as PNG"),
        (lambda root: (root / "Reasoning/Animals/fox.dae").write_text("<a"), r"fox\.dae: cannot be read as a COLLADA"),
        (lambda root: (root / "Reasoning/Animals/fox.dae").write_text("<a/>"), r"fox\.dae: shows no picture"),
        (lambda root: (root / "Symbol Understanding").rename(root / "Odd"), r"Symbols\.json\[0\]: no category"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_nothing_written(collector, tmp_path, breaking, says):
    breaking(collector)
    with pytest.raises(CognitiveDroneError, match=says) as reported:
        import_collector(collector, tmp_path / "out")
    assert "\n" not in str(reported.value)
    assert not (tmp_path / "out").exists()


def test_what_is_published_is_known_by_its_type_wherever_it_lies(collector, tmp_path):
    (collector / "Reasoning").rename(collector / "Odd")
    done = import_collector(collector, tmp_path / "out")
    assert {task.category for task in read_tasks(done.tasks) if task.id.startswith("Animals")} == {
        "symbol_understanding"
    }


def test_other_folders_are_no_collectors(collector, tmp_path):
    with pytest.raises(CognitiveDroneError, match="holds no task file beside a folder of panels"):
        import_collector(collector / "Reasoning" / "Animals", tmp_path / "out")
    with pytest.raises(CognitiveDroneError, match="is not a folder"):
        import_collector(tmp_path / "nowhere", tmp_path / "out")
    (collector / "Copy").mkdir()
    panel(collector / "Copy" / "animals", "fox", "fox.png")
    (collector / "Copy" / "animals.json").write_text("[]")
    with pytest.raises(CognitiveDroneError, match="have the same type"):
        import_collector(collector, tmp_path / "out")


@pytest.mark.parametrize("odd", ["Animals/fox.dae", "Animals/fox.PNG", "Animals.json"])
@pytest.mark.parametrize("kind", ["pipe", "device", "link"])
def test_what_is_no_file_is_not_waited_for(collector, tmp_path, odd, kind):
    path = collector / "Reasoning" / odd
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero" if kind == "device" else tmp_path / "nowhere")
    with pytest.raises(CognitiveDroneError) as reported:
        import_collector(collector, tmp_path / "out")
    assert "\n" not in str(reported.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "option", ["../Food/x.dae", "/etc/passwd", "..", ".", "a\x00b", "x" * 900, "x" * 900 + "/x", "a\nb"]
)
def test_no_option_leads_out_of_its_folder(collector, tmp_path, option):
    (collector / "Reasoning/Animals.json").write_text(json.dumps([task([option, "owl.dae", "fox.dae"])]))
    with pytest.raises(CognitiveDroneError) as reported:
        import_collector(collector, tmp_path / "out")
    assert "\n" not in str(reported.value)
    assert not (tmp_path / "out").exists()


def test_a_type_is_called_after_a_file_that_could_be_a_folder(collector, tmp_path):
    evil = collector / "Reasoning" / "Animals" / "...json"
    evil.write_text(json.dumps([task(["fox.dae", "owl.dae", "cheetah.dae"])]))
    with pytest.raises(CognitiveDroneError, match="a type has the name of its file"):
        import_collector(collector, tmp_path / "out")
    assert not (tmp_path / "out").exists()
