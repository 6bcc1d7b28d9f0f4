"""The loop keeps its rates, flies chunks to their end, follows legs and refuses what cannot be flown."""

from __future__ import annotations

import numpy as np
import pytest

from cognitivedrone.errors import NonFiniteAction, PolicyError
from cognitivedrone.flight.loop import Leg, Rates, fly
from cognitivedrone.types import Guidance, Observation


class Ground:
    """A drone that stays where it is, and a clock that only counts."""

    def __init__(self):
        self.time = 0.0
        self.sent = []

    def observe(self):
        image = np.zeros((256, 256, 3), np.uint8)
        return Observation(image, "from the drone", np.zeros(3, np.float32), 1.0, 0.0, self.time)

    def send(self, action):
        self.sent.append((self.time, action.copy()))
        return action

    def close(self):
        pass

    def now(self):
        return self.time

    def sleep_until(self, time):
        self.time = time


class Counting:
    """Answers with chunks of k, each numbered by the call that made it."""

    def __init__(self, k=1):
        self.k, self.calls, self.resets, self.texts = k, 0, [], []

    def reset(self, instruction):
        self.resets.append(instruction)

    def act(self, observation):
        self.calls += 1
        self.texts.append(observation.instruction)
        return np.full((self.k, 4), self.calls / 100, np.float32)


class Numbered:
    def __init__(self):
        self.asked = []

    def refine(self, image, instruction):
        self.asked.append(instruction)
        return Guidance(f"directive {len(self.asked)}", None, 1.0)


def for_steps(ground, steps, instruction="go"):
    return lambda: Leg(0, instruction) if ground.time < steps / 10 - 1e-9 else None


def test_ten_commands_a_second_on_absolute_deadlines():
    ground = Ground()
    assert fly(ground, Counting(), ground, for_steps(ground, 25)) == 25
    assert [time for time, _ in ground.sent] == pytest.approx([i / 10 for i in range(25)])


def test_a_chunk_is_flown_to_its_end_before_the_policy_is_asked_again():
    ground, policy = Ground(), Counting(k=4)
    fly(ground, policy, ground, for_steps(ground, 10))
    assert policy.calls == 3
    assert [round(float(a[0]) * 100) for _, a in ground.sent] == [1, 1, 1, 1, 2, 2, 2, 2, 3, 3]


def test_the_reasoner_is_asked_twice_a_second_and_its_directive_replaces_the_instruction():
    ground, policy, reasoner = Ground(), Counting(), Numbered()
    fly(ground, policy, ground, for_steps(ground, 12), reasoner=reasoner)
    assert len(reasoner.asked) == 3
    assert policy.texts == ["directive 1"] * 5 + ["directive 2"] * 5 + ["directive 3"] * 2


def test_a_new_leg_resets_the_policy_and_drops_the_rest_of_the_chunk():
    ground, policy, reasoner = Ground(), Counting(k=4), Numbered()

    def mission():
        step = round(ground.time * 10)
        return None if step >= 4 else Leg(step // 2, "the correct answer")

    fly(ground, policy, ground, mission, reasoner=reasoner)
    assert policy.resets == ["the correct answer"] * 2
    assert policy.calls == 2
    assert len(reasoner.asked) == 2


def test_a_number_that_is_none_ends_the_flight():
    class Broken(Counting):
        def act(self, observation):
            return np.array([[0.0, np.nan, 0.0, 0.0]], np.float32)

    ground = Ground()
    with pytest.raises(NonFiniteAction, match="not all of it is a finite number"):
        fly(ground, Broken(), ground, for_steps(ground, 3))
    assert ground.sent == []


@pytest.mark.parametrize("shape", [(4,), (1, 7), (0, 4), (2, 2, 4)])
def test_an_action_of_another_shape_is_a_programming_error(shape):
    class Wrong(Counting):
        def act(self, observation):
            return np.zeros(shape, np.float32)

    ground = Ground()
    with pytest.raises(PolicyError, match="expected \\(k, 4\\)"):
        fly(ground, Wrong(), ground, for_steps(ground, 3))


def test_rates_must_divide():
    with pytest.raises(ValueError, match="whole multiple"):
        Rates(control_hz=10, reasoner_hz=3)
