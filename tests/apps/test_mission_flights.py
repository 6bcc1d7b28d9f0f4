"""`fly` as the benchmark scores it, and with a mission: a scene for each sub-goal, one after another, and a landing."""

import io
from contextlib import closing

import numpy as np
import pytest
from app_fakes import events_of, flown, steps_of
from rich.console import Console

from cognitivedrone.apps.orders import Orders
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.errors import NotUnderstood, ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.pilot import Pilot
from cognitivedrone.play.board import goals_table
from cognitivedrone.policies import make_policy
from cognitivedrone.tasks.directives import parse_directive
from cognitivedrone.tasks.missions import sub_goals
from cognitivedrone.types import SubGoal


def flying(sentence, out, **changes):
    return flown(pace="lockstep", instruction=sentence, out=out, **changes)


def test_a_mission_is_flown_part_after_part_and_lands_on_its_pad(tmp_path):
    sentence = "first the elephant, then the number 7, then land on the green pad"
    summary = flying(sentence, tmp_path / "out")
    assert summary.ending.kind == "passed"
    assert "landed on the green pad" in summary.ending.reason
    assert [result.outcome for result in summary.results] == ["passed"] * 3
    assert [task.mission for task in summary.track] == [sentence] * 3
    assert [task.landing for task in summary.track] == [False, False, True]


@pytest.mark.parametrize(
    ("sentence", "says"),
    [
        ("first the dog then the glorp", "of sub-goal 2, not understood: 'glorp'"),
        ("land", "names no gate to fly through and no pad"),
        ("if there is a bus take it, otherwise land on the roof", "'roof' is not understood"),
        ("first a dog, never through the dog", "all that fits is forbidden"),
        ("never through red", "understood up to 'never through red'"),
    ],
)
def test_what_cannot_be_flown_is_reported_before_take_off(tmp_path, sentence, says):
    with pytest.raises(NotUnderstood, match=says):
        flying(sentence, tmp_path / "out")
    assert not (tmp_path / "out").exists()


class Typed(Orders):
    """Sentences that are typed at certain steps."""

    def __init__(self, **lines):
        super().__init__()
        self.lines, self.steps = lines, 0

    @property
    def given(self) -> tuple[int, str]:
        self.steps += 1
        if line := self.lines.get(f"at_{self.steps}"):
            self.say(line)
        return super().given


def test_a_landing_that_is_typed_where_there_is_no_pad_ends_the_flight_there(tmp_path):
    summary = flying("the elephant", tmp_path / "out", orders=Typed(at_10="land on the red pad, please"))
    assert (summary.ending.kind, summary.exit_code) == ("ordered", 0)
    assert "there is no pad here" in summary.ending.reason
    assert summary.seconds < 1.5


@pytest.mark.parametrize(
    "corrections", [{"at_15": "no, the other one"}, {"at_12": "wrong one!", "at_24": "not that one"}]
)
def test_another_gate_is_flown_through_when_a_person_says_so(tmp_path, corrections):
    summary = flying("the pizza", tmp_path / "out", orders=Typed(**corrections), seed=3)
    (result,), (task,) = summary.results, summary.track
    assert (result.outcome, summary.ending.kind) == ("wrong_gate", "flown")
    assert "you judge" in summary.ending.reason
    given = steps_of(tmp_path / "out")["directive"]
    first, *others = dict.fromkeys(parse_directive(directive)[1] for directive in given if directive)
    assert first == task.gates[task.target].color
    assert len(others) >= len(corrections)  # nothing fits them well
    events = events_of(tmp_path / "out")
    kinds = [event["kind"] for event in events]
    assert kinds.count("segment") == 1
    assert kinds.count("corrected") == len(corrections)
    assert "hold" not in kinds
    assert task.gates[result.chosen].color in others[len(corrections) - 1 :]


def test_before_the_reasoner_has_answered_there_is_no_gate_to_correct(tmp_path):
    (result,) = flying("the elephant", tmp_path / "out", orders=Typed(at_1="no, the other one")).results
    assert result.outcome == "passed"
    events = events_of(tmp_path / "out")
    assert "corrected" not in [event["kind"] for event in events]
    said = {event["text"] for event in events if event["kind"] == "segment"}
    assert "no, the other one" not in said


def test_a_new_sentence_is_answered_at_once_by_what_was_seen_of_the_stage(tmp_path):
    """So the correction in the next step means the gate that it has just named."""
    orders = Typed(at_10="the elephant", at_11="no, the other one")
    assert flying("the elephant", tmp_path / "out", orders=orders).results[0].outcome == "wrong_gate"
    kinds = [event["kind"] for event in events_of(tmp_path / "out")]
    assert (kinds.count("segment"), kinds.count("corrected")) == (2, 1)
    assert "unsure" not in kinds


@pytest.mark.parametrize(
    "link",
    [{"link": "mavlink:udp:127.0.0.1:1", "camera": "http://127.0.0.1:1/"}, {"link": "sitl", "airframe": "iris"}],
)
def test_neither_a_real_vehicle_nor_ardupilot_in_the_loop_lands_on_pads(tmp_path, link):
    with pytest.raises(NotUnderstood, match="with --link sim only"):
        flying("the dog, then land on red", tmp_path / "out", **link)


class Planner(Reasoner):
    """Plans as it was told to, and names no gate."""

    def __init__(self, *goals):
        self.goals, self.asked = goals, []

    def plan(self, mission):
        if not self.goals:
            raise ReasonerError("schema", "the plan is empty; there is nothing to fly")
        return self.goals

    def refine(self, image, instruction):
        self.asked.append(instruction)
        raise ReasonerError("unsure", "it cannot tell")


def planned(sentence, out, *goals):
    """The flight, and the sentences that the reasoner was asked about."""
    reasoner = Planner(*goals)
    pilot = Pilot(make_policy("oracle"), reasoner)
    return flying(sentence, out, pilot=pilot, look="no", time_limit=30), reasoner.asked


def test_the_reasoners_own_plan_is_flown(tmp_path):
    goals = SubGoal("fly", "Fly to the grey giant"), SubGoal("land", "Land on the green pad")
    summary, asked = planned("first the elephant, then land on the green pad", tmp_path / "out", *goals)
    assert [result.outcome for result in summary.results] == ["passed", "passed"]
    assert set(asked) == {"Fly to the grey giant"}


def test_a_mission_without_a_plan_is_not_flown(tmp_path):
    with pytest.raises(NotUnderstood, match="the mission was not planned: the plan is empty"):
        planned("first the elephant, then land on the green pad", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_sentence_that_is_no_mission_is_not_planned(tmp_path):
    summary, asked = planned("the elephant", tmp_path / "out")
    assert summary.ending.kind == "passed"
    assert len(set(asked)) == 1


def test_the_page_lists_what_is_done_and_what_is_to_do():
    mission = "first the dog, then the cat, then land on red"
    shown = [["Fly to the dog", "done"], ["Fly to the cat", "doing"], ["Land on the red pad", "to do"]]
    assert goals_table(sub_goals(mission), 1) == shown


def test_the_plan_is_shown_as_understood_before_take_off(tmp_path):
    shown = Console(file=io.StringIO(), width=200)
    summary = flying("first the elephant, never through red", tmp_path / "out", time_limit=0.2, console=shown)
    assert "understood as: 1. Fly to the elephant, never through red" in shown.file.getvalue()
    assert summary.track[0].gates[summary.track[0].target].color != "red"


def test_a_mission_that_is_typed_in_flight_and_not_understood_is_not_flown(tmp_path):
    orders = Typed(at_10="first the dog, then the cat, never through red, green or blue")
    summary = flying("the elephant", tmp_path / "out", orders=orders, time_limit=3)
    assert "was not understood" in summary.ending.reason
    assert [result.outcome for result in summary.results if result.outcome == "passed"] == []


def test_of_a_condition_the_other_thing_is_flown_to_where_it_does_not_hold(tmp_path):
    summary = flying("if there is a bus take the dog, otherwise the owl", tmp_path / "out")
    (task,) = summary.track
    assert task.labels[task.target].startswith("animal/owl")
    assert not any("bus" in label for label in task.labels)
    assert [result.outcome for result in summary.results] == ["passed"]


@pytest.mark.parametrize(
    ("sentence", "passed"),
    [
        ("the elephant, then land on red if there is a cat, otherwise green", ["elephant", "green"]),
        ("if there is a dog, first the cat then the bird, otherwise first the bus, then the owl", ["bus", "owl"]),
    ],
)
def test_what_was_seen_decides_over_the_pad_and_over_all_that_follows(tmp_path, sentence, passed):
    summary = flying(sentence, tmp_path / "out")
    assert summary.ending.kind == "passed"
    assert summary.seconds < 30
    assert {result.outcome for result in summary.results} == {"passed"}
    shown = [task.gates[task.target].color if task.landing else task.options[task.target]
             for task in summary.track if task.target is not None]  # fmt: skip
    assert shown == passed


@pytest.mark.parametrize(
    ("sentence", "flown"),
    [
        ("if there is a zebra fly to it, otherwise land", None),
        ("wenn es einen Koala gibt, nimm die Krabbe, sonst den Schmetterling", "crab"),
        ("the animal, never through the koala", "crab butterfly"), ("an animal, never through square gates", "crab"),
        ("anything but the crab", "koala butterfly"),
    ],
)  # fmt: skip
def test_in_a_given_scene_conditions_and_prohibitions_hold(tmp_path, sentence, flown):
    summary = flying(sentence, tmp_path / "out", suite="open-v1:smoke", episode=1, time_limit=40)
    if flown is None:
        assert summary.ending.reason == "landed where it was, as the mission says"
        assert not summary.results
    else:
        (result,), (task,) = summary.results, summary.track
        assert task.options[result.chosen] in flown.split()


def test_without_a_reasoner_nobody_keeps_to_a_condition(tmp_path):
    with pytest.raises(NotUnderstood, match="only a reasoner keeps to a condition"):
        flying("first the elephant, never through red", tmp_path / "out", reasoner="none")
    assert not (tmp_path / "out").exists()


SURE, UNSURE = {"suite": "open-v1:smoke", "episode": 4}, {"suite": "open-v3:photos", "episode": 6}


@pytest.mark.parametrize("scene", [SURE, UNSURE])
def test_fly_and_bench_fly_the_same(tmp_path, scene):
    options = {"suite": scene["suite"], "appearance": "plain", "reasoner": "small", "seed": 3}
    with closing(PilotRunner(resolve(Plan.of(**options), named=False))) as runner:
        scored = runner.fly(scene["episode"], film=False)
    shown = flown(pace="lockstep", out=tmp_path / "f", episode=scene["episode"], time_limit=60.0, **options)
    steps = steps_of(tmp_path / "f")
    path = np.array([steps[axis] for axis in ("x_m", "y_m", "z_m")], np.float32).T
    assert np.array_equal(path, scored.trace.path[: len(path)])
    assert len(path) == len(scored.trace.path) - 1
    assert [(end.outcome, end.chosen, end.time_s) for end in shown.results] == [
        (end.outcome, end.chosen, end.time_s) for end in scored.result.stages
    ]
    assert any(event["kind"] == "hold" for event in events_of(tmp_path / "f")) == (scene is UNSURE)
