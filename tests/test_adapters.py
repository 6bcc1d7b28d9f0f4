"""Users' own policies and reasoners: what they may leave out, what is called, and what was written before."""

import warnings
from typing import Any, cast

import numpy as np
import pytest

from cognitivedrone.adapters import as_policy, as_reasoner
from cognitivedrone.errors import PolicyError
from cognitivedrone.interfaces import Policy, Reasoner
from cognitivedrone.types import EpisodeContext, Guidance

TRUTH = object()
CONTEXT = EpisodeContext("To the cat", seed=7, stage=0, ground_truth=TRUTH)  # type: ignore[arg-type]
LATER = EpisodeContext("To the dog", seed=7, stage=1, ground_truth=TRUTH)  # type: ignore[arg-type]
CHUNK = np.zeros((1, 4), np.float32)
GUIDANCE = Guidance("Fly through the red gate", None, 1.0)


class Log:
    def __init__(self):
        self.calls = []


class Straight(Log):
    """The least that a policy is, and methods of other uses whose names earlier versions called."""

    def reset(self, context):
        self.calls.append(context)

    def act(self, observation):
        self.calls.append(observation)
        return CHUNK

    def seed(self, field):
        raise AssertionError("nobody's business")

    brief = check = new_flight = new_stage = seed


def test_what_inherits_is_taken_as_it_is():
    class Mine(Policy):
        def act(self, observation):
            return CHUNK

    class Asked(Reasoner):
        def refine(self, image, instruction):
            return GUIDANCE

    policy, reasoner = Mine(), Asked()
    assert as_policy("mine", policy) is policy
    assert as_reasoner("asked", reasoner) is reasoner
    for part in (policy, reasoner):
        part.check()
        part.reset(CONTEXT)
        part.close()
        assert not part.needs_ground_truth
        assert not part.needs_seed


def test_a_class_of_two_methods_flies_and_its_other_methods_are_its_own():
    made = Straight()
    policy: Any = as_policy("policy 'mine'", made)
    policy.check()
    policy.reset(CONTEXT)
    assert policy.act("seen") is CHUNK
    policy.close()
    assert made.calls == [CONTEXT, "seen"]
    assert not policy.needs_ground_truth
    assert not policy.needs_seed


def test_what_it_declares_and_its_close_count():
    class Teacher(Straight):
        needs_ground_truth = needs_seed = True

        def close(self):
            self.calls.append("closed")

    made = Teacher()
    policy = as_policy("policy 'mine'", made)
    assert policy.needs_ground_truth
    assert policy.needs_seed
    policy.close()
    assert made.calls == ["closed"]


def test_a_reasoner_may_be_one_method_or_keep_what_it_sees_between_resets():
    class Once:
        def refine(self, image, instruction):
            return GUIDANCE

    class Keeps(Once, Log):
        def reset(self, context):
            self.calls.append(context)

        def seed(self):
            raise AssertionError("nobody's business")

    plain: Any = as_reasoner("a", Once())
    keeps = Keeps()
    plain.reset(CONTEXT)
    assert plain.refine("image", "go") is GUIDANCE
    plain.close()
    as_reasoner("b", keeps).reset(CONTEXT)
    assert keeps.calls == [CONTEXT]


def test_what_is_missing_is_named():
    with pytest.raises(PolicyError, match=r"policy 'mine' has no method reset\(\)"):
        as_policy("policy 'mine'", object())
    with pytest.raises(PolicyError, match=r"reasoner 'mine' has no method refine\(\)"):
        as_reasoner("reasoner 'mine'", object())


class Unaware(Log):
    """Takes the context for a sentence, at once or later."""

    def __init__(self, when):
        super().__init__()
        self.when = when

    def reset(self, text):
        self.text = text
        if self.when == "reset":
            text.lower()

    def act(self, observation):
        assert "cat" in self.text
        return CHUNK


@pytest.mark.parametrize("when", ["reset", "act"])
def test_who_takes_the_context_for_the_instruction_reads_what_to_change(when):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        policy = as_policy("policy 'mine'", Unaware(when))
    if when == "act":
        policy.reset(CONTEXT)
    call: Any = policy.act if when == "act" else policy.reset
    with pytest.raises(PolicyError, match=r"'mine': reset\(context\) receives .*; read context\.instruction$"):
        call(CONTEXT)


def test_other_mistakes_keep_their_own_words():
    class Broken(Straight):
        def act(self, observation):
            return None + 1

    with pytest.raises(TypeError, match="unsupported operand"):
        as_policy("policy 'mine'", Broken()).act(cast("Any", "seen"))
