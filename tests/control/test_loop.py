"""The loop keeps its rates, flies chunks to their end, follows segments and rejects what cannot be flown."""

from typing import cast

import numpy as np
import pytest

from cognitivedrone.adapters import as_policy
from cognitivedrone.control.async_reasoner import LateAnswers, SimulatedReasoner
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.errors import NonFiniteAction, PolicyError, ReasonerError
from cognitivedrone.interfaces import Policy, Reasoner
from cognitivedrone.types import EpisodeContext, GroundTruth, Guidance, Observation


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

    def sleep_until(self, time_s):
        self.time = time_s


class Counting(Policy):
    """Answers with chunks of k, each numbered by the call that made it."""

    def __init__(self, k=1):
        self.k, self.calls, self.resets, self.texts = k, 0, [], []

    def reset(self, context):
        self.resets.append(context)

    def act(self, observation):
        self.calls += 1
        self.texts.append(observation.instruction)
        return np.full((self.k, 4), self.calls / 100, np.float32)


def for_steps(ground, steps, instruction="go"):
    return lambda: Segment(0, instruction) if ground.time < steps / 10 - 1e-9 else None


def test_ten_commands_a_second_on_absolute_deadlines():
    ground = Ground()
    assert fly(ground, Counting(), ground, for_steps(ground, 25)) == 25
    assert [time for time, _ in ground.sent] == pytest.approx([i / 10 for i in range(25)])


def test_a_chunk_is_flown_to_its_end_before_the_policy_is_asked_again():
    ground, policy = Ground(), Counting(k=4)
    fly(ground, policy, ground, for_steps(ground, 10))
    assert policy.calls == 3
    assert [round(float(a[0]) * 100) for _, a in ground.sent] == [1, 1, 1, 1, 2, 2, 2, 2, 3, 3]


class Saying(Reasoner):
    """A reasoner that says one thing after the other, the last one for ever; None is "cannot tell"."""

    def __init__(self, *directives, confidence=1.0):
        self.directives, self.asked, self.confidence = list(directives), [], confidence

    def refine(self, image, instruction):
        self.asked.append(instruction)
        directive = self.directives.pop(0) if len(self.directives) > 1 else self.directives[0]
        if directive is None:
            raise ReasonerError("unsure", "it is too dark")
        return Guidance(directive, None, self.confidence)


class Notes:
    def __init__(self):
        self.events, self.ages = [], []

    def record(self, observation, action, guidance):
        self.ages.append(None if guidance is None else round(guidance.age, 3))

    def note(self, event):
        self.events.append((round(event.time, 3), event.kind, event.text))

    def of(self, *kinds):
        return [event for event in self.events if event[1] in kinds]

    @property
    def declining(self):
        return [(kind, time) for time, kind, _ in self.of("declined", "resumed")]


RED, BLUE = "Fly through the red gate", "Fly through the blue gate"


def test_the_reasoner_is_asked_twice_a_second_and_its_directive_replaces_the_instruction():
    ground, policy, reasoner, notes = Ground(), Counting(), Saying(RED), Notes()
    fly(ground, policy, ground, for_steps(ground, 12), reasoner=SimulatedReasoner(reasoner), recorder=notes)
    assert policy.texts == [RED] * 12
    assert notes.of("asked") == [(0.0, "asked", "go"), (0.5, "asked", "go"), (1.0, "asked", "go")]
    assert notes.of("adopted", "agreed") == [(0.0, "adopted", RED), (0.5, "agreed", RED), (1.0, "agreed", RED)]
    assert notes.ages[:7] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.0, 0.1]


def test_without_an_answer_the_last_good_directive_or_the_instruction_stays():
    ground, policy, notes = Ground(), Counting(), Notes()
    async_reasoner = SimulatedReasoner(Saying(None, RED, None))
    fly(ground, policy, ground, for_steps(ground, 15), reasoner=async_reasoner, recorder=notes)
    assert policy.texts == ["go"] * 5 + [RED] * 10
    assert notes.of("unsure") == [(0.0, "unsure", "it is too dark"), (1.0, "unsure", "it is too dark")]


def test_an_answer_comes_when_its_time_is_up_and_says_how_old_its_frame_is():
    ground, policy, notes = Ground(), Counting(), Notes()
    async_reasoner = SimulatedReasoner(Saying(RED), lambda _: 0.25)
    fly(ground, policy, ground, for_steps(ground, 10), reasoner=async_reasoner, recorder=notes)
    assert policy.texts == ["go"] * 3 + [RED] * 7
    assert notes.of("asked", "adopted", "agreed") == [
        (0.0, "asked", "go"),
        (0.3, "adopted", RED),
        (0.5, "asked", "go"),
        (0.8, "agreed", RED),
    ]
    assert notes.ages[3] == 0.3


def test_a_slow_reasoner_is_asked_about_the_newest_frame_never_about_a_queue():
    ground, notes = Ground(), Notes()
    async_reasoner = SimulatedReasoner(Saying(RED), lambda _: 0.72)
    fly(ground, Counting(), ground, for_steps(ground, 20), reasoner=async_reasoner, recorder=notes)
    assert [time for time, _, _ in notes.of("asked")] == [0.0, 0.8, 1.6]


def test_an_answer_about_an_earlier_segment_is_not_followed():
    ground, policy, notes = Ground(), Counting(), Notes()

    def mission():
        step = round(ground.time * 10)
        return None if step >= 10 else Segment(int(step >= 3), "first" if step < 3 else "second")

    async_reasoner = SimulatedReasoner(Saying(RED, BLUE), lambda _: 0.4)
    fly(ground, policy, ground, mission, reasoner=async_reasoner, recorder=notes)
    assert policy.texts == ["first"] * 3 + ["second"] * 5 + [BLUE] * 2
    assert notes.of("stale", "asked")[:3] == [(0.0, "asked", "first"), (0.4, "stale", RED), (0.4, "asked", "second")]


def test_a_policy_slower_than_its_rate_skips_deadlines_and_keeps_the_others():
    ground, notes = Ground(), Notes()
    assert fly(ground, Counting(), ground, for_steps(ground, 10), latency_model=lambda _: 0.13, recorder=notes) == 5
    assert [time for time, _ in ground.sent] == pytest.approx([0.13, 0.33, 0.53, 0.73, 0.93])


def test_only_decisions_are_charged_not_the_rest_of_a_chunk():
    ground = Ground()
    fly(ground, Counting(k=2), ground, for_steps(ground, 4), latency_model=lambda _: 0.05)
    assert [time for time, _ in ground.sent] == pytest.approx([0.05, 0.1, 0.25, 0.3])


def test_a_missed_deadline_is_noted():
    class Slow(Ground):
        def sleep_until(self, time_s):
            self.time = time_s + (0.03 if round(time_s, 3) == 0.2 else 0)

    ground, notes = Slow(), Notes()
    fly(ground, Counting(), ground, for_steps(ground, 4), recorder=notes)
    assert notes.of("late") == [(0.23, "late", "")]
    assert [round(time, 3) for time, _ in ground.sent] == [0.0, 0.1, 0.23, 0.3]


@pytest.mark.parametrize(("latency_s", "noted"), [(0.45, 0), (0.5, 0), (0.61, 1)])
def test_forty_late_answers_in_a_row_are_noted_once(latency_s, noted):
    ground, notes = Ground(), Notes()
    reasoner = SimulatedReasoner(Saying(RED), lambda _: latency_s)
    fly(ground, Counting(), ground, for_steps(ground, 600), reasoner=reasoner, recorder=notes)
    assert len(notes.of("unaided")) == noted
    assert all("the last 40 answers of the reasoner were late" in text for _, _, text in notes.of("unaided"))


def test_an_answer_in_time_begins_the_row_anew():
    late = LateAnswers()
    ages = [*[0.7] * 39, 0.4, *[0.7] * 41]
    assert [index for index, age in enumerate(ages) if late.count(age)] == [79]


def test_a_clock_that_goes_in_steps_is_not_late_by_one_of_them():
    class Steps(Ground):
        """Goes in steps of 50 ms, as a vehicle's telemetry does."""

        resolution_s = 0.05
        held_until = 0.0

        def sleep_until(self, time_s):
            self.time = 0.03 + 0.05 * np.ceil((max(time_s, self.held_until) - 0.03) / 0.05)

    ground, notes = Steps(), Notes()
    fly(ground, Counting(), ground, for_steps(ground, 20), recorder=notes)
    assert len(ground.sent) == 20
    assert notes.of("late") == []

    ground, notes = Steps(), Notes()
    ground.held_until = 0.45
    fly(ground, Counting(), ground, for_steps(ground, 20), recorder=notes)
    assert len(notes.of("late")) == 1


def test_a_new_segment_resets_the_policy_and_drops_the_rest_of_the_chunk():
    ground, policy, reasoner = Ground(), Counting(k=4), Saying(RED)

    def mission():
        step = round(ground.time * 10)
        return None if step >= 4 else Segment(step // 2, "the correct answer")

    fly(ground, policy, ground, mission, reasoner=SimulatedReasoner(reasoner))
    assert policy.resets == [EpisodeContext("the correct answer", stage=stage) for stage in (0, 1)]
    assert policy.calls == 2
    assert len(reasoner.asked) == 2


def test_the_first_segment_is_stage_0_whatever_its_index_and_every_stage_has_the_seed():
    ground, policy = Ground(), Counting()

    def mission():
        step = round(ground.time * 10)
        return None if step >= 4 else Segment(2 + step // 2, "go")

    fly(ground, policy, ground, mission, seed=5)
    assert [(context.seed, context.stage) for context in policy.resets] == [(5, 0), (5, 3)]


@pytest.mark.parametrize("needs", [True, False])
def test_the_ground_truth_goes_to_policies_that_declare_that_they_need_it(needs):
    ground, policy, truth = Ground(), Counting(), cast("GroundTruth", object())
    policy.needs_ground_truth = needs
    fly(ground, TimedPolicy(policy), ground, lambda: Segment(0, "go", truth) if ground.time < 0.05 else None)
    assert [context.ground_truth for context in policy.resets] == [truth if needs else None]


@pytest.mark.parametrize(
    ("chunk", "error", "says"),
    [
        (np.array([[0.0, np.nan, 0.0, 0.0]]), NonFiniteAction, "not all of it is a finite number"),
        *((np.zeros(shape), PolicyError, r"expected \(k, 4\)") for shape in ((4,), (1, 7), (0, 4), (2, 2, 4))),
    ],
)
def test_a_number_that_is_none_and_another_shape_end_the_flight_and_are_not_sent(chunk, error, says):
    class Wrong(Counting):
        def act(self, observation):
            return chunk.astype(np.float32)

    ground = Ground()
    with pytest.raises(error, match=says):
        fly(ground, Wrong(), ground, for_steps(ground, 3))
    assert ground.sent == []


# ---- declining


HOLD = "Hold position"


def test_the_drone_hovers_while_the_directive_declines_and_the_policy_is_not_asked():
    ground, policy, notes = Ground(), Counting(k=2), Notes()
    reasoner = SimulatedReasoner(Saying(HOLD, "hold position.", HOLD, RED))
    fly(ground, policy, ground, for_steps(ground, 30), reasoner=reasoner, recorder=notes)
    flown = [bool(action.any()) for _, action in ground.sent]
    assert notes.declining == [("declined", 1.0), ("resumed", 2.0)]
    assert flown == [True] * 10 + [False] * 10 + [True] * 10
    assert policy.texts == ["go"] * 5 + [RED] * 5


def test_the_loop_lands_by_the_instruction_and_never_by_a_directive_alone():
    ground, policy = Ground(), Counting()
    fly(ground, policy, ground, for_steps(ground, 10), reasoner=SimulatedReasoner(Saying("Land on the red pad")))
    assert not policy.texts
    assert all((command == 0).all() for _, command in ground.sent)
    ground, policy = Ground(), Counting()
    fly(ground, policy, ground, for_steps(ground, 10, "Land on the red pad"), reasoner=SimulatedReasoner(Saying(RED)))
    assert policy.calls == 0
    assert all(command[3] > 0 for _, command in ground.sent)  # it turns: there is no pad in a black picture


def test_a_policy_declines_with_its_commands():
    class Unsure(Counting):
        def act(self, observation):
            self.declines = 3 <= self.calls < 6
            return super().act(observation)

    ground, notes = Ground(), Notes()
    fly(ground, TimedPolicy(Unsure()), ground, for_steps(ground, 10), recorder=notes)
    assert notes.declining == [("declined", 0.3), ("resumed", 0.6)]


def test_a_users_policy_declines_by_an_attribute():
    class Users:
        declines = True

        def reset(self, context):
            pass

        def act(self, observation):
            return np.zeros((1, 4), np.float32)

    assert as_policy("mine", Users()).declines
    assert not Counting().declines
    ground, notes = Ground(), Notes()
    fly(ground, as_policy("mine", Users()), ground, for_steps(ground, 3), recorder=notes)
    assert notes.declining == [("declined", 0.0)]


@pytest.mark.parametrize(("present", "declined"), [(0.99, False), (0.5, True), (None, True)])
def test_a_policy_that_is_surer_is_not_stopped(present, declined):
    class Users:
        def reset(self, context):
            pass

        def act(self, observation):
            self.present = present
            return np.full((1, 4), 0.1, np.float32)

    ground, notes = Ground(), Notes()
    policy, reasoner = TimedPolicy(as_policy("mine", Users())), SimulatedReasoner(Saying(HOLD, confidence=0.9))
    fly(ground, policy, ground, for_steps(ground, 15), reasoner=reasoner, recorder=notes)
    assert notes.declining == ([("declined", 1.0)] if declined else [])


def test_a_new_segment_begins_without_declining():
    ground, notes = Ground(), Notes()
    reasoner = SimulatedReasoner(Saying(HOLD, HOLD, HOLD, RED))
    mission = lambda: Segment(int(ground.time >= 1.3), "go") if ground.time < 1.5 else None  # noqa: E731
    fly(ground, Counting(), ground, mission, reasoner=reasoner, recorder=notes)
    assert notes.declining == [("declined", 1.0)]
    assert [bool(action.any()) for _, action in ground.sent] == [True] * 10 + [False] * 3 + [True] * 2
