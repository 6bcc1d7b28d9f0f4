"""Looking again: back to where the stage began, nearer, and in the end giving up. The drone moves as it is told."""

from __future__ import annotations

import numpy as np

from cognitivedrone.control.async_reasoner import Answer, Question
from cognitivedrone.control.hold import Hold
from cognitivedrone.control.second_look import LookRule, SecondLook
from cognitivedrone.types import Guidance, Observation

STEP_S = 0.1


class Plane:
    """Flies as commanded, at once; looks along x."""

    def __init__(self) -> None:
        self.pose, self.height, self.time, self.velocity = np.zeros(3), 0.5, 0.0, np.zeros(4)

    def observe(self):
        image = np.zeros((256, 256, 3), np.uint8)
        return Observation(
            image, "", self.velocity[:3].astype(np.float32), self.height, float(self.velocity[3]), self.time
        )

    def send(self, action):
        self.velocity = np.asarray(action, dtype=float)
        x, y, z, turn = self.velocity
        cos, sin = np.cos(self.pose[2]), np.sin(self.pose[2])
        self.pose += STEP_S * np.array([cos * x - sin * y, sin * x + cos * y, turn])
        self.height += STEP_S * z
        self.time += STEP_S
        return action

    def close(self):
        pass


def answer(confidence):
    frame = np.zeros((256, 256, 3), np.uint8)
    return Answer(Question(0, "the bird", frame, 0.0), Guidance("Fly through the red gate", 0, confidence))


def flown(drone, hold, confidence, seconds, action=(1.0, 0.0, 0.0, 0.5)):
    """Where it was, step by step; the reasoner answers twice a second with the confidence for a place."""
    look, places = SecondLook(drone, hold), []
    hold.begin(0)
    for step in range(round(seconds / STEP_S)):
        look.observe()
        if step % 5 == 0:
            hold.update(answer(confidence(drone.pose)))
        look.send(np.array(action, np.float32))
        places.append(drone.pose.copy())
    return np.array(places)


def test_in_doubt_it_goes_back_and_then_nearer_and_gives_up():
    drone, hold = Plane(), Hold()
    places = flown(drone, hold, lambda pose: 0.9 if drone.time < 1.5 else 0.1, 25.0)
    assert hold.given_up
    far = places[15]
    assert np.hypot(*far[:2]) > 1.0
    back = np.hypot(*places[:, :2].T)[20:].argmin() + 20
    assert np.hypot(*places[back][:2]) < 0.25
    assert abs(places[back][2]) < 0.2  # it looks along the stage again
    assert np.hypot(*(places[-1][:2] - [LookRule().forward_m[-1], 0])) < 0.3
    assert (drone.velocity == 0).all()


def test_where_it_becomes_sure_it_flies_on():
    drone, hold = Plane(), Hold()
    flown(drone, hold, lambda pose: 0.9 if pose[0] > 1.2 else 0.1, 12.0, action=(0.0, 0.0, 0.0, 0.0))
    assert not hold.given_up
    assert drone.pose[0] > 1.2


def test_a_drone_that_only_turns_looks_for_its_gate_and_gives_up():
    drone, hold = Plane(), Hold()
    flown(drone, hold, lambda pose: 0.9, 4.0, action=(0.0, 0.0, 0.0, 1.0))
    assert not hold.active
    drone, hold = Plane(), Hold()
    flown(drone, hold, lambda pose: 0.9, 60.0, action=(0.0, 0.0, 0.0, 1.0))
    assert hold.given_up
    assert hold.reason == "the gate that it flew to is out of sight"
