"""Missions cut into sub-goals by the VLM reasoner, against a real HTTP server that answers well and badly."""

import json
from collections.abc import Callable, Iterator

import pytest
from chat_server import Script, chat, serving

from cognitivedrone.control.planning import plans_with
from cognitivedrone.errors import ReasonerError
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.reasoners.prompt import PLAN_SCHEMA, plan_prompt, read_plan
from cognitivedrone.reasoners.vlm import Vlm
from cognitivedrone.types import SubGoal

MISSION = "first the cat, if there is a bus take it, otherwise the bicycle, and never through red, then land on blue"

pytestmark = pytest.mark.usefixtures("no_vlm_settings")


def fly(what: str, otherwise: str = "", avoid: tuple[str, ...] = ()) -> dict[str, object]:
    return {"do": "fly", "what": what, "otherwise": otherwise, "pad": "none", "never_through": list(avoid)}


def land(pad: str) -> dict[str, object]:
    return {"do": "land", "what": "", "otherwise": "", "pad": pad, "never_through": []}


def plan(*entries: object) -> str:
    return json.dumps({"sub_goals": entries})


GOOD_PLAN = plan(
    fly("Fly to the cat", avoid=("red",)), fly("Fly to the bus", "Fly to the bicycle", ("red",)), land("blue")
)
GOALS = (
    SubGoal("fly", "Fly to the cat", avoid=frozenset({"red"})),
    SubGoal(
        "if",
        "Fly to the bus",
        (SubGoal("fly", "Fly to the bus", avoid=frozenset({"red"})),),
        (SubGoal("fly", "Fly to the bicycle", avoid=frozenset({"red"})),),
        frozenset({"red"}),
    ),
    SubGoal("land", "Land on the blue pad"),
)


@pytest.fixture
def script() -> Script:
    return Script(replies=[(200, chat(GOOD_PLAN))])


@pytest.fixture
def vlm(script: Script) -> Iterator[Vlm]:
    with serving(script) as url:
        made = make_reasoner(f"vlm:{url},model=eye-7b,timeout=60")
        assert isinstance(made, Vlm)
        yield made
        made.close()


def test_a_mission_is_asked_for_by_its_sentence_and_a_strict_schema(script, vlm):
    assert vlm.plan(MISSION) == GOALS
    (body,) = script.bodies
    (message,) = body["messages"]
    assert MISSION in message["content"]
    asked = body["response_format"]["json_schema"]
    assert (asked["strict"], asked["schema"]) == (True, PLAN_SCHEMA)
    assert body["max_tokens"] >= 1000


def test_every_key_and_value_of_the_schema_is_explained_in_the_prompt():
    entry = PLAN_SCHEMA["properties"]["sub_goals"]["items"]
    for name, rule in entry["properties"].items():
        assert f'"{name}"' in plan_prompt()
        assert all(f'"{value}"' in plan_prompt() for value in rule.get("enum", ()))
    example = plan_prompt().partition("Example: ")[2].split("\n")
    assert [goal.kind for goal in read_plan(example[1])] == ["fly", "if", "land"]


def test_a_plan_is_read_in_a_code_block_after_thinking():
    text = f"<think>two gates {{maybe}}</think>```json\n{GOOD_PLAN}\n```"
    assert read_plan(text, "stop") == GOALS


def test_an_answer_that_is_no_plan_is_asked_for_again(script, vlm):
    script.replies = [(200, chat("I would fly to the cat first.")), (200, chat(GOOD_PLAN))]
    assert vlm.plan(MISSION) == GOALS
    assert [len(body["messages"]) for body in script.bodies] == [1, 3]


@pytest.mark.parametrize(
    ("reply", "says"),
    [
        (plan(), "the plan is empty"),
        ("no idea", "is not JSON"),
        ('{"goals": []}', "expected sub_goals"),
        ('{"sub_goals": "cat, dog"}', "expected sub_goals"),
        (plan(*[fly("Fly to the dog")] * 50), "has 50 sub-goals; at most 12"),
        (
            plan(fly("Fly to the dog"), land("roof")),
            "sub-goal 2 of the plan lands on 'roof'; pads are red, green, blue",
        ),
        (plan(fly("Fly to the dog", avoid=("purple",))), "avoids"),
        (plan(fly("Fly to the dog") | {"do": "shoot"}), "is to 'shoot'; a drone can fly and land"),
        (plan(fly("")), "does not say what to fly to"),
        (plan(fly("dog " * 100)), "expected one line of text"),
        (plan("Fly to the dog"), "expected do, never_through"),
        (plan({"do": "fly"}), "expected do, never_through"),
        (GOOD_PLAN[:60], "is not JSON"),
        ("[" * 3000, "is not JSON"),
    ],
)
def test_bad_plans_are_reported(script, vlm, reply, says):
    script.replies = [(200, chat(reply))]
    with pytest.raises(ReasonerError, match=says):
        vlm.plan(MISSION)
    assert len(script.bodies) == 2, "asked once more, and then no longer"


def test_a_plan_that_was_cut_off_is_reported(script, vlm):
    script.replies = [(200, chat(GOOD_PLAN).replace(b'"stop"', b'"length"'))]
    with pytest.raises(ReasonerError, match="token limit"):
        vlm.plan(MISSION)


@pytest.mark.parametrize(
    ("reply", "says"),
    [
        (plan(land("red"), fly("Fly to the cat")), "goes on after the landing"),
        (plan(fly("Fly to the cat, then land on red")), "has 'land'"),
        (plan(fly("Fly to the cat"), land("blue")), "leaves out what is forbidden, red"),
        (plan(fly("Fly to the cat", avoid=("red",)), land("red")), "leaves out the landing"),
        (plan(fly("Fly through the red gate", avoid=("red",))), "asks for the red gate and forbids it"),
    ],
)
def test_a_plan_that_cannot_be_flown_is_reported_before_take_off(script, vlm, reply, says):
    script.replies = [(200, chat(reply))]
    with pytest.raises(ReasonerError, match=f"the reasoner's plan {says}"):
        plans_with(vlm, MISSION)


def test_the_plan_is_asked_for_once_and_other_sentences_are_cut_by_their_words(script, vlm):
    plans: Callable[[str], tuple[SubGoal, ...]] = plans_with(vlm, MISSION)
    assert plans(MISSION) == plans(MISSION) == GOALS
    assert [goal.instruction for goal in plans("first the dog, then land")] == ["Fly to the dog", "Land on the pad"]
    assert len(script.bodies) == 1


def test_what_a_plan_cannot_say_is_taken_from_the_words(script, vlm):
    script.replies = [(200, chat(plan(fly("Fly to the cat"), fly("Fly to the bus"))))]
    said = "first the cat, then the bus, never through the dog, no round gates"
    assert [goal.avoid for goal in plans_with(vlm, said)(said)] == [{"Fly to the dog", "round"}] * 2
    said = "if there is a dog fly to it, otherwise land"
    assert [goal.otherwise for goal in plans_with(vlm, said)(said)] == [(SubGoal("land", "Land on the pad"),)]
    assert len(script.bodies) == 1
