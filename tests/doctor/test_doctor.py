"""The examination names what is wrong with a policy, and finds nothing wrong with those that fly."""

import contextlib
import io

import numpy as np
import pytest
from broken_pilots import IMAGES, STATES, Remembering, Seeker, Slow

from cognitivedrone.cli import main
from cognitivedrone.doctor import report
from cognitivedrone.doctor.examination import examine
from cognitivedrone.doctor.subject import Subject, look_around
from cognitivedrone.errors import PluginError
from cognitivedrone.policies import colour_seeker, make_policy
from cognitivedrone.policies.colour_seeker import find_gate
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import serving


@pytest.fixture(scope="module")
def views():
    return look_around(3)


@pytest.fixture(scope="module")
def all_views():
    """As many as the command looks at."""
    return look_around()


@pytest.fixture(scope="module", autouse=True)
def an_image_is_searched_once():
    """The tests show the heuristic pilot the same few images again and again."""
    known = {}

    def remembered(image, *facts):
        key = (hash(image.tobytes()), *facts)
        if key not in known:
            known[key] = find_gate(image, *facts)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(colour_seeker, "find_gate", remembered)
        yield


def wrong_with(policy, views, clock=lambda: 0.0):
    """What is wrong, by question."""
    found = list(examine(Subject(policy, clock), views))
    return {finding.question: finding.sentence for finding in found if finding.verdict == "wrong"}


def test_nothing_is_wrong_with_pilots_that_fly(views):
    for policy in (make_policy("oracle"), Seeker(), Remembering()):
        assert wrong_with(policy, views) == {}


FAULTS = {
    "nan": ("answers", "not all of it is a finite number"),
    "shape": ("answers", "return one action as [[vx, vy, vz, yaw_rate]]"),
    "writes": ("answers", "writes into the observation's image"),
    "reuses": ("answers", "overwrites it; return a copy"),
    "noise": ("determinism", "switch dropout off"),
    "remembers": ("memory", "reset must clear all memory"),
    "raises at foreign text": ("odd input", "UnicodeEncodeError"),
    "long": ("chunk length", "40 commands, which are flown for 4.0 s without looking"),
    "blind": ("image", "it ignores the image"),
    "divided": ("image", "whole numbers divided by 255 are all 0"),
    "deaf": ("instruction", "it ignores the instruction"),
    "reset only": ("instruction", "in reset alone"),
    "constant": ("image", "it ignores the image"),
    "bgr": ("image order", "red and blue channels are exchanged (it expects BGR"),
    "transposed": ("image order", "rows and columns are exchanged"),
    "turned": ("image order", "turned by 90 degrees to the right"),
    "yaw": ("signs", "the sign of yaw_rate (left) is inverted"),
    "left": ("signs", "the sign of vy (left) is inverted"),
    "backwards": ("signs", "the sign of vx (forward) is inverted"),
    "vertical first": ("signs", "component 2 follows what should be vx (forward), not vz (up)"),
    "normalised": ("scale", "un-normalise"),
    "half": ("scale", "un-normalise"),
    "degrees": ("scale", "give m/s and rad/s"),
    "centimetres": ("scale", "un-normalise"),
}


@pytest.mark.parametrize("how", FAULTS)
def test_each_fault_is_named(views, how):
    question, sentence = FAULTS[how]
    wrong = wrong_with(Seeker(how), views)
    assert sentence in wrong[question]
    assert set(wrong) <= {question, "instruction"}


def test_a_pilot_that_errs_once_in_twenty_is_not_deterministic(views):
    class Errs(Seeker):  # type: ignore[misc]  # the support module has no types
        rng = np.random.default_rng(3)

        def act(self, observation):
            return super().act(observation) * (-1 if self.rng.random() < 0.05 else 1)

    assert "switch dropout off" in wrong_with(Errs(), views)["determinism"]


MODEL_FAULTS = {
    "mirrored": ("image order", "mirrored left to right"),
    "upside down": ("image order", "upside down"),
    "channels first": ("image order", "channels come first"),
    "height first": ("state", "it is read in the order height, vx, vy, vz, yaw_rate"),
    "height and yaw rate": ("state", "height and yaw_rate are exchanged"),
    "velocity reversed": ("state", "vx and vz are exchanged"),
    "twice": ("scale", "un-normalise"),
}
"""Which take a pilot that uses the whole image, or all of the state."""


LESS_LIKELY = {"channels first", "upside down", "mirrored", "height and yaw rate", "velocity reversed"}


@pytest.mark.parametrize(
    "how", [pytest.param(how, marks=[pytest.mark.slow] * (how in LESS_LIKELY)) for how in MODEL_FAULTS]
)
def test_faults_around_a_model_are_named(request, how):
    question, sentence = MODEL_FAULTS[how]
    views = request.getfixturevalue("all_views" if how in LESS_LIKELY else "views")
    wrong = wrong_with(Remembering(how), views)
    assert sentence in wrong[question]
    assert set(wrong) == {question}


def test_every_fault_that_the_tests_can_make_of_image_and_state_is_found(views):
    unused = {"velocity reversed", "yaw rate right"}  # by the heuristic pilot
    for how in sorted({**IMAGES, **STATES}.keys() - FAULTS.keys() - unused):
        found = examine(Subject(Seeker(how), lambda: 0.0), views)
        assert any(finding.verdict == "wrong" for finding in found), how


def test_what_is_too_slow_for_10_hz_is_reported_by_its_own_clock(views):
    assert "350 ms for 1 command of 100 ms each: too slow" in wrong_with(Slow(), views, lambda: Slow.now)["latency"]


def test_the_command_examines_plug_ins_and_remote_policies(views, monkeypatch, capsys):
    monkeypatch.setattr(report, "look_around", lambda seed: views)
    with serving(ServePlan.of(policy="broken_pilots:Seeker:bgr", reasoner="none", port=0)) as address:
        for name in ("broken_pilots:Seeker:bgr", f"remote:ws://{address}"):
            with pytest.raises(SystemExit) as end:
                main(["doctor", "--policy", name])
            assert end.value.code == 1
            printed = " ".join(capsys.readouterr().out.split())
            assert "WRONG image order the image does not arrive as it is: its red and blue channels" in printed
            assert "1 thing is wrong with" in printed
    main(["doctor", "--policy", "broken_pilots:Seeker"])
    assert "nothing wrong was found with broken_pilots:Seeker" in capsys.readouterr().out


def test_an_unknown_policy_is_one_sentence():
    with pytest.raises(PluginError, match="unknown policy 'smal'"), contextlib.redirect_stdout(io.StringIO()):
        report.examined("smal")
