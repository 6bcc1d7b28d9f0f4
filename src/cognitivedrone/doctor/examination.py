"""The examination: a dozen questions, of which each answer is one sentence.

A fault that exchanges or turns something (colour channels, the image, the state, the sign of a command) is found by the
contrary: where answers agree with the expert's commands once the input or the output is turned back, that is the
fault. The other questions compare answers with each other.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from cognitivedrone.doctor.subject import (
    IMAGES,
    LIMITS,
    RANGES,
    STATES,
    Answer,
    Finding,
    ImageChange,
    LabelledView,
    Numbers,
    Question,
    StateChange,
    Subject,
    agreement,
    correlation,
    distance,
    expected_of,
    percent,
    size,
    unchanged,
    with_image,
    with_images,
)
from cognitivedrone.errors import PolicyError
from cognitivedrone.types import CONTROL_HZ

_T = TypeVar("_T")

LONGEST_CHUNK = 2 * CONTROL_HZ
"""Control steps that may be flown without looking."""
AGREES, WELL = 0.75, 0.95
"""Agreements with the expert: enough, and so much that no explanation is looked for."""
EXPLAINS = 0.5
"""What is put right must leave at most this share of the disagreement."""
ALIKE = 0.03
"""Changes of the state that leave less than this share of the disagreement more than the best one are told too."""
SLIGHT = 0.02
"""A change of the answers by less than this share of their own size is next to none."""
SLOWEST, FASTEST = 0.55, 1.8
"""Usual speeds, as shares of the expert's."""
INVERTED, FOLLOWS = 0.5, 0.9
"""Correlations with the expert's: below minus the first, a sign is wrong; above the second, it is the same one."""
REPEATED = 30
"""How often two views are shown again: a fault in one command of twenty is found in 95 % of examinations."""
SAME = 1e-6
"""Difference of equal answers."""
AXES = ("vx (forward)", "vy (left)", "vz (up)", "yaw_rate (left)")


def examine(subject: Subject, views: list[LabelledView]) -> Iterator[Finding]:
    """Examine a policy by views; yields a finding for each question. Takes about a thousand calls of the policy.

    What the policy does wrong is a finding and never raised. A policy whose answers are no commands is asked nothing
    further.
    """
    for question, ask in _Examination(subject, views).questions().items():
        try:
            yield Finding(question, *ask())
        except PolicyError as error:
            yield Finding(question, "wrong", str(error))
            if question == "answers":
                return


class _Examination:
    """The questions, and the answers that several of them need."""

    def __init__(self, subject: Subject, views: list[LabelledView]) -> None:
        self.subject = subject
        self.privileged = subject.policy.needs_ground_truth
        self.still = [view for view in views if not view.flying]
        self.flying = [view for view in views if view.flying]
        self.blind = self.deaf = self.explained = False
        # What was found to be wrong is put right in later questions, so that it is not found again in other words.
        self.signs_fix = np.ones(4)
        self.image_fix: ImageChange = unchanged
        self.state_fix: StateChange = unchanged

    def questions(self) -> Mapping[str, Callable[[], Answer]]:
        return {
            "answers": self.answers,
            "determinism": self.determinism,
            "memory": self.memory,
            "odd input": self.odd_input,
            "chunk length": self.chunk_length,
            "latency": self.latency,
            "image": self.image,
            "instruction": self.instruction,
            "image order": self.image_order,
            "image range": self.image_range,
            "state": self.state,
            "signs": self.signs,
            "scale": self.scale,
            "flight": self.flight,
        }

    # ---- what is asked

    def right(self, views: list[LabelledView]) -> list[Question]:
        """The right gate, by directive."""
        gates = [(view, int(view.task.target or 0)) for view in views]
        return [Question(view, gate, view.directive(gate)) for view, gate in gates]

    def raw(self, views: list[LabelledView]) -> list[Question]:
        """The right gate, by the task's own instruction."""
        return [replace(question, instruction=question.view.task.instruction) for question in self.right(views)]

    def every_gate(self) -> list[Question]:
        """Each gate in turn, from the start."""
        return [Question(view, gate, view.directive(gate)) for view in self.still for gate in range(3)]

    def commands(self, questions: list[Question]) -> Numbers:
        """First commands, with what was found to be wrong put right."""
        fixed = [
            replace(q, image=np.ascontiguousarray(self.image_fix(q.seen)), state=self.state_fix(q.numbers))
            for q in questions
        ]
        return self.subject.first(fixed) * self.signs_fix

    def follows(self) -> list[Question]:
        """The right gate of every view: by directive, or by the instruction where that is followed better."""
        views = [*self.flying, *self.still]
        kinds = self.right(views), self.raw(views)
        return max(kinds, key=lambda kind: agreement(self.commands(kind), expected_of(kind)))

    def agreement(self) -> float:
        """How well it turns to the gate asked for: by directive, or by the instruction where that is better."""
        kinds = ([*self.every_gate(), *self.right(self.flying)], self.raw([*self.still, *self.flying]))
        return max(agreement(self.commands(kind), expected_of(kind)) for kind in kinds)

    # ---- the form of the answers

    def answers(self) -> Answer:
        size = float(np.abs(self.subject.first([*self.raw(self.still[:2]), *self.right(self.flying[:2])])).max())
        if self.subject.changes_image:
            return "wrong", "it writes into the observation's image; give it a copy: image.copy()"
        self.subject.ask(self.right(self.flying[2:3])[0])
        if self.subject.reuses_array:
            return "wrong", "it returns the same array again and overwrites it; return a copy of its commands"
        return "good", f"(k, 4) finite numbers, the largest {size:.2g}"

    def determinism(self) -> Answer:
        questions = self.right(self.still[:2])
        _, first = (self.subject.first(questions) for _ in range(2))  # the first time of all may warm it up
        for _ in range(REPEATED):
            if (apart := distance(first, self.subject.first(questions))) > SAME:
                break
        else:
            return "good", f"the same view gets the same answer, {REPEATED} times"
        seed = "the seed of reset's context" if self.subject.policy.needs_seed else "a fixed seed, or needs_seed = True"
        return "wrong", (
            f"the same view gets other answers, {percent(apart)} of the limits apart, so that no run can be repeated:"
            f" draw random numbers from {seed}, and switch dropout off (model.eval())"
        )

    def memory(self) -> Answer:
        question, *others = self.right(self.still[:3])
        answers = []
        for other in (others[0], others[1], others[0]):
            self.subject.ask(other)
            self.subject.answer(other)
            answers.append(self.subject.first([question]))
        if distance(answers[0], answers[2]) > SAME:
            return "unknown", "its answers vary by themselves"
        if distance(answers[0], answers[1]) > SAME:
            return (
                "wrong",
                "its answer depends on the flight before: reset must clear all memory where context.stage is 0",
            )
        return "good", "reset forgets the flight before"

    def odd_input(self) -> Answer:
        question = self.right(self.still[:1])[0]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of words that it does not know
            for sentence in ("?", "Flieg durch das grüne Tor, bitte! 🙂", "Fly through the gate with the cat. " * 25):
                self.subject.ask(replace(question, instruction=sentence))
            dark = np.zeros_like(question.view.observation.image)
            self.subject.ask(replace(question, image=dark, state=np.array([3.0, -3.0, 1.5, 9.0, -1.0])))
        return "good", "short, long and foreign sentences, a black image and a fast flight get an answer"

    def chunk_length(self) -> Answer:
        longest = max(self.subject.lengths)
        flown_s = longest / CONTROL_HZ
        if longest > LONGEST_CHUNK:
            return "wrong", (
                f"a chunk has {longest} commands, which are flown for {flown_s:.1f} s without looking again; return the"
                " first 1 to 10 (rows=... of a remote policy)"
            )
        return "good", f"{longest} command{'s' * (longest > 1)}, flown in {flown_s:.1f} s"

    def latency(self) -> Answer:
        needed_s, rows = float(np.median(self.subject.seconds[1:])), min(self.subject.lengths)
        found = f"{1e3 * needed_s:.0f} ms for {rows} command{'s' * (rows > 1)} of {1000 / CONTROL_HZ:.0f} ms each"
        if needed_s > rows / CONTROL_HZ:
            return "wrong", (
                f"{found}: too slow for {CONTROL_HZ} Hz in real time; return at least"
                f" {int(np.ceil(needed_s * CONTROL_HZ))} commands a chunk, or compute faster (bench does not mind)"
            )
        return "good", found

    # ---- what it looks at and listens to

    def image(self) -> Answer:
        if hidden := self.hidden(False):
            return "unknown", hidden
        questions = self.raw(self.still)
        seen = self.commands(questions)
        rng = np.random.default_rng(0)
        images = [question.seen for question in questions]
        others = [
            images[1:] + images[:1],
            [np.full_like(image, 255) for image in images],
            [rng.integers(0, 256, image.shape, np.uint8) for image in images],
        ]
        changes = [distance(seen, self.commands(with_images(questions, other))) for other in others]
        self.blind = max(changes) <= SLIGHT * size(seen)
        if max(changes) <= SAME:
            return "wrong", (
                "it ignores the image: other scenes, white and noise get the same answer; pass it to the model, and"
                " check the range: images are uint8, 0 to 255, and whole numbers divided by 255 are all 0"
            )
        if self.blind:
            return "wrong", (
                f"the image hardly changes its answers (by {percent(max(changes) / size(seen))}): check the range"
                " that the model expects; images are uint8, 0 to 255, so divide by 255 once or never"
            )
        return "good", "other images get other answers"

    def image_range(self) -> Answer:
        if hidden := self.hidden(self.blind or self.deaf):
            return "unknown", hidden
        questions = self.raw(self.still)
        seen = self.commands(questions)
        for name, change in RANGES.items():
            if distance(seen, self.commands(with_image(questions, change))) <= SLIGHT * size(seen):
                return "wrong", f"{name}: images are uint8, 0 to 255; divide by 255 once, as float, and clip nothing"
        return "good", "dark and bright pixels are distinguished"

    def instruction(self) -> Answer:
        if hidden := self.hidden(False):
            return "unknown", hidden
        right = self.right(self.still)
        sentences = [[replace(q, instruction=q.view.directive((q.gate + n) % 3)) for q in right] for n in range(3)]
        others = [question.view.task.instruction for question in (*right[1:], right[0])]
        sentences.append([replace(q, instruction=other) for q, other in zip(right, others, strict=True)])
        answers = [self.commands(questions) for questions in sentences]
        change = max(distance(answers[0], other) for other in answers[1:])
        self.deaf = change <= SLIGHT * size(answers[0])
        if self.deaf and self.heeds_other_images(sentences):
            self.deaf = False
            return "unknown", "it finds nothing to choose among in the images as they arrive: see the image order"
        if change <= SAME:
            return "wrong", (
                "it ignores the instruction: in one view, all sentences get the same answer; read"
                " observation.instruction"
            )
        if self.deaf:
            return "wrong", (
                f"the instruction hardly changes its answers (by {percent(change / size(answers[0]))}): it was not"
                " trained to follow it, or receives it in another form (tokenizer, prompt, upper case)"
            )
        late = self.commands([replace(q, reset_instruction=q.view.directive((q.gate + 1) % 3)) for q in right])
        if distance(late, answers[1]) <= SAME < distance(late, answers[0]):
            return "wrong", (
                "it reads the instruction in reset alone, so that a reasoner's directives never reach it; read"
                " observation.instruction in act"
            )
        return "good", "other sentences get other answers"

    def heeds_other_images(self, sentences: list[list[Question]]) -> bool:
        """Whether its answers differ by sentence once the images come in another order: these are wrong, then."""

        def heeds() -> bool:
            first, *others = [self.commands(questions) for questions in sentences]
            return max(distance(first, other) for other in others) > SLIGHT * size(first)

        return any(self.put_right("image_fix", IMAGES, heeds).values())

    def put_right(self, part: str, changes: Mapping[str, Any], ask: Callable[[], _T]) -> dict[str, _T]:
        """What `ask` gives with each change of the input in turn, by its name; `part` is `image_fix` or `state_fix`."""
        found = {}
        for name, change in changes.items():
            setattr(self, part, change)
            found[name] = ask()
        setattr(self, part, unchanged)
        return found

    # ---- whether its commands mean what ours do

    def image_order(self) -> Answer:
        if hidden := self.hidden(self.blind or self.deaf):
            return "unknown", hidden
        plain = self.agreement()
        if plain < WELL:
            found = self.put_right("image_fix", IMAGES, self.agreement)
            name = max(found, key=lambda each: found[each])
            # If a change of the state is better, the image is not what is wrong.
            by_state = self.put_right("state_fix", STATES, self.agreement) if found[name] >= AGREES else {"": 0.0}
            if max(AGREES, *by_state.values()) <= found[name] and 1 - found[name] < EXPLAINS * (1 - plain):
                self.image_fix, self.explained = IMAGES[name], True
                also = "; or the signs of vy and yaw_rate are both inverted" if "mirrored" in name else ""
                return "wrong", (
                    f"the image does not arrive as it is: {name}{also} (agreement with the expert {plain:.2f} of 1, put"
                    f" right {found[name]:.2f})"
                )
        if plain < AGREES:
            return "unknown", f"no other order suits it better (agreement with the expert {plain:.2f} of 1)"
        return "good", f"it turns to the gate that is asked for (agreement with the expert {plain:.2f} of 1)"

    def state(self) -> Answer:
        if hidden := self.hidden(self.blind or self.deaf):
            return "unknown", hidden
        questions = self.follows()
        plain, expected = self.commands(questions), expected_of(questions)
        away = self.commands([replace(q, state=np.array([-1.0, 1.0, 0.5, 2.5, -0.5])) for q in questions])
        if distance(plain, away) <= SAME:
            return "good", "it does not use velocity, height or yaw rate"
        error = distance(plain, expected)
        found = self.put_right("state_fix", STATES, lambda: distance(self.commands(questions), expected))
        best, *others = sorted(found, key=lambda each: found[each])
        if found[best] < EXPLAINS * error:
            self.state_fix, self.explained = STATES[best], True
            # A policy that hardly uses some of the numbers cannot show which of them took whose place.
            alike = [best, *(other for other in others if found[other] < found[best] + ALIKE * error)]
            return "wrong", (
                f"the state does not arrive as it is: {', or '.join(alike)}; it is velocity x, y, z (m/s), height (m),"
                f" yaw rate (rad/s) (error {error:.3f}, put right {found[best]:.3f})"
            )
        return "good", "no other order or sign of the state suits it better"

    def signs(self) -> Answer:
        questions = [*self.every_gate(), *self.right(self.flying)]
        answers, expected = self.commands(questions), expected_of(questions)
        own = [correlation(answers[:, i], expected[:, i]) for i in range(4)]
        if max(map(abs, own)) < SAME:
            return "wrong", "all its commands are zero: it hovers whatever it sees"
        if self.blind and self.deaf:
            return "unknown", "what is wrong above hides it"
        for i, j in itertools.permutations(range(4), 2):
            other = abs(correlation(answers[:, i], expected[:, j]))
            if other > max(FOLLOWS, abs(own[i]) + 0.1):
                self.explained = True
                return "wrong", (
                    f"its component {i} follows what should be {AXES[j]}, not {AXES[i]}: the order is vx, vy, vz,"
                    " yaw_rate"
                )
        if wrong := [i for i, value in enumerate(own) if value < -INVERTED]:
            self.signs_fix[wrong], self.explained = -1.0, True
            names = " and ".join(AXES[i] for i in wrong)
            return "wrong", (
                f"the sign of {names} is inverted: commands are in the heading frame, x forward, y left, z up, and yaw"
                " turns left"
            )
        return "good", "x forward, y left, z up, yaw to the left"

    def scale(self) -> Answer:
        if self.blind or self.deaf:
            return "unknown", "what is wrong above hides it"
        questions = [question for question in self.follows() if question.view.flying]
        answers, expected = self.commands(questions), expected_of(questions)
        slopes = {
            i: float((answers[:, i] * expected[:, i]).sum() / (expected[:, i] ** 2).sum())
            for i in range(4)
            if correlation(answers[:, i], expected[:, i]) > INVERTED
        }
        odd = {i: slope for i, slope in slopes.items() if not SLOWEST <= slope <= FASTEST and i != 2}
        if odd:
            self.explained = True
            scales = ", ".join(f"{AXES[i]} {slope:.2g} times" for i, slope in odd.items())
            return "wrong", (
                f"its commands have another scale than the expert's: {scales}; un-normalise with the statistics of the"
                " training data, to m/s and rad/s (harmless if it is meant to fly at that speed)"
            )
        if (beyond := np.flatnonzero(self.subject.largest > 3 * LIMITS)).size:
            i = int(beyond[0])
            return "wrong", (
                f"{AXES[i]} reaches {self.subject.largest[i]:.3g}, and {LIMITS[i]:g} is flown at most: give m/s and"
                " rad/s"
            )
        if not slopes:
            return "unknown", "its commands do not follow the expert's"
        return "good", f"{np.mean([*slopes.values()]):.2f} times the expert's commands"

    def hidden(self, by_what_is_above: bool) -> str:
        """Why a question cannot be asked; empty if it can."""
        if self.privileged:
            return "it flies by privileged state"
        return "what is wrong above hides it" if by_what_is_above else ""

    def flight(self) -> Answer:
        plain = self.agreement()
        if plain >= AGREES:
            return "good", "it flies towards the gate that is asked for"
        if self.explained or self.blind or self.deaf:
            return "unknown", "what is wrong above explains it"
        return "wrong", (
            f"it does not turn to the gate that is asked for (agreement with the expert {plain:.2f} of 1), and no"
            " question here explains it: compare its input with a frame of the training data, then look at the training"
        )
