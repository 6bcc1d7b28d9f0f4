"""Looking closer in doubt: nearer, to either side and back, and then what the reasoner says."""

import numpy as np
import pytest

from cognitivedrone.control.async_reasoner import SimulatedReasoner
from cognitivedrone.control.closer_look import CloserLook, LookRule
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.errors import ReasonerError
from cognitivedrone.interfaces import Policy, Reasoner
from cognitivedrone.tasks.directives import HOLD
from cognitivedrone.types import Guidance, Observation, SeenPanel

STEP_S = 0.1
RED, BLUE = "Fly through the red gate", "Fly through the blue gate"
SILENT = "silent"


class Plane:
    """Flies as commanded, at once, and is its own clock; looks along x."""

    def __init__(self) -> None:
        self.pose, self.time, self.velocity = np.zeros(3), 0.0, np.zeros(4)
        self.places = []

    def observe(self):
        image = np.zeros((256, 256, 3), np.uint8)
        return Observation(image, "", self.velocity[:3].astype(np.float32), 1.0, float(self.velocity[3]), self.time)

    def send(self, action):
        self.velocity = np.asarray(action, dtype=float)
        x, y, _, turn = self.velocity
        cos, sin = np.cos(self.pose[2]), np.sin(self.pose[2])
        self.pose += STEP_S * np.array([cos * x - sin * y, sin * x + cos * y, turn])
        self.places.append(self.pose.copy())
        return action

    def close(self):
        pass

    def now(self):
        return self.time

    def sleep_until(self, time_s):
        self.time = time_s


class Steady(Policy):
    """Flies one way, and keeps what it is told; with `wall` nothing leads ahead."""

    def __init__(self, *action, wall=False):
        self.action, self.wall, self.told = action, wall, []

    def reset(self, context):
        pass

    def act(self, observation):
        self.told.append(observation.instruction)
        return np.array([self.action], np.float32)

    def around(self, action):
        return action * np.array([*[not self.wall] * 3, 1], np.float32)


class Judging(Reasoner):
    """Answers by where the drone is: a directive and its confidence, or none."""

    def __init__(self, drone, judge, height_px=30.0):
        self.drone, self.judge, self.height_px = drone, judge, height_px

    def reset(self, context):
        pass

    def refine(self, image, instruction):
        self.seen = (SeenPanel("red", (128.0, 60.0, self.height_px), "", ()),) if self.height_px else ()
        directive, confidence = self.judge(self.drone)
        if not directive:
            raise ReasonerError("unsure", "no answer is likely", certainty=confidence)
        if directive == SILENT:
            raise ReasonerError("timeout", "no answer in 2 s")
        return Guidance(directive, 0, confidence, present=1 - confidence if directive == HOLD else None)


class Notes:
    def __init__(self):
        self.events, self.followed = [], []

    def record(self, observation, action, guidance):
        self.followed.append(guidance.directive if guidance else "")

    def note(self, event):
        self.events.append(event.kind)


def flown(judge, seconds=40.0, policy=None, look="yes", height_px=30.0, kind=Judging):
    drone, notes = Plane(), Notes()
    policy, doubt = policy or Steady(0.0, 0.0, 0.0, 0.0), CloserLook.of(look)
    reasoner = SimulatedReasoner(kind(drone, judge, height_px))
    fly(
        drone, policy, drone, lambda: Segment(0, "the bird") if drone.time < seconds else None,
        reasoner=reasoner, look=doubt, recorder=notes,
    )  # fmt: skip
    return drone, notes, doubt


def reached(drone, x, yaw):
    return any(np.hypot(place[0] - x, place[1]) < 0.3 and abs(place[2] - yaw) < 0.3 for place in drone.places)


def test_in_doubt_it_looks_from_nearer_and_to_either_side_and_turns_to_the_gate_that_it_chose():
    seen_near = []

    def judge(drone):
        seen_near.append(drone.pose[0] > 2)
        return (BLUE, 0.5) if any(seen_near) else (RED, 0.5)

    drone, notes, doubt = flown(judge, 11.0)
    for x, yaw in LookRule().places:
        assert reached(drone, x, yaw)
    assert drone.pose == pytest.approx([1.0, 0.0, 0.5], abs=0.3)  # gate 1 is on the left
    assert notes.events.count("hold") == notes.events.count("sure") == 1
    assert notes.followed[-1] == BLUE
    assert not doubt.active


def test_sure_answers_and_no_look_leave_the_flight_alone():
    for judge, look in ((lambda _: (RED, 0.9), "yes"), (lambda _: (RED, 0.1), "no")):
        drone, notes, _ = flown(judge, 8.0, Steady(0.5, 0.0, 0.0, 0.0), look)
        assert "hold" not in notes.events
        assert drone.pose[0] == pytest.approx(4.0, abs=0.2)


def test_after_the_look_one_answer_that_no_gate_matches_declines():
    drone, notes, _ = flown(lambda _: (HOLD, 0.6), policy=Steady(1.0, 0.0, 0.0, 0.0))
    assert notes.events.index("declined") > notes.events.index("sure")
    assert np.hypot(*drone.pose[:2]) < 1.5
    assert (drone.velocity == 0).all()


def test_without_an_answer_even_from_near_it_declines():
    drone, notes, _ = flown(lambda _: ("", 0.1), policy=Steady(1.0, 0.0, 0.0, 0.0))
    assert notes.events.index("declined") > notes.events.index("sure")
    assert drone.pose[0] < 1.5


def test_it_goes_no_nearer_to_a_panel_that_is_large_and_around_what_is_in_the_way():
    drone, _, _ = flown(lambda _: (RED, 0.5), height_px=80.0)
    assert max(place[0] for place in drone.places) < 0.9
    drone, notes, _ = flown(lambda _: (RED, 0.5), policy=Steady(0.0, 0.0, 0.0, 0.0, wall=True))
    assert max(place[0] for place in drone.places) < 0.1
    assert "sure" in notes.events  # it does not wait for ever for a place that it cannot reach


def test_blind_it_goes_nowhere_and_waits_for_one_more_answer():
    """A reasoner that does not tell where the panels are cannot say how near they are."""
    drone, notes, _ = flown(lambda _: (RED, 0.5), 6.0, height_px=0.0)
    assert notes.events.count("hold") == notes.events.count("sure") == 1
    assert notes.followed[-1] == RED
    assert max(np.hypot(*place[:2]) for place in drone.places) < 0.1
    _, notes, _ = flown(lambda _: ("", 0.1), 6.0, height_px=0.0)
    assert "declined" in notes.events


def test_a_look_without_an_answer_ends_with_the_first_place():
    drone, notes, doubt = flown(lambda drone: (RED, 0.5) if drone.time < 1 else (SILENT, 0.0), 13.0)
    assert (notes.events.count("hold"), notes.events.count("sure")) == (1, 1)
    assert not doubt.active
    assert not reached(drone, *LookRule().places[1])
    assert notes.followed[-1] == RED


def test_a_drone_that_only_turns_looks_for_its_gate():
    _, notes, doubt = flown(lambda _: (RED, 0.9), 5.0, Steady(0.0, 0.0, 0.0, 1.0))
    assert "hold" not in notes.events
    _, notes, doubt = flown(lambda _: (RED, 0.9), 9.0, Steady(0.0, 0.0, 0.0, 1.0))
    assert "hold" in notes.events
    assert doubt.reason == "the gate that it flew to is out of sight"


def test_a_gate_that_is_named_and_out_of_sight_is_looked_for_at_once():
    class Remembering(Judging):
        def refine(self, image, instruction):
            found = super().refine(image, instruction)
            self.seen = (SeenPanel("blue", None, "", ()), *self.seen)
            return found

    _, notes, doubt = flown(lambda _: (RED, 0.9), 2.0, kind=Remembering)
    assert "hold" in notes.events
    assert doubt.reason == "the gate is out of sight"


def test_after_the_look_it_does_not_leave_a_gate_for_one_that_it_does_not_see():
    class Losing(Judging):
        def refine(self, image, instruction):
            found = super().refine(image, instruction)
            if found.directive == BLUE and self.lost:
                self.seen = (SeenPanel("blue", None, "", ()), *self.seen)
            return found

    for lost, end in ((True, RED), (False, BLUE)):
        Losing.lost = lost
        onward = Steady(0.3, 0.0, 0.0, 0.0)
        _, notes, _ = flown(lambda drone: (BLUE, 0.9) if drone.time > 12 else (RED, 0.5), 16.0, onward, kind=Losing)
        assert notes.events.count("sure") == 1
        assert notes.followed[-1] == end


def test_what_nobody_understands_is_declined():
    drone, doubt, notes = Plane(), CloserLook(), Notes()

    def mission():
        doubt.begin(0)
        doubt.give_up("'blorb' was not understood")
        return Segment(0, "blorb") if drone.time < 2 else None

    fly(drone, Steady(1.0, 0.0, 0.0, 0.0), drone, mission, look=doubt, recorder=notes)
    assert "declined" in notes.events
    assert np.hypot(*drone.pose[:2]) == 0
