"""Reasoners beside the loop: told of flights and stages, in no time or in a thread, one question at a time."""

import re
import subprocess
import sys
import threading
from typing import cast

import numpy as np
import pytest

from cognitivedrone.control.async_reasoner import Question, SimulatedReasoner, ThreadedReasoner
from cognitivedrone.errors import ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.tasks.directives import HOLD, parse_directive, write_directive
from cognitivedrone.tasks.missions import forbidding
from cognitivedrone.types import EpisodeContext, Gate, GroundTruth, Guidance, SeenPanel, SubGoal

FRAME = np.zeros((256, 256, 3), np.uint8)


def question(segment=0, time=0.0):
    return Question(segment, "to the cat", FRAME, time)


def wait(async_reasoner):
    while (answer := async_reasoner.answer(0.0)) is None:
        pass
    return answer


class Remembers(Reasoner):
    def __init__(self):
        self.heard = []

    def reset(self, context):
        self.heard.append(context)

    def refine(self, image, instruction):
        self.heard.append(instruction)
        return Guidance("Fly through the red gate", None, 0.5)


@pytest.mark.parametrize("first", [0, 3])
def test_a_reasoner_is_reset_before_the_first_question_of_every_stage_and_the_first_of_a_flight_is_0(first):
    reasoner = Remembers()
    async_reasoner = SimulatedReasoner(reasoner, seed=7)
    for segment in (first, first, first + 1):
        async_reasoner.ask(question(segment))
        assert async_reasoner.answer(0.0).guidance.confidence == 0.5
    begun, later = EpisodeContext("to the cat", 7, 0), EpisodeContext("to the cat", 7, first + 1)
    assert reasoner.heard == [begun, "to the cat", "to the cat", later, "to the cat"]


@pytest.mark.parametrize("needs", [True, False])
def test_the_ground_truth_goes_to_reasoners_that_declare_that_they_need_it(needs):
    reasoner, truth = Remembers(), cast("GroundTruth", object())
    reasoner.needs_ground_truth = needs
    SimulatedReasoner(reasoner).ask(Question(0, "to the cat", FRAME, 0.0, truth))
    assert reasoner.heard[0].ground_truth is (truth if needs else None)


def test_an_answer_comes_once():
    async_reasoner = SimulatedReasoner(Remembers(), lambda _: 0.2)
    assert async_reasoner.idle(0.0)
    async_reasoner.ask(question())
    assert not async_reasoner.idle(0.1)
    assert async_reasoner.answer(0.1) is None
    assert async_reasoner.answer(0.2).question.time == 0.0
    assert async_reasoner.answer(0.3) is None
    assert async_reasoner.idle(0.3)


class Mistaken(Reasoner):
    def refine(self, image, instruction):
        raise KeyError("oops")


def test_an_exception_of_the_reasoners_own_is_a_fault_whose_traceback_is_kept():
    async_reasoner = SimulatedReasoner(Mistaken())
    async_reasoner.ask(question())
    answer = async_reasoner.answer(0.0)
    assert (answer.guidance, answer.fault) == (None, "raised")
    assert re.fullmatch(r"the reasoner raised KeyError: 'oops' \(test_async_reasoner.py, line \d+\)", answer.message)
    assert "in refine" in async_reasoner.trace


@pytest.mark.parametrize(
    ("returned", "fault"),
    [
        ("Fly through the red gate", "schema"),
        (None, "schema"),
        (Guidance(7, None, 1.0), "schema"),  # type: ignore[arg-type]
        (Guidance("Fly through the \ud800 gate", None, 1.0), "garbage"),
        (Guidance("Fly \x1b[31m", None, 1.0), "garbage"),
        (Guidance(" ", None, 1.0), "garbage"),
        (Guidance("Fly " * 400, None, 1.0), "too_long"),
        (Guidance("Fly through the red gate", 3, 1.0), "no_such_gate"),
        (Guidance("Fly through the red gate", "1", 1.0), "no_such_gate"),  # type: ignore[arg-type]
        (Guidance("Fly through the red gate", None, float("nan")), "schema"),
        (Guidance("Fly through the red gate", None, "sure"), "schema"),  # type: ignore[arg-type]
        (Guidance("Fly through the red gate", None, None), "schema"),
    ],
)
def test_what_is_no_answer_is_a_fault(returned, fault):
    class Returns(Reasoner):
        def refine(self, image, instruction):
            return returned

    async_reasoner = SimulatedReasoner(Returns())
    async_reasoner.ask(question())
    answer = async_reasoner.answer(0.0)
    assert (answer.guidance, answer.fault) == (None, fault)
    assert answer.message.isprintable()


def test_a_thread_thinks_beside_the_loop():
    go, done = threading.Event(), threading.Event()

    class Slow(Reasoner):
        def refine(self, image, instruction):
            go.wait(60)
            done.set()
            return Guidance(threading.current_thread().name, None, 1.0)

    async_reasoner = ThreadedReasoner(Slow())
    async_reasoner.ask(question())
    assert not async_reasoner.idle(0.0)
    assert async_reasoner.answer(0.0) is None
    go.set()
    assert done.wait(60)
    answer = wait(async_reasoner)
    assert answer.guidance.directive.startswith("reasoner")
    assert async_reasoner.idle(1.0)
    async_reasoner.close()


def test_an_exception_in_the_thread_is_a_fault_too():
    async_reasoner = ThreadedReasoner(Mistaken())
    async_reasoner.ask(question())
    assert wait(async_reasoner).fault == "raised"
    async_reasoner.close()


def test_no_thread_is_left_inside_a_library_when_the_process_ends():
    thinking, go_on = threading.Event(), threading.Event()

    class Slow(Remembers):
        def refine(self, image, instruction):
            thinking.set()
            go_on.wait()
            return super().refine(image, instruction)

    async_reasoner = ThreadedReasoner(Slow())
    async_reasoner.ask(question())
    thinking.wait()
    threading.Timer(0.1, go_on.set).start()
    async_reasoner.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "reasoner"]


def test_a_reasoner_that_never_answers_does_not_keep_the_process():
    code = """
import sys, threading
sys.path.insert(0, "tests/control")
from test_async_reasoner import Reasoner, ThreadedReasoner, question

class Hangs(Reasoner):
    def refine(self, image, instruction):
        started.set()
        threading.Event().wait()

started = threading.Event()
reasoner = ThreadedReasoner(Hangs())
reasoner.ask(question())
started.wait()
reasoner.close()
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def choice(thing, then, otherwise):
    """A sub-goal that depends on a thing."""
    there, absent = ((SubGoal("land" if each.startswith("Land") else "fly", each),) for each in (then, otherwise))
    return SubGoal("if", thing, there, absent)


@pytest.mark.parametrize(("there", "flown"), [(True, "Take the dog"), (False, "Fly to the cat")])
def test_of_a_condition_what_holds_decides_which_thing_is_asked_for(there, flown):
    class Sees(Remembers):
        def refine(self, image, instruction):
            self.heard.append(instruction)
            absent = instruction == "Fly to a bus" and not there
            return Guidance("Hold position" if absent else "Fly through the blue gate", None, 0.5)

    reasoner = Sees()
    goal = forbidding(choice("Fly to a bus", "Take the dog", "Fly to the cat"), frozenset({"green"}))
    asked = SimulatedReasoner(reasoner)
    asked.ask(Question(0, "Fly to a bus", FRAME, 0.0, goal=goal))
    assert asked.answer(0.0).guidance.seen == (there,)
    assert reasoner.heard[-1] == f"{flown}, but never through the green gate"


class Panels(Remembers):
    """Sees a dog at a round red gate, a cat at a round green, a bus at a big blue one; for a cow takes the dog."""

    def refine(self, image, instruction):
        gates = {"dog": Gate("small", "round", "red"), "cat": Gate("small", "round", "green"),
                 "bus": Gate("big", "square", "blue")}  # fmt: skip
        fits = [thing for thing in gates if thing in instruction or ("animal" in instruction and thing != "bus")]
        fits = fits or ["dog"] * ("cow" in instruction)
        rights = [0.9 - 0.2 * place if thing in fits else 0.02 for place, thing in enumerate(gates)]
        self.seen = tuple(
            SeenPanel(gate.color, None, thing, ((thing, 0.8), ("wolf", 0.01)), right, gate)
            for (thing, gate), right in zip(gates.items(), rights, strict=True)
        )
        if not fits:
            return Guidance(HOLD, None, 0.9, present=0.1)
        return Guidance(write_directive(gates[fits[0]]), 0, 0.9)


@pytest.mark.parametrize(
    ("goal", "color"),
    [
        (SubGoal("fly", "Fly to an animal"), "red"),
        (SubGoal("fly", "Fly to an animal", avoid=frozenset({"Fly to the dog"})), "green"),
        (
            SubGoal("fly", "Fly to an animal", avoid=frozenset({"Fly to a wolf", "Fly through the gate with the cow"})),
            "red",
        ),
        (SubGoal("fly", "Fly to the bus", avoid=frozenset({"Fly to any animal"})), "blue"),
        (SubGoal("fly", "Fly to an animal", avoid=frozenset({"Fly to what is like a dog"})), "green"),
        (SubGoal("fly", "Fly to an animal", avoid=frozenset({"round"})), None),
        (SubGoal("fly", "Fly to an animal", avoid=frozenset({"red round"})), "green"),
        (SubGoal("fly", "Fly to an animal", avoid=frozenset({"red square", "big red"})), "red"),
        (SubGoal("fly", "Fly to an animal", avoid=frozenset({"red"}), rejected=frozenset({"green"})), "blue"),
        (SubGoal("fly", "Fly to an animal", avoid=frozenset({"small", "Fly to the bus"})), None),
    ],
)
def test_what_is_forbidden_by_look_or_thing_is_not_flown_through(goal, color):
    asked = SimulatedReasoner(Panels())
    asked.ask(Question(0, goal.instruction, FRAME, 0.0, goal=goal))
    assert parse_directive(asked.answer(0.0).guidance.directive)[1] == color


@pytest.mark.parametrize(
    ("goal", "directive"),
    [
        (choice("Fly to the zebra", "Fly to the zebra", "Land on the pad"), "Land on the pad"),
        (choice("Fly to a cow", "Fly to a cow", "Land on the pad"), "Land on the pad"),
        (choice("Fly to the dog", "Fly to the dog", "Land on the pad"), "Fly through the small red round gate"),
        (choice("Fly to the bus", "Land on the red pad", "Fly to the dog"), "Land on the red pad"),
        (choice("Fly to the zebra", "Land on the red pad", "Land on the blue pad"), "Land on the blue pad"),
        (SubGoal("if", "Fly to the zebra", (SubGoal("fly", "Fly to the zebra"),),
                 (choice("Fly to the bus", "Fly to the cat", "Land on the pad"),)),
         "Fly through the small green round gate"),
    ],
)  # fmt: skip
def test_a_branch_may_be_to_land(goal, directive):
    asked = SimulatedReasoner(Panels())
    asked.ask(Question(0, goal.instruction, FRAME, 0.0, goal=goal))
    assert asked.answer(0.0).guidance.directive == directive


def test_a_reasoner_that_is_unsure_leaves_no_forbidden_gate_to_the_policy():
    class Unsure(Panels):
        def refine(self, image, instruction):
            super().refine(image, instruction)
            raise ReasonerError("unsure", "it cannot tell")

    for avoid, color in (({"red"}, "green"), ({"round"}, None)):
        asked = SimulatedReasoner(Unsure())
        goal = SubGoal("fly", "Fly to an animal", avoid=frozenset(avoid))
        asked.ask(Question(0, goal.instruction, FRAME, 0.0, goal=goal))
        assert parse_directive(asked.answer(0.0).guidance.directive)[1] == color
    asked = SimulatedReasoner(Unsure())
    asked.ask(Question(0, "Fly to an animal", FRAME, 0.0, goal=SubGoal("fly", "Fly to an animal")))
    assert asked.answer(0.0).fault == "unsure"


def test_where_a_gate_is_forbidden_what_was_named_three_times_stays_while_it_is_allowed():
    class Turns(Panels):
        turned = False

        def refine(self, image, instruction):
            return super().refine(image, "Fly to the cat" if self.turned else "Fly to the dog")

    turns = Turns()
    asked, found = SimulatedReasoner(turns), []
    for number, avoid in enumerate(["big", "big", "big", "big", "red", "round"]):
        turns.turned = number > 2
        goal = SubGoal("fly", "Fly to an animal", avoid=frozenset({avoid}))
        asked.ask(Question(0, goal.instruction, FRAME, 0.0, goal=goal))
        found.append(parse_directive(asked.answer(0.0).guidance.directive)[1])
    assert found == ["red", "red", "red", "red", "green", None]
