"""Every policy and reasoner of the package keeps the interface's word."""

from __future__ import annotations

import json

import numpy as np
import pytest
from openvla_files import write_checkpoint

from cognitivedrone.errors import PolicyError
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.interfaces import Privileged, Seeded
from cognitivedrone.policies import POLICIES, make_policy
from cognitivedrone.reasoners import REASONERS, make_reasoner
from cognitivedrone.types import ACTION_LIMITS, DroneState, Gate, Guidance, Observation, Stage, Task, GroundTruth

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


def noise(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (256, 256, 3)).astype(np.uint8)


def observation(image, time=0.0):
    return Observation(image, TASK.instruction, np.zeros(3, np.float32), 0.8, 0.0, time)


def prepared(name):
    policy = make_policy(name)
    if isinstance(policy, Seeded):
        policy.seed(7)
    policy.reset(TASK.instruction)
    if isinstance(policy, Privileged):
        policy.brief(TRUTH)
    return policy


@pytest.fixture(scope="session")
def tiny_openvla(tmp_path_factory):
    return write_checkpoint(tmp_path_factory.mktemp("openvla"))


@pytest.fixture(params=[*(name for name in POLICIES if name != "openvla"), "small:FILE", "openvla:FOLDER,device=cpu"])
def name(request, tiny_model_file, tiny_openvla):
    """Every policy of the package, and models of one's own."""
    return request.param.replace("FILE", str(tiny_model_file)).replace("FOLDER", str(tiny_openvla))


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
        if isinstance(policy, Seeded):
            policy.seed(7)
        policy.reset(TASK.instruction)
        if isinstance(policy, Privileged):
            policy.brief(TRUTH)
        assert np.array_equal(policy.act(observation(noise())), begin)

    def test_it_leaves_the_frame_as_it_was(self, name):
        image = noise()
        prepared(name).act(observation(image))
        assert np.array_equal(image, noise())


# The VLMs need a server or weights, and the small reasoner may find no gate in noise: they have tests of their own.
@pytest.mark.parametrize("name", ["oracle", "noisy-oracle", "noisy-oracle:0.5,each", "replay:FILE"])
def test_a_reasoner_answers_with_a_directive(name, tmp_path):
    answers = tmp_path / "answers.jsonl"
    answers.write_text(json.dumps({"task": TASK.id, "directive": TASK.directive}) + "\n")
    reasoner = make_reasoner(name.replace("FILE", str(answers)))
    if isinstance(reasoner, Seeded):
        reasoner.seed(7)
    if isinstance(reasoner, Privileged):
        reasoner.brief(TRUTH)
    guidance = reasoner.refine(noise(), TASK.instruction)
    assert isinstance(guidance, Guidance)
    assert guidance.directive
    assert guidance.gate in (None, 0, 1, 2)
    assert 0 <= guidance.confidence <= 1


def test_every_reasoner_of_the_package_is_tested_somewhere():
    assert set(REASONERS) == {"small", "oracle", "noisy-oracle", "replay", "vlm", "vlm-local"}


def test_no_reasoner_is_a_choice():
    assert make_reasoner("none") is None


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("hoover", "did you mean 'hover'"),
        ("no_such_module:Thing", "no module 'no_such_module'"),
        ("cognitivedrone.policies.blind:Hoover", "has no 'Hoover'"),
        ("cognitivedrone.types:COLORS", "is not a class or function"),
        ("cognitivedrone.reasoners.oracle:Oracle", r"has no method reset\(\)"),
    ],
)
def test_a_policy_that_cannot_be_made_is_said_in_one_sentence(name, says):
    with pytest.raises(PolicyError, match=says) as error:
        make_policy(name)
    assert "\n" not in str(error.value)


def test_oracles_refuse_to_fly_without_the_truth():
    with pytest.raises(PolicyError, match="needs the simulator's truth"):
        make_policy("oracle").act(observation(noise()))
    with pytest.raises(PolicyError, match="needs the simulator's truth"):
        make_reasoner("oracle").refine(noise(), "go")
