"""Whole flights with a chat API behind a real socket: whatever it answers, the flight goes on and is told."""

import json
import time
import warnings

import pytest
from chat_server import Script, chat, serving

from cognitivedrone.benchmark import Plan, run
from cognitivedrone.errors import PolicyError
from cognitivedrone.tasks import load_suite

TASK = load_suite("open-v1:smoke").tracks[0][0]
RIGHT = TASK.gates[TASK.target]
ANSWER = f'{{"size": "{RIGHT.size}", "color": "{RIGHT.color}", "shape": "{RIGHT.shape}"}}'
pytestmark = pytest.mark.usefixtures("no_vlm_settings")


def flown(script, out, suite="open-v1:smoke", timeout=60.0, latency="none"):
    """The only episode, and the warnings that were said."""
    with serving(script) as url, warnings.catch_warnings(record=True) as expected:
        warnings.simplefilter("always")
        config = Plan.of(
            policy="colour_seeker", reasoner=f"vlm:{url},model=eye-7b,timeout={timeout}", suite=suite,
            workers=0, episodes=1, latency=latency, out=out, clips=0,
        )  # fmt: skip
        results = run(config, progress=False)
    return results.episodes[0], [str(warning.message) for warning in expected]


def test_a_good_answer_is_flown_by(tmp_path):
    script = Script(replies=[(200, chat(ANSWER))])
    episode, expected = flown(script, tmp_path, latency="reasoner=300ms")
    (stage,) = episode.stages
    assert stage.outcome == "passed"
    assert stage.directive == TASK.directive
    assert stage.reasoner.gate
    assert stage.reasoner.age_s > 0.3
    assert expected == []
    assert TASK.instruction in str(script.bodies[0]["messages"])


def slow(handler):
    time.sleep(0.25)
    handler.answer(200, chat(ANSWER))


@pytest.mark.parametrize(
    ("script", "fault"),
    [
        (Script(replies=[(200, chat(None, refusal="I'm sorry, but I can't help with flying drones."))]), "refusal"),
        (Script(behave=slow), "timeout"),
    ],
    ids=["refusal", "timeout"],
)
def test_the_flight_goes_on_and_every_fault_is_counted(script, fault, tmp_path):
    episode, expected = flown(script, tmp_path, timeout=0.1 if fault == "timeout" else 60.0)
    (stage,) = episode.stages
    assert stage.outcome in ("passed", "wrong_gate", "timeout", "missed", "collision", "out_of_bounds")
    assert stage.directive is None
    assert set(stage.reasoner.faults) == {fault}
    assert stage.reasoner.faults[fault] >= 3
    assert stage.reasoner.gate is False
    assert len(expected) == 1  # said once, however often it happens


def test_after_a_fault_the_last_good_directive_stays(tmp_path):
    script = Script(replies=[(200, chat(ANSWER)), (500, b"")])
    (stage,) = flown(script, tmp_path)[0].stages
    assert stage.outcome == "passed"
    assert stage.directive == TASK.directive
    assert stage.reasoner.answers == 1
    assert stage.reasoner.faults["http"] >= 2


@pytest.mark.parametrize(
    ("models", "says"),
    [((401, b"no"), "requires a key"), ((200, b'{"data": [{"id": "eye-3b"}]}'), "eye-3b")],
)
def test_a_wrong_key_or_model_stops_before_take_off(models, says, tmp_path):
    with pytest.raises(PolicyError, match=says):
        flown(Script(models=models), tmp_path / "run")
    assert not (tmp_path / "run").exists()


MISSION = load_suite("open-v3:missions").tracks[0]


def planning(plan):
    """A server that plans so, and names the right gate of the sub-goal that it is asked about."""

    def behave(handler):
        text = str(handler.script.bodies[-1]["messages"])
        stage = next((number for number in (0, 1) if f"sub-goal number {number}" in text), None)
        if stage is None:
            return handler.answer(200, chat(plan))
        gate = MISSION[stage].gates[MISSION[stage].target]
        handler.answer(200, chat(f'{{"size": "{gate.size}", "color": "{gate.color}", "shape": "{gate.shape}"}}'))
        return None

    return Script(behave=behave)


def test_a_mission_is_flown_by_the_models_own_plan(tmp_path):
    goals = [
        {"do": "fly", "what": f"sub-goal number {number}", "otherwise": "", "pad": "none", "never_through": ["green"]}
        for number in (0, 1)
    ]
    script = planning(json.dumps({"sub_goals": goals}))
    episode, _ = flown(script, tmp_path, "open-v3:missions")
    assert [stage.outcome for stage in episode.stages] == ["passed", "passed"]
    assert [stage.directive for stage in episode.stages] == [task.directive for task in MISSION]
    asked = [body for body in script.bodies if MISSION[0].mission in str(body["messages"])]
    assert asked == script.bodies[:1], "the mission is planned once, before take-off"


def test_a_mission_without_a_plan_is_not_flown_and_the_run_goes_on(tmp_path):
    script = planning('{"sub_goals": []}')
    episode, _ = flown(script, tmp_path, "open-v3:missions")
    assert [stage.outcome for stage in episode.stages] == ["policy_error", "not_reached"]
    assert episode.message == "the mission was not planned: the plan is empty; there is nothing to fly"
    assert len(script.bodies) == 2
