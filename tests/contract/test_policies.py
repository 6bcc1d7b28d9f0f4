"""Every policy and reasoner of the package keeps the interface's word."""

import json
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from openvla_files import write_checkpoint

from cognitivedrone import registry
from cognitivedrone.control.calls import begin_stage
from cognitivedrone.errors import PolicyError
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.interfaces import Policy, Reasoner
from cognitivedrone.policies import POLICIES, make_policy
from cognitivedrone.reasoners import REASONERS, make_reasoner
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.tasks import task_to_json
from cognitivedrone.types import (
    ACTION_LIMITS,
    DroneState,
    EpisodeContext,
    Gate,
    GroundTruth,
    Guidance,
    Observation,
    Stage,
    Task,
)

GATES = (Gate("small", "round", "red"), Gate("big", "square", "green"), Gate("small", "triangle", "blue"))
LABELS = ("letter/A@inter", "letter/B@inter", "letter/C@inter")
TASK = Task(
    id="contract/0",
    category="symbol_understanding",
    family="letters",
    instruction="Fly through the gate with the letter A",
    directive="Fly through the small red round gate",
    options=("A", "B", "C"),
    labels=LABELS,
    target=0,
    gates=GATES,
)
STATE = DroneState(np.array([-1.0, 0.3, 0.8]), np.zeros(3), quaternion_from_yaw(0.1), np.zeros(3))
TRUTH = GroundTruth(TASK, Stage(GATES, LABELS), lambda: STATE)
CONTEXT = EpisodeContext(TASK.instruction, seed=7, stage=0, ground_truth=TRUTH)
LATER = replace(CONTEXT, stage=1)
DRAWING = ["colour_seeker", "random"]


def noise(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (256, 256, 3)).astype(np.uint8)


def observation(image, time=0.0):
    return Observation(image, TASK.instruction, np.zeros(3, np.float32), 0.8, 0.0, time)


OPEN: list[Policy] = []


@pytest.fixture(autouse=True)
def closing():
    yield
    while OPEN:
        OPEN.pop().close()


def prepared(name):
    policy = make_policy(name)
    OPEN.append(policy)
    policy.check()
    begin_stage(policy, CONTEXT)
    return policy


@pytest.fixture(scope="session")
def tiny_openvla(tmp_path_factory):
    return write_checkpoint(tmp_path_factory.mktemp("openvla"))


@pytest.fixture(scope="session")
def server(tiny_model_file):
    serving = pytest.importorskip("cognitivedrone.serving.server", exc_type=ImportError).serving
    with serving(ServePlan.of(policy=f"small:{tiny_model_file}", port=0)) as address:
        yield address


@pytest.fixture(scope="session")
def tiny_act(tmp_path_factory):
    pytest.importorskip("lerobot", reason="lerobot is not installed (docs/gymnasium.md)")
    from lerobot_checkpoints import save_act

    return save_act(tmp_path_factory.mktemp("act"))


ALONE = [name for name in POLICIES if name not in ("openvla", "lerobot", "remote")]


@pytest.fixture(
    params=[*ALONE, "small:FILE", "openvla:FOLDER,device=cpu", "lerobot:ACT,device=cpu", "remote:ws://SERVER"]
)
def name(request):
    """Every policy of the package, models of one's own, and one on a server."""
    places = {"FILE": "tiny_model_file", "FOLDER": "tiny_openvla", "ACT": "tiny_act", "SERVER": "server"}
    text = request.param
    for word, fixture in places.items():
        if word in text:
            text = text.replace(word, str(request.getfixturevalue(fixture)))
    return text


class TestPolicy:
    @pytest.mark.parametrize("image", [np.zeros((256, 256, 3), np.uint8), noise()], ids=["black", "noise"])
    def test_it_answers_with_finite_commands_whatever_it_sees(self, name, image):
        policy = prepared(name)
        for step in range(3):
            chunk = policy.act(observation(image, step / 10))
            assert chunk.ndim == 2
            assert chunk.shape[1] == 4
            assert chunk.dtype == np.float32
            assert np.isfinite(chunk).all()
            assert (np.abs(chunk) <= np.array(ACTION_LIMITS) * 2).all()

    def test_the_same_seed_and_frames_give_the_same_commands(self, name):
        first, second = prepared(name), prepared(name)
        for step in range(4):
            seen = observation(noise(step), step / 10)
            assert np.array_equal(first.act(seen), second.act(seen))

    def test_reset_forgets(self, name):
        policy = prepared(name)
        begin = policy.act(observation(noise()))
        for step in range(1, 4):
            policy.act(observation(noise(step), step / 10))
        begin_stage(policy, CONTEXT)
        assert np.array_equal(policy.act(observation(noise())), begin)

    def test_it_is_a_policy_that_closes(self, name):
        policy = prepared(name)
        assert isinstance(policy, Policy)
        policy.close()

    def test_it_leaves_the_frame_as_it_was(self, name):
        image = noise()
        prepared(name).act(observation(image))
        assert np.array_equal(image, noise())


@pytest.mark.parametrize("name", DRAWING)
def test_a_new_flight_draws_from_its_seed_and_a_later_stage_draws_on(name):
    policy = make_policy(name)
    image = np.zeros((256, 256, 3), np.uint8)
    for channel in range(3):
        left = 20 + 80 * channel
        image[105:150, left : left + 45, channel] = 250
        image[110:145, left + 5 : left + 40] = 0
    seen = [replace(observation(image), instruction=f"a sentence that names no gate, {n}") for n in range(20)]

    def drawn(context):
        begin_stage(policy, context)
        return [policy.act(each).tolist() for each in seen]

    first, later, other = drawn(CONTEXT), drawn(LATER), drawn(replace(CONTEXT, seed=8))
    assert drawn(CONTEXT) == first
    assert drawn(LATER) == later
    assert first not in (later, other)


@pytest.fixture
def answers(tmp_path):
    file = tmp_path / "answers.jsonl"
    file.write_text(json.dumps({"task": TASK.id, "directive": TASK.directive}) + "\n")
    task = {**task_to_json(TASK), "prompt_after_reasoning": TASK.directive}
    file.with_suffix(".json").write_text(json.dumps([task]))
    return file


# The VLMs need a server or weights, and the small reasoner may find no gate in noise: they have tests of their own.
@pytest.mark.parametrize("name", ["oracle", "noisy-oracle", "noisy-oracle:0.5,each", "replay:FILE", "published:TASKS"])
def test_a_reasoner_answers_with_a_directive_and_the_same_after_a_reset(name, answers):
    reasoner = make_reasoner(name.replace("FILE", str(answers)).replace("TASKS", str(answers.with_suffix(".json"))))
    reasoner.check()
    given = []
    for _ in range(2):
        begin_stage(reasoner, CONTEXT)
        given.append([reasoner.refine(noise(), TASK.instruction) for _ in range(8)])
    assert given[0] == given[1]
    guidance = given[0][0]
    assert isinstance(guidance, Guidance)
    assert guidance.directive
    assert guidance.gate in (None, 0, 1, 2)
    assert 0 <= guidance.confidence <= 1


@pytest.mark.parametrize("name", ["small", "oracle", "noisy-oracle", "replay:FILE", "vlm:http://127.0.0.1:9,model=m"])
def test_every_reasoner_is_reset_with_and_without_ground_truth_and_closes(name, answers):
    reasoner = make_reasoner(name.replace("FILE", str(answers)))
    assert isinstance(reasoner, Reasoner)
    for context in (CONTEXT, LATER, replace(CONTEXT, ground_truth=None)):
        reasoner.reset(context)
    reasoner.close()


def test_every_reasoner_of_the_package_is_tested_somewhere():
    assert set(REASONERS) == {"small", "oracle", "noisy-oracle", "remote", "replay", "published", "vlm", "vlm-local"}
    assert all(issubclass(cast("type", registry.load("reasoner", name, REASONERS)), Reasoner) for name in REASONERS)


def test_what_needs_ground_truth_or_a_seed_declares_it():
    policies = {name: registry.load("policy", name, POLICIES) for name in POLICIES}
    reasoners = {name: registry.load("reasoner", name, REASONERS) for name in REASONERS}
    assert {name for name, made in policies.items() if made.needs_ground_truth} == {"oracle"}
    assert {name for name, made in policies.items() if made.needs_seed} == set(DRAWING)
    told = {name for name, made in reasoners.items() if made.needs_ground_truth}
    assert told == {"oracle", "noisy-oracle", "replay", "published"}
    assert {name for name, made in reasoners.items() if made.needs_seed} == {"noisy-oracle"}


def test_no_reasoner_is_a_choice():
    assert make_reasoner("none") is None


class Nothing:
    pass


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("hoover", "did you mean 'hover'"),
        ("hover:fast", "'hover' takes no argument"),
        ("small:no/such/model.onnx", "there is no model file no/such/model.onnx"),
        ("small:", "ends at its colon"),
        ("smal:model.onnx", "no module 'smal'; did you mean 'small:model.onnx'?"),
        ("runs/a/model.onnx", "write small:runs/a/model.onnx"),
        ("no_such_module:Thing", "no module 'no_such_module'"),
        ("mine/seek.py:Seek", r"name the module, not its file: PYTHONPATH=mine \.\.\. seek:Seek"),
        ("cognitivedrone.policies.baselines:Hoover", "has no 'Hoover'"),
        ("cognitivedrone.types:COLORS", "is not a class or function"),
        ("cognitivedrone.reasoners.oracle:Oracle", r"has no method act\(\)"),
        (f"{__name__}:Nothing", r"policy '.*:Nothing' has no method reset\(\)"),
    ],
)
def test_a_policy_that_cannot_be_made_is_reported_in_one_sentence(name, says):
    with pytest.raises(PolicyError, match=says) as error:
        make_policy(name)
    assert "\n" not in str(error.value)


def test_oracles_refuse_to_fly_without_the_truth():
    with pytest.raises(PolicyError, match="needs the simulator's ground truth"):
        make_policy("oracle").act(observation(noise()))
    with pytest.raises(PolicyError, match="needs the simulator's ground truth"):
        make_reasoner("oracle").refine(noise(), "go")
