"""What is flown at and how it is judged: the scene that holds what is asked, hovering in doubt, "you judge"."""

import io
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from app_fakes import Eager, camera, events_of, flown, quiet, steps_of
from peer import playing
from PIL import Image

from cognitivedrone.apps.config import FlyPlan, SimPlan
from cognitivedrone.apps.orders import Orders
from cognitivedrone.apps.understanding.scene import choose_scene
from cognitivedrone.apps.vehicle import leading, serve_vehicle
from cognitivedrone.cli import main
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner
from cognitivedrone.errors import LabelError, NotUnderstood, TaskError
from cognitivedrone.film.movie import END_S, FPS, read_mp4
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import load_suite, write_tasks
from cognitivedrone.types import CONTROL_HZ, Task
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig
from cognitivedrone.world.geometry import gate_centers, gate_yaws

EPISODE = 4
"""Of the smoke suite: the shortest flight."""
SMOKE = load_suite("open-v1:smoke")


def made(words: str, **options: object) -> tuple[Task, str, str]:
    """The task of the scene for an instruction, what the user is told, and what it is to show."""
    scene = choose_scene(FlyPlan.of(film=False, instruction=words, **options))
    return scene.track[0], scene.summary, scene.summary.rpartition("it is to show ")[2]


def test_without_a_word_the_packaged_pilot_flies_a_scene_that_it_is_sure_of(tmp_path):
    console = quiet()
    summary = flown(console=console, pace="lockstep", out=tmp_path / "f")
    assert (summary.ending.kind, summary.exit_code) == ("passed", 0), summary.ending.reason
    assert "scene: episode 27 of open-v1:smoke, with helicopter, sailboat and car" in console.file.getvalue()
    assert "hold" not in events(tmp_path / "f")


def test_an_own_instruction_gets_a_scene_that_holds_it():
    task, summary, shown = made("Fly through the gate with the bird", seed=3)
    birds = {"eagle", "dove", "owl", "duck", "swan", "parrot", "flamingo", "chick", "chicken", "rooster", "peacock", "penguin", "turkey"}  # noqa: E501  # fmt: skip
    assert [option in birds for option in task.options].index(True) == task.target
    assert sum(option in birds for option in task.options) == 1
    right = task.options[task.target]
    assert summary.startswith(f"scene: a scene made for this flight, with {task.options[0].replace('_', ' ')}, ")
    assert shown == f"the gate with the {right}"
    assert task.instruction == "Fly through the gate with the bird"  # word for word
    assert made("Fly through the gate with the bird", seed=3)[0] == task


def test_what_is_refused_is_shown_beside_what_is_meant():
    task, _, shown = made("not the dog, the horse")
    assert task.options[task.target] == "horse"
    assert "dog" in task.options
    assert shown == "the gate with the horse"
    task, *_ = made("Would you kindly avoid the red gate and choose the fruit that monkeys love?")
    assert (task.options[task.target], task.gates[task.target].color == "red") == ("banana", False)
    task, _, shown = made("anything but the banana")
    assert [option == "banana" for option in task.options] == [gate != task.target for gate in range(3)]
    assert shown == "the gate that does not show the banana"


@pytest.mark.parametrize(
    "words", ["not the red one", "anything but blue", "neither red nor blue", "not the round gate"]
)
def test_of_a_look_that_is_refused_another_is_shown(words):
    task, _, shown = made(words)
    gate = task.gates[task.target or 0]
    assert shown == f"the {gate.color} gate"
    assert not {gate.color, gate.shape} & set(words.split())


@pytest.mark.parametrize("words", ["anything that is not an animal", "no animals please", "anything but food"])
def test_where_a_whole_kind_is_refused_another_is_shown(words):
    task, _, _ = made(words)
    kinds = [label.partition("/")[0] for label in task.labels]
    assert kinds.count(kinds[task.target or 0]) == 1


def test_a_gate_is_placed_and_looks_as_asked():
    task, _, shown = made("the big blue round one pls")
    gate = task.gates[task.target]
    assert (gate.size, gate.color, gate.shape) == ("big", "blue", "round")
    assert shown == "the big blue round gate"
    assert made("the left gate")[0].target == 0
    task, *_ = made("the red gate with the dog on it")
    assert (task.options[task.target], task.gates[task.target].color) == ("dog", "red")


def test_people_have_what_is_asked_for():
    task, *_ = made("somebody with a red hat and a beard", seed=3)
    fits = ["hat=hat" in label and "hat_color" not in label and "beard=full" in label for label in task.labels]
    assert fits == [gate == task.target for gate in range(3)]
    task, *_ = made("the man without a moustache")
    assert ["beard=moustache" not in label for label in task.labels] == [gate == task.target for gate in range(3)]
    assert made("fly to Boris")[0].options.count("Boris") == 1


def test_what_is_not_understood_is_reported_with_the_nearest_there_is_and_nothing_is_flown(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main(["fly", "fly through the gate with the unicron", "--out", str(tmp_path / "f")])
    assert end.value.code == 3
    output = " ".join(capsys.readouterr().err.split())
    assert "not understood: 'unicron'; " in output
    assert not (tmp_path / "f").exists()
    with pytest.raises(NotUnderstood, match="'fly' names nothing that a gate could show"):
        made("fly")
    with pytest.raises(NotUnderstood, match="no scene of open-v1:smoke shows what 'the unicorn' asks for"):
        made("the unicorn", suite="open-v1:smoke")


def test_at_a_terminal_it_is_asked_again(tmp_path):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    console = quiet()
    asked: dict[str, Any] = {"instruction": "glorp", "policy": "hover", "reasoner": "none", "pace": "lockstep"}
    keyboard = Terminal("the frobnitz\nthe dog\n")
    flown(console=console, keyboard=keyboard, **asked, out=tmp_path / "f", time_limit=0.2)
    assert console.file.getvalue().count("say it in other words; an empty line ends:") == 2
    assert "it is to show the gate with the dog" in " ".join(console.file.getvalue().split())
    with pytest.raises(NotUnderstood, match="'glorp'"):
        flown(keyboard=Terminal("\n"), **asked, out=tmp_path / "g")


def test_the_pictures_of_a_folder_are_shown(tmp_path):
    for file in ("birds/robin.png", "birds/robin_2.png", "birds/blue-tit.png", "colleagues/Ada Lovelace.png"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        Image.new("RGB", (64, 64), (10, 200, 30)).save(tmp_path / file)
    labels = str(tmp_path)
    task, _, shown = made("Fly to the robin", labels=labels)
    assert task.labels[task.target] in ("birds/robin", "birds/robin_2")
    assert sum("robin" in label for label in task.labels) == 1
    assert set(task.labels) <= {"birds/robin", "birds/robin_2", "birds/blue-tit", "colleagues/ada lovelace"}
    assert shown == "the gate with the robin"
    assert made("Fly to ada lovelace", labels=labels)[0].options.count("ada lovelace") == 1
    assert {label.partition("/")[0] for label in made("", labels=labels)[0].labels} <= {"birds", "colleagues"}
    assert made("Fly to the elephant", labels=labels)[0].options.count("elephant") == 1


def test_a_made_scene_is_flown_by_the_words_as_they_were_typed(tmp_path):
    summary = flown(pace="lockstep", instruction="coud you fly to the elephant :)", out=tmp_path / "f")
    segments = [each["text"] for each in events_of(tmp_path / "f") if each["kind"] == "segment"]
    assert segments == ["coud you fly to the elephant :)"]
    assert (summary.ending.kind, summary.exit_code) == ("passed", 0), summary.ending.reason
    assert "elephant" in summary.track[0].labels[summary.results[0].chosen]


class Said(Orders):
    """A line that is typed at the tenth step."""

    line, steps = "glorp the frobnitz", 0

    @property
    def given(self) -> tuple[int, str]:
        self.steps += 1
        if self.steps == 10:
            self.say(self.line)
        return super().given


def test_what_is_not_understood_in_flight_is_declined_within_three_seconds(tmp_path):
    summary = flown(pace="lockstep", orders=Said(), instruction="the elephant", out=tmp_path / "f")
    assert "'glorp the frobnitz' was not understood" in summary.ending.reason
    assert summary.results[0].outcome == "false_alarm"
    assert summary.seconds < 1.0 + 3.3


def test_what_is_named_is_flown_whatever_is_asked():
    def chosen(words: str, **options: object) -> tuple[str, int]:
        scene = choose_scene(FlyPlan.of(film=False, instruction=words, **options))
        return scene.suite.name, scene.episode

    assert chosen("the bird", episode=3) == ("open-v1:smoke", 3)
    assert chosen("", episode=0) == ("open-v1:smoke", 0)
    for named in ("open-v1:test", "open-v1:smoke"):
        assert chosen("", suite=named) == (named, 0)
    suite, episode = chosen("Fly to a koala", suite="open-v1:smoke")
    assert "koala" in load_suite(suite).tracks[episode][0].options
    with pytest.raises(TaskError, match="has episodes 0 to 29, not 99"):
        chosen("the bird", episode=99)


def test_tasks_and_labels_of_ones_own_are_flown(tmp_path):
    for name in ("alpha", "beta", "gamma"):
        (tmp_path / "Mine").mkdir(exist_ok=True)
        Image.new("RGB", (64, 64), (10, 200, 30)).save(tmp_path / "Mine" / f"{name}.png")
    task = _published("Go to beta", ["alpha", "beta", "gamma"])
    (tmp_path / "Mine.json").write_text(json.dumps([task]))
    console, tasks = quiet(), {"tasks": tmp_path / "Mine.json", "policy": "hover", "reasoner": "none"}
    flown(
        console=console, pace="lockstep", instruction="Go to beta", **tasks, labels=tmp_path, out=tmp_path / "f",
        time_limit=0.2,
    )  # fmt: skip
    assert "with alpha, beta and gamma from left to right" in console.file.getvalue()
    assert "'beta' fits gate 2, beta" in console.file.getvalue()
    about = json.loads((tmp_path / "f" / "flight.json").read_text())
    assert about["scene"]["suite"] == "Mine.json"
    with pytest.raises(LabelError, match="Mine/alpha"):
        flown(**tasks, out=tmp_path / "g")
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


DOUBTFUL: dict[str, Any] = {"instruction": "to the bird", "policy": "app_fakes:Eager", "reasoner": "app_fakes:Doubtful"}


def sent(out: Path) -> np.ndarray:
    steps = steps_of(out)
    return np.array([steps[f"sent_{name}"] for name in ("vx_m_s", "vy_m_s", "vz_m_s", "yaw_rate_rad_s")]).T


def events(out: Path) -> dict[str, dict[str, object]]:
    """The last event of each kind."""
    return {event["kind"]: event for event in events_of(out)}


def test_in_doubt_it_looks_from_nearer_until_the_time_is_over_and_says_so(tmp_path):
    console = quiet()
    summary = flown(console=console, pace="lockstep", **DOUBTFUL, out=tmp_path / "f", time_limit=1.6, episode=0)
    assert (summary.ending.kind, summary.exit_code) == ("unsure", 1)
    assert summary.ending.reason == (
        "the time limit of 1.6 s is over; it was looking closer, 20% sure that the scene shows what is asked for"
    )
    begun = events(tmp_path / "f")["hold"]
    assert begun["text"] == "looking closer, 20% sure that the scene shows what is asked for"
    assert f"hold      {begun['text']}" in console.file.getvalue()
    times = steps_of(tmp_path / "f")["time_s"]
    held = np.array(times) >= begun["time_s"]
    assert held.sum() > 5
    assert (sent(tmp_path / "f")[held, 0] > 0.5).all()


def test_another_instruction_ends_the_look(tmp_path, monkeypatch):
    reading, writing = os.pipe()
    monkeypatch.setattr(Eager, "keyboard", writing)
    monkeypatch.setattr(Eager, "lines", {14: b"to the cat\n"})
    with os.fdopen(reading) as keyboard:
        summary = flown(keyboard=keyboard, **DOUBTFUL, out=tmp_path / "f", time_limit=4.0, episode=0)
    os.close(writing)
    assert summary.ending.kind == "missed"
    seen = events(tmp_path / "f")
    assert seen["hold"]["time_s"] < seen["segment"]["time_s"] < seen["sure"]["time_s"] + 0.1
    assert seen["sure"]["text"].startswith("looked closer")
    assert np.abs(sent(tmp_path / "f"))[-5:, 0].min() > 0


def test_on_a_vehicle_it_looks_closer_as_well(tmp_path):
    with playing() as peer, camera() as url:
        summary = flown(
            "arm\n", **DOUBTFUL, link=f"mavlink:udpout:127.0.0.1:{peer.port}", camera=url, out=tmp_path / "f",
            time_limit=1.6, i_understand_this_flies_a_real_drone=True,
        )  # fmt: skip
    assert (summary.ending.kind, summary.exit_code) == ("unsure", 1)
    assert "hold" in events(tmp_path / "f")


def test_a_flight_that_nobody_can_judge_says_so(tmp_path, capsys):
    words = ["Fly wherever you like", "--policy", "colour_seeker", "--reasoner", "oracle", "--episode", str(EPISODE)]
    with pytest.raises(SystemExit) as end:
        main(["fly", *words, "--out", str(tmp_path / "f")])
    output, task = capsys.readouterr().out, SMOKE.tracks[EPISODE][0]
    assert end.value.code == 0
    assert f"ended  flew through gate {task.target + 1} ({task.options[task.target]}; you judge), after" in output
    assert f"film{tmp_path}/f/flight.mp4" in "".join(output.split())
    page = (tmp_path / "f" / "flight.html").read_text()
    assert "Flown: you judge" in page
    assert "Fly wherever you like" in page
    shown = list(read_mp4(tmp_path / "f" / "flight.mp4"))
    seen = list(read_mp4(tmp_path / "f" / "camera.mp4"))
    times = steps_of(tmp_path / "f")["time_s"]
    assert len(seen) == len(times)
    assert len(shown) / FPS == pytest.approx(times[-1] - times[0] + 1 / CONTROL_HZ + END_S, abs=0.2)
    shrunk = np.asarray(Image.fromarray(seen[0]).resize((512, 512)), float)
    assert abs(shown[0][208:, :512] - shrunk)[60:].mean() < 8
    assert "passed" not in output
    assert json.loads((tmp_path / "f" / "flight.json").read_text())["end"]["ending"] == "flown"


def test_the_scenes_own_instruction_is_judged_also_when_it_is_typed(tmp_path):
    typed = SMOKE.tracks[EPISODE][0].instruction.upper()
    pilot = {"policy": "colour_seeker", "reasoner": "oracle"}
    summary = flown(pace="lockstep", instruction=typed, **pilot, episode=EPISODE, out=tmp_path / "f")
    assert (summary.ending.kind, summary.exit_code) == ("passed", 0)
    assert summary.ending.reason.startswith("through gate ")


def test_task_files_are_taken_in_place_of_a_suite_by_the_old_name_too(tmp_path):
    write_tasks(tmp_path / "mine.json", [SMOKE.tracks[7][0]])
    for options in ({"tasks": tmp_path / "mine.json"}, {"suite": str(tmp_path / "mine.json")}):
        scene = choose_scene(FlyPlan.of(film=False, **options))
        assert scene.track[0].instruction == SMOKE.tracks[7][0].instruction


MISSION = load_suite("open-v3:missions").tracks[5]
"""A gate, then a landing."""


def test_it_leads_through_a_mission_and_judges_nothing_else():
    simulator = Simulator(1, render=False)
    runner = TrackRunner(simulator.world(0), load_pack(), TrackConfig(time_limit_s=math.inf))
    runner.begin(MISSION, np.random.default_rng(0))
    with SimulatedVehicle(simulator, VehicleConfig(links=("tcpin:127.0.0.1:0",)), leading(runner)) as vehicle:
        vehicle.step(20)
        assert runner.index == 0, "it stands on the floor, which ends no stage"
        center, yaw = gate_centers(runner.stage)[2], float(gate_yaws(runner.stage)[2])
        for before_m in (-0.3, 0.05):
            assert runner.index == 0
            simulator.flight.reset(0, center + before_m * np.array([math.cos(yaw), math.sin(yaw), 0.0]), yaw)
            vehicle.step()
        assert runner.index == 1
        assert runner.stage.landing
        vehicle.step(500)
        assert vehicle.state().position[2] < 0.3
    simulator.close()
    assert not runner.finished, "the last stage goes on"
