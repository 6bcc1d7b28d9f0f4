"""Hovering while the reasoner is unsure: when it begins, when it ends, and what the drone is sent meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from cognitivedrone.control.async_reasoner import Answer, Question, SimulatedReasoner
from cognitivedrone.control.hold import HeldDrone, Hold, HoldAwareReasoner, HoldRule
from cognitivedrone.errors import ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.types import Guidance

FRAME = np.zeros((256, 256, 3), np.uint8)


def answer(confidence, present=None, segment=0, frame=FRAME):
    guidance = Guidance("Fly through the red gate", 0, confidence, present=present)
    return Answer(Question(segment, "the bird", frame, 0.0), guidance)


def fault(kind, segment=0, certainty=None):
    return Answer(Question(segment, "the bird", FRAME, 0.0), None, kind, "it said so", certainty=certainty)


def after(*answers, rule=None):
    hold = Hold(rule)
    hold.begin(0)
    states = []
    for each in answers:
        hold.update(each)
        states.append(hold.active)
    return states


def test_it_takes_two_unsure_answers_to_hover():
    assert after(answer(0.2), answer(0.2)) == [False, True]
    assert after(answer(0.2), answer(0.9), answer(0.9)) == [False, False, False]


def test_a_sure_reasoner_that_sees_nothing_of_what_is_asked_is_unsure():
    assert after(answer(0.95, present=0.01), answer(0.95, present=0.01)) == [False, True]
    assert after(answer(0.95, present=0.99), answer(0.95, present=0.99)) == [False, False]


def test_it_flies_on_only_when_clearly_sure_again():
    seen = [answer(sure, frame=np.full_like(FRAME, 40 * n)) for n, sure in enumerate((0.3, 0.3, 0.6, 0.6, 0.9))]
    assert after(*seen) == [False, True, True, True, False]


def test_waiting_before_the_same_view_makes_nothing_surer():
    assert after(answer(0.3), answer(0.3), *[answer(0.9)] * 20) == [False] + [True] * 21
    noisy = [answer(0.9, frame=np.full_like(FRAME, n % 3)) for n in range(20)]  # a camera's noise is no other view
    assert after(answer(0.3), answer(0.3), *noisy) == [False] + [True] * 21
    hold = Hold()
    hold.begin(0)
    for sure in (0.3, 0.3):
        hold.update(answer(sure))
    hold.look_anew()  # from another place
    for sure in (0.9, 0.9):
        hold.update(answer(sure))
    assert not hold.active


def test_only_an_answer_that_names_a_gate_ends_the_doubt():
    hold = Hold()
    hold.begin(0)
    for each in (answer(0.1), answer(0.1)):
        hold.update(each)
    hold.look_anew()
    for _ in range(5):
        hold.update(fault("unsure", certainty=0.7))
    assert hold.active
    hold.update(answer(0.8))
    assert not hold.active


def test_a_pilot_that_gave_up_stays_so_until_the_next_instruction():
    hold = Hold()
    hold.begin(0)
    hold.give_up("'glorp' was not understood")
    hold.update(answer(1.0))
    hold.update(answer(1.0))
    assert hold.active
    assert hold.given_up
    hold.begin(1)
    assert not hold.given_up


def test_not_being_able_to_tell_is_unsure_until_something_was_read():
    assert after(fault("unsure"), fault("unsure")) == [False, True]
    # Before the gate what was read has left the view: it is flown through all the same.
    assert after(answer(0.9), *[fault("unsure")] * 5) == [False] * 6


def test_an_undecided_reasoner_counts_as_much_as_it_is_certain():
    assert after(*[fault("unsure", certainty=0.7)] * 3) == [False] * 3
    assert after(*[fault("unsure", certainty=0.1)] * 2) == [False, True]
    assert after(answer(0.9), *[fault("unsure", certainty=0.1)] * 2) == [False, False, True]
    assert after(fault("unsure", certainty=0.7), *[fault("unsure")] * 5) == [False] * 6


@pytest.mark.parametrize("kind", ["unreachable", "timeout", "garbage", "http"])
def test_a_reasoner_that_does_not_answer_says_nothing_of_the_scene(kind):
    assert after(*[fault(kind)] * 5) == [False] * 5


def test_zero_never_hovers():
    assert after(*[answer(0.0)] * 5, rule=HoldRule(below=0.0)) == [False] * 5


def test_a_new_segment_is_flown_until_it_is_doubted_itself():
    hold = Hold()
    hold.begin(0)
    for _ in range(2):
        hold.update(answer(0.1))
    assert hold.active
    hold.begin(0)
    assert hold.active
    hold.begin(1)
    assert not hold.active
    hold.update(answer(0.1, segment=0))  # late, about the segment before
    hold.update(answer(0.1, segment=1))
    assert not hold.active
    hold.update(answer(0.1, segment=1))
    assert hold.active


class Recorded:
    def __init__(self):
        self.sent = []

    def observe(self):
        return "seen"

    def send(self, action):
        self.sent.append(action.tolist())
        return action

    def close(self):
        self.sent.append("closed")


def test_a_held_drone_is_sent_no_velocity():
    drone, hold = Recorded(), Hold()
    held = HeldDrone(drone, hold)
    assert held.observe() == "seen"
    action = np.array([1.0, 0.5, -0.25, 0.5], np.float32)
    assert held.send(action).tolist() == action.tolist()
    hold.active = True
    assert held.send(action).tolist() == [0.0] * 4
    held.close()
    assert drone.sent == [action.tolist(), [0.0] * 4, "closed"]


class Doubtful(Reasoner):
    def refine(self, image, instruction):
        if instruction == "blind":
            raise ReasonerError("unsure", "cannot tell")
        return Guidance("Fly through the red gate", 0, 0.2)


def test_a_hold_aware_reasoner_passes_answers_on_and_to_the_hold():
    hold = Hold()
    async_reasoner = HoldAwareReasoner(SimulatedReasoner(Doubtful(), lambda _: 0.5), hold)
    for instruction in ("the bird", "blind", "the bird"):
        assert async_reasoner.idle(0.0)
        async_reasoner.ask(Question(3, instruction, FRAME, 0.0))
        assert async_reasoner.answer(0.1) is None
        assert async_reasoner.answer(0.6).question.instruction == instruction
    assert hold.active
    assert hold.sure == pytest.approx(0.2)
    async_reasoner.ask(Question(4, "the bird", FRAME, 1.0))
    assert not hold.active
    async_reasoner.close()
