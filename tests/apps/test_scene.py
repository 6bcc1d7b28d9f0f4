"""What is flown at and how it is judged: the scene that holds what is asked, hovering in doubt, "you judge"."""

from __future__ import annotations

import io
import json
import os
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from rich.console import Console

pytest.importorskip("pymavlink")
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "vehicles"))

from app_fakes import Eager, camera
from peer import playing

from cognitivedrone.apps.config import FlyPlan, SimPlan
from cognitivedrone.apps.fly import fly_mission
from cognitivedrone.apps.scene import choose_scene
from cognitivedrone.apps.vehicle import serve_vehicle
from cognitivedrone.cli import main
from cognitivedrone.errors import LabelError, LinkError, TaskError
from cognitivedrone.tasks import load_suite, write_tasks

EPISODE = 4
"""Of the smoke suite: the shortest flight."""
SMOKE = load_suite("open-v1:smoke")


def quiet() -> Console:
    return Console(file=io.StringIO(), width=100)


def chosen(words: str, **options: object) -> tuple[str, int, str]:
    scene = choose_scene(FlyPlan.of(instruction=words, **options))
    return scene.suite.name, scene.episode, scene.told


def test_without_a_word_the_packaged_pilot_flies_a_scene_that_it_is_sure_of(tmp_path):
    console = quiet()
    summary = fly_mission(FlyPlan.of(out=tmp_path / "f"), console=console, keyboard=io.StringIO())
    assert (summary.ending.kind, summary.exit_code) == ("passed", 0), summary.ending.reason
    assert "scene: episode 27 of open-v1:smoke, with helicopter, sailboat and car" in console.file.getvalue()
    assert "hold" not in events(tmp_path / "f")


def test_an_own_instruction_gets_a_scene_that_holds_it():
    suite, episode, told = chosen("Fly through the gate with the bird")
    task = load_suite(suite).tracks[episode][0]
    assert any(bird in task.options for bird in ("eagle", "dove", "owl", "duck", "swan", "parrot", "flamingo", "chick"))
    assert told.startswith(f"scene: episode {episode} of {suite}, with {task.options[0].replace('_', ' ')}, ")
    assert "chosen because 'bird' fits gate" in told
    assert chosen("Fly through the gate with the bird")[1] == episode


def test_what_the_test_suite_does_not_show_is_made():
    scene = choose_scene(FlyPlan.of(instruction="Fly through the gate with the police car", seed=3))
    (task,) = scene.track
    assert task.options[task.target] == "police_car"
    assert task.instruction == "Fly through the gate with the police car"  # so that it is judged
    assert "made because no task of open-v1:test shows all of it" in scene.told
    assert scene.track == choose_scene(FlyPlan.of(instruction="Fly through the gate with the police car", seed=3)).track


def test_who_is_shown_in_training_alone_is_looked_for_there():
    suite, episode, _ = chosen("somebody with a red hat and a beard", seed=3)
    assert suite == "open-v1:train"
    labels = load_suite(suite, size=2000, seed=3).tracks[episode][0].labels
    # Red is what a hat is where its colour is not named.
    assert any("hat=hat" in label and "hat_color" not in label and "beard=full" in label for label in labels)


def test_a_calculation_gets_a_scene_with_its_result():
    suite, episode, told = chosen("Fly to the answer to 3 + 4")
    assert "7" in load_suite(suite).tracks[episode][0].options
    assert "'number' and '7' fit gate" in told


def test_where_nothing_holds_it_that_is_said():
    suite, episode, told = chosen("Fly through the gate with the unicorn")
    assert (suite, episode) == ("open-v1:smoke", 0)
    assert told.startswith(
        "no scene was found that shows what 'Fly through the gate with the unicorn' asks for; scene:"
    )


def test_what_is_named_is_flown_whatever_is_asked():
    assert chosen("the bird", episode=3)[:2] == ("open-v1:smoke", 3)
    assert chosen("", episode=0)[:2] == ("open-v1:smoke", 0)
    for named in ("open-v1:test", "open-v1:smoke"):
        assert chosen("", suite=named)[:2] == (named, 0)
    suite, episode, _ = chosen("Fly to a koala", suite="open-v1:smoke")
    assert "koala" in load_suite(suite).tracks[episode][0].options
    with pytest.raises(TaskError, match="has episodes 0 to 29, not 99"):
        chosen("the bird", episode=99)


def test_tasks_and_labels_of_ones_own_are_flown(tmp_path):
    for name in ("alpha", "beta", "gamma"):
        (tmp_path / "Mine").mkdir(exist_ok=True)
        Image.new("RGB", (64, 64), (10, 200, 30)).save(tmp_path / "Mine" / f"{name}.png")
    task = _published("Go to beta", ["alpha", "beta", "gamma"])
    (tmp_path / "Mine.json").write_text(json.dumps([task]))
    config = FlyPlan.of(
        instruction="Go to beta", tasks=tmp_path / "Mine.json", labels=tmp_path, policy="hover", reasoner="none",
        out=tmp_path / "f", time_limit=0.2,
    )  # fmt: skip
    console = quiet()
    fly_mission(config, console=console, keyboard=io.StringIO())
    assert "with alpha, beta and gamma from left to right" in console.file.getvalue()
    assert "'beta' fits gate 2, beta" in console.file.getvalue()
    about = json.loads((tmp_path / "f" / "flight.json").read_text())
    assert about["scene"]["suite"] == "Mine.json"
    with pytest.raises(LabelError, match="Mine/alpha"):
        fly_mission(FlyPlan.of(tasks=tmp_path / "Mine.json", policy="hover", reasoner="none", out=tmp_path / "g"),
                    console=quiet(), keyboard=io.StringIO())  # fmt: skip
    served = []
    sim = SimPlan.of(mavlink=True, tasks=tmp_path / "Mine.json", labels=tmp_path, links=("udpin:127.0.0.1:0",))
    serve_vehicle(sim, lambda: True, served.append)
    assert served[0].task.instruction == "Go to beta"


def _published(prompt: str, options: list[str]) -> dict[str, object]:
    gates = {str(n): {"size": "big", "shape": "round", "color": color} for n, color in zip((1, 2, 3), ("red", "green", "blue"), strict=True)}  # noqa: E501  # fmt: skip
    return {
        "prompt": prompt, "prompt_simpler": "Fly through the big green round gate", "options": options, "correct": 2,
        "gates": gates, "background": "room", "category": "symbol_understanding", "family": "mine",
        "labels": [f"Mine/{option}" for option in options],
    }  # fmt: skip


def sent(out: Path) -> np.ndarray:
    steps = pq.read_table(out / "steps.parquet").to_pydict()
    return np.array([steps[f"sent_{name}"] for name in ("vx_m_s", "vy_m_s", "vz_m_s", "yaw_rate_rad_s")]).T


def events(out: Path) -> dict[str, dict[str, object]]:
    """The last event of each kind."""
    return {event["kind"]: event for event in pq.read_table(out / "events.parquet").to_pylist()}


def test_in_doubt_it_hovers_until_the_time_is_over_and_says_so(tmp_path):
    console = quiet()
    config = FlyPlan.of(
        instruction="to the bird", policy="app_fakes:Eager", reasoner="app_fakes:Doubtful", out=tmp_path / "f",
        time_limit=1.6, suite="open-v1:smoke", episode=0,
    )  # fmt: skip
    summary = fly_mission(config, console=console, keyboard=io.StringIO())
    assert (summary.ending.kind, summary.exit_code) == ("unsure", 1)
    assert summary.ending.reason == (
        "the time limit of 1.6 s is over; it hovered, only 20% sure that the scene shows what is asked for"
    )
    begun = events(tmp_path / "f")["hold"]
    assert begun["text"] == "hovering, 20% sure that the scene shows what is asked for"
    assert f"hold      {begun['text']}" in console.file.getvalue()
    times = pq.read_table(tmp_path / "f" / "steps.parquet").to_pydict()["time_s"]
    speeds = np.abs(sent(tmp_path / "f")).max(axis=1)
    held = np.array(times) >= begun["time_s"]
    assert held.sum() > 5
    assert (speeds[held] == 0).all()
    assert (speeds[: held.argmax() - 1] > 0).all()


def test_another_instruction_ends_the_hovering(tmp_path, monkeypatch):
    reading, writing = os.pipe()
    monkeypatch.setattr(Eager, "keyboard", writing)
    monkeypatch.setattr(Eager, "lines", {14: b"to the cat\n"})
    config = FlyPlan.of(
        instruction="to the bird", policy="app_fakes:Eager", reasoner="app_fakes:Doubtful", out=tmp_path / "f",
        time_limit=2.5, suite="open-v1:smoke", episode=0,
    )  # fmt: skip
    with os.fdopen(reading) as keyboard:
        summary = fly_mission(config, console=quiet(), keyboard=keyboard)
    os.close(writing)
    assert summary.ending.kind == "missed"
    told = events(tmp_path / "f")
    assert told["hold"]["time_s"] < told["leg"]["time_s"] < told["sure"]["time_s"] + 0.1
    assert told["sure"]["text"].startswith("flying on")
    assert np.abs(sent(tmp_path / "f"))[-5:, 0].min() > 0


def test_on_a_vehicle_doubt_is_zero_velocity_as_well(tmp_path):
    with playing() as peer, camera() as url:
        config = FlyPlan.of(
            instruction="to the bird", link=f"mavlink:udpout:127.0.0.1:{peer.port}", camera=url, out=tmp_path / "f",
            time_limit=1.6,
            policy="app_fakes:Eager", reasoner="app_fakes:Doubtful", i_understand_this_flies_a_real_drone=True,
        )  # fmt: skip
        summary = fly_mission(config, console=quiet(), keyboard=io.StringIO("arm\n"))
    assert (summary.ending.kind, summary.exit_code) == ("unsure", 1)
    assert (sent(tmp_path / "f")[-5:] == 0).all()


def test_never_hovering_is_an_option(tmp_path):
    config = FlyPlan.of(
        instruction="to the bird", policy="app_fakes:Eager", reasoner="app_fakes:Doubtful", out=tmp_path / "f",
        time_limit=1.6, episode=0, hold_below=0.0,
    )  # fmt: skip
    assert fly_mission(config, console=quiet(), keyboard=io.StringIO()).ending.kind == "missed"
    assert "hold" not in events(tmp_path / "f")
    with pytest.raises(LinkError, match="--hold-below is 2"):
        FlyPlan.of(hold_below=2)


def flown(capsys: pytest.CaptureFixture[str], out: Path, *words: str) -> tuple[int, str]:
    arguments = ["--policy", "colour_seeker", "--reasoner", "oracle", "--episode", str(EPISODE), "--out", str(out)]
    with pytest.raises(SystemExit) as end:
        main(["fly", *words, *arguments])
    return int(end.value.code or 0), capsys.readouterr().out


def test_a_flight_that_nobody_can_judge_says_so(tmp_path, capsys):
    code, said = flown(capsys, tmp_path / "f", "Fly wherever you like")
    task = SMOKE.tracks[EPISODE][0]
    assert code == 0
    assert f"ended  flew through gate {task.target + 1} ({task.options[task.target]}; you judge), after" in said
    assert f"film{tmp_path}/f/flight.mp4" in "".join(said.split())
    assert "passed" not in said
    assert json.loads((tmp_path / "f" / "flight.json").read_text())["end"]["ending"] == "flown"


def test_the_scenes_own_instruction_is_judged_also_when_it_is_typed(tmp_path, capsys):
    code, said = flown(capsys, tmp_path / "f", SMOKE.tracks[EPISODE][0].instruction.upper())
    assert code == 0
    assert "passed: through gate" in said


def test_task_files_are_taken_in_place_of_a_suite_by_the_old_name_too(tmp_path):
    write_tasks(tmp_path / "mine.json", [SMOKE.tracks[7][0]])
    for options in ({"tasks": tmp_path / "mine.json"}, {"suite": str(tmp_path / "mine.json")}):
        scene = choose_scene(FlyPlan.of(**options))
        assert scene.track[0].instruction == SMOKE.tracks[7][0].instruction
