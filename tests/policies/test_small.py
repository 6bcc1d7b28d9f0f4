"""The small policy: what it passes to the network, and what it says to bad input."""

import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from tiny import open_model_file
from typechecked import unchecked

from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import NonFiniteAction, PolicyError
from cognitivedrone.labels import load_pack
from cognitivedrone.policies import make_policy
from cognitivedrone.policies.small import Decision, Presence, Race, Small
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import EpisodeContext, Observation

TEXT = "Fly through the letter a"
OBSERVATION = Observation(
    image=np.full((256, 256, 3), 51, np.uint8),
    instruction=TEXT,
    velocity=np.array([0.1, 0.2, 0.3], np.float32),
    height=0.8,
    yaw_rate=-0.25,
    time=0.0,
)


@pytest.fixture
def policy(tmp_path):
    made = Small(open_model_file(tmp_path / "model.onnx"))
    made.reset(EpisodeContext(TEXT))
    return made


def test_the_network_sees_frame_motion_and_sentence(policy):
    chunk = policy.act(OBSERVATION)
    assert (chunk.shape, chunk.dtype) == ((2, 4), np.float32)
    assert np.allclose(chunk, [[0.2, 0.8, 0.36, -0.25]] * 2)  # toward the second gate, whose middle is 0.3 m above


def test_a_directive_that_changes_in_flight_is_followed(policy):
    texts = (TEXT, "Fly through the gate with letter b", TEXT)
    chosen = []
    for text in texts:
        policy.act(replace(OBSERVATION, instruction=text))
        chosen.append(policy.last.choice.argmax())
    assert chosen[0] == chosen[2] != chosen[1]


def test_near_a_gate_it_flies_to_the_height_of_its_opening(policy, monkeypatch):
    see = policy.model.eyes.see
    climbs = []
    for v, distance in ((160.0, 2.0), (90.0, 2.0), (160.0, 1.0), (160.0, 8.0), (90.0, 8.0)):

        def seeing(images, v=v, distance=distance):
            sight = see(images)
            gates = sight.gates.copy()
            gates[..., 1], gates[..., 3] = v, distance
            return replace(sight, gates=gates)

        monkeypatch.setattr(policy.model.eyes, "see", seeing)
        climbs.append(policy.act(OBSERVATION)[0, 2])
    low, high, nearer, far, far_high = climbs
    assert low < 0 < high
    assert nearer > low  # the same place in the image is less far below it
    assert far == far_high  # where only the network knows


@pytest.mark.parametrize(("text", "says"), [("", "empty"), (" \n\t", "empty"), ("gate " * 2000, "10000 characters")])
def test_an_instruction_that_says_nothing_or_too_much(policy, text, says):
    with pytest.raises(PolicyError, match=says):
        policy.reset(EpisodeContext(text))
    with pytest.raises(PolicyError, match=says):
        policy.act(replace(OBSERVATION, instruction=text))
    assert np.isfinite(policy.act(OBSERVATION)).all()


@pytest.mark.parametrize(
    ("image", "says"),
    [
        (np.zeros((128, 128, 3), np.uint8), r"uint8 \(128, 128, 3\)"),
        (np.zeros((256, 256, 3), np.float32), "float32"),
        (np.zeros((256, 256), np.uint8), r"\(256, 256\)"),
        (np.zeros((256, 256, 4), np.uint8), r"\(256, 256, 4\)"),
    ],
)
def test_an_image_of_the_wrong_size_or_type(policy, image, says):
    with unchecked(), pytest.raises(PolicyError, match=says):
        policy.act(replace(OBSERVATION, image=image))


@pytest.mark.parametrize(
    "text", ["Volez à travers la porte rouge", "飛行機へ進め", "\U0001f600", "x" * 1000, "gate " * 200]
)
def test_any_sentence_is_flown_without_a_warning(policy, text):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        policy.reset(EpisodeContext(text))
        assert np.isfinite(policy.act(replace(OBSERVATION, instruction=text))).all()


def test_an_answer_that_is_not_finite_is_not_flown(policy):
    with pytest.raises(NonFiniteAction, match="nan"):
        policy.act(replace(OBSERVATION, yaw_rate=float("nan")))


@pytest.mark.parametrize(
    ("part", "says"),
    [("inclination", "choice holds values that are not numbers.*weights are damaged"), ("options", "nan")],
)
def test_what_is_not_a_number_ends_the_flight_instead_of_a_search_without_end(policy, monkeypatch, part, says):
    fly = policy.model.fly

    def broken(*inputs):
        flown = fly(*inputs)
        return replace(flown, **{part: np.full_like(getattr(flown, part), np.nan)})

    monkeypatch.setattr(policy.model, "fly", broken)
    with pytest.raises(NonFiniteAction, match=says):
        policy.act(OBSERVATION)


def test_a_model_file_is_given_behind_the_name(tiny_model_file):
    policy = make_policy(f"small:{tiny_model_file}")
    assert isinstance(policy, Small)
    assert policy.model.description.name == "tiny"
    racer = make_policy(f"race:{tiny_model_file}")
    assert isinstance(racer, Race)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        racer.reset(EpisodeContext("Take the gate of the pangolin"))


def test_a_package_without_weights_says_what_to_do(monkeypatch):
    monkeypatch.setattr(Small, "weights", "none")
    with pytest.raises(PolicyError, match=r"no model none: reinstall cognitivedrone, or train one"):
        Small()


def test_the_runtime_is_loaded_with_the_first_model_alone():
    listed = "[name for name in sys.modules if name.startswith('onnx')]"
    code = f"import sys, cognitivedrone.policies.small as _; print({listed})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# ---- declining


def answer(present, *, scores=(0.9, 0.9, 0.9), distances=(3.0, 3.0, 3.0)):
    gates = np.zeros((3, 4), np.float32)
    gates[:, 2], gates[:, 3] = scores, distances
    return Decision(np.zeros((2, 4), np.float32), np.full(4, 0.25, np.float32), gates, present)


def after(*answers):
    presence = Presence()
    return [presence.update(each) for each in answers]


def test_it_declines_when_the_first_frames_agree_and_not_before():
    assert after(*[answer(0.01)] * 10) == [False] * 3 + [True] * 7
    assert not any(after(*[answer(0.01), answer(0.6)] * 20))
    assert not any(after(*[answer(0.5)] * 40))
    # Single frames that see it are doubts, and not more.
    assert after(*[answer(0.01)] * 12, answer(0.5), answer(0.01))[-3:] == [True] * 3


def test_it_resumes_only_when_it_is_sure_again():
    gone = [answer(0.0)] * 10
    assert after(*gone, *[answer(0.3)] * 40)[-1]
    resumed = after(*gone, *[answer(0.9)] * 20)
    assert resumed[9]
    assert not resumed[-1]
    first = resumed.index(False, 9)
    assert first > 11
    assert resumed[9:] == [True] * (first - 9) + [False] * (len(resumed) - first)


@pytest.mark.parametrize(
    "unclear",
    [answer(0.0, scores=(0.9, 0.9, 0.2)), answer(0.0, distances=(3.0, 1.0, 3.0)), answer(None)],
    ids=["two-gates", "near", "cannot-tell"],
)
def test_frames_that_cannot_tell_change_nothing(unclear):
    assert not any(after(*[unclear] * 50))
    assert all(after(*[answer(0.0)] * 4, *[unclear] * 20)[3:])
    assert after(*[answer(0.0), unclear] * 3, answer(0.0))[-2:] == [False, True]


@pytest.fixture
def declining(tmp_path):
    made = Small(open_model_file(tmp_path / "open.onnx"))
    made.reset(EpisodeContext(TEXT))
    return made


WHITE = replace(OBSERVATION, image=np.full((256, 256, 3), 255, np.uint8))
"""In which, the tiny model says, no gate shows what is asked for."""


def test_a_policy_that_declines_hovers_and_says_so(declining):
    for _ in range(3):
        assert declining.act(WHITE).any()
        assert not declining.declines
    chunk = declining.act(WHITE)
    assert declining.declines
    assert (chunk.shape, chunk.dtype) == ((2, 4), np.float32)
    assert not chunk.any()
    assert declining.last.action.any()  # viewers see what the network said


def test_another_sentence_or_flight_is_judged_anew(declining):
    for _ in range(8):
        declining.act(WHITE)
    assert declining.act(replace(WHITE, instruction="the letter A")).any()
    assert not declining.declines
    for _ in range(8):
        declining.act(replace(WHITE, instruction="the letter A"))
    declining.reset(EpisodeContext("the letter A"))
    assert not declining.declines
    assert declining.act(replace(WHITE, instruction="the letter A")).any()


def test_where_it_is_there_nothing_is_declined(declining):
    for _ in range(30):
        assert declining.act(replace(OBSERVATION, image=np.zeros((256, 256, 3), np.uint8))).any()
    assert not declining.declines


def several(count):
    return [
        replace(OBSERVATION, height=0.1 * (row + 1), instruction=(TEXT, "the letter c")[row % 2])
        for row in range(count)
    ]


@pytest.mark.parametrize("argument", ["", ",stack=3", ",stack=16"])
def test_several_flights_at_once_get_the_answers_of_each_alone(tmp_path, argument):
    path = open_model_file(tmp_path / "model.onnx")
    policy = make_policy(f"small:{path}{argument}")
    forks = [policy.fork() for _ in range(7)]
    for fork in forks:
        fork.reset(EpisodeContext(TEXT))
    answers = policy.act_batch(forks, several(7))
    for seen, answer in zip(several(7), answers, strict=True):
        assert not isinstance(answer, Exception)
        alone = Small(path)
        alone.reset(EpisodeContext(TEXT))
        assert not isinstance(answer, Exception)
        assert np.array_equal(answer, alone.act(seen))
    policy.close()


def test_a_frame_that_will_not_do_disturbs_no_other_flight(policy):
    forks = [policy.fork() for _ in range(4)]
    observations = several(4)
    observations[1] = replace(observations[1], instruction=" ")
    observations[2] = replace(observations[2], image=np.zeros((8, 8, 3), np.uint8))
    good, empty, small, last = policy.act_batch(forks, observations)
    assert isinstance(empty, PolicyError)
    assert isinstance(small, PolicyError)
    assert np.array_equal(good, forks[0].act(observations[0]))
    assert np.array_equal(last, forks[3].act(observations[3]))
    policy.close()


def test_a_network_that_fails_fails_every_flight_of_the_batch(policy, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(policy.model, "fly", fail)
    answers = policy.act_batch([policy.fork() for _ in range(3)], several(3))
    assert [str(answer) for answer in answers] == ["out of memory"] * 3
    policy.close()


def test_a_fork_shares_the_network_and_no_state(tmp_path):
    made = Small(open_model_file(tmp_path / "open.onnx"))
    made.reset(EpisodeContext(TEXT))
    made.declines, made._presence.frames = True, 9
    fork = made.fork()
    assert fork.model is made.model
    assert (fork.declines, fork._presence.frames, fork.last) == (False, 0, None)
    fork.reset(EpisodeContext("Fly through the red gate with the letter A"))
    assert made._presence.frames == 9


def test_a_stack_of_nothing_is_refused():
    with pytest.raises(PolicyError, match="stack is 0; it must be at least 1"):
        make_policy("small:stack=0")


# ---- the picture classifier's opinions


@pytest.fixture(scope="module")
def stage_frame():
    """What a drone sees at the start of a stage with three animals."""
    suite = load_suite("open-v1:test")
    # The second one: in the first, a panel is cut by the edge of the image.
    _, animals, *_ = (number for number, track in enumerate(suite.tracks) if track[0].family == "animals")
    with Worlds(1, load_pack("open-v1"), TrackConfig()) as worlds:
        worlds.begin(0, suite, animals, 0)
        return worlds.simulator.frames(worlds=[0])[0].copy()


def test_the_classifier_is_asked_about_one_panel_a_frame_and_its_opinions_are_of_one_flight(stage_frame):
    made = Small()
    seen = replace(OBSERVATION, image=stage_frame, velocity=np.zeros(3, np.float32), height=1.5, yaw_rate=0.0)
    made.reset(EpisodeContext(TEXT))
    choices = []
    for asked in (1, 2, 3, 3):
        made.act(seen)
        choices.append(made.last.choice.tolist())
        assert len(made._opinions.asked) == asked
    assert choices[0] != choices[1] != choices[2] == choices[3]
    other = made.fork()
    assert not other._opinions.asked
    other.reset(EpisodeContext(TEXT))
    others = [made.fork(), made.fork()]
    for each in others:
        each.reset(EpisodeContext(TEXT))
    for number in range(4):
        other.act(seen)
        made.act_batch(others, [seen] * 2)
        assert [each.last.choice.tolist() for each in others] == [choices[number]] * 2
    assert other._opinions.asked == made._opinions.asked
    made.act(replace(seen, instruction="Fly through the gate with the cat"))
    assert len(made._opinions.asked) == 1
    made.reset(EpisodeContext(TEXT))
    assert not made._opinions.asked
    made.close()


# ---- obstacles


class SeesWall:
    """An eye that sees a wall 0.4 m ahead, in the left two thirds of every frame but black ones."""

    def look(self, images):
        occupied = np.zeros((len(images), 16, 16), np.float32)
        occupied[images.any(axis=(1, 2, 3)), :, :10] = 0.9
        return occupied, np.full_like(occupied, 0.4)


@pytest.fixture
def walled(policy):
    policy._eye = SeesWall()
    return policy


BLACK = replace(OBSERVATION, image=np.zeros((256, 256, 3), np.uint8))
AHEAD = replace(OBSERVATION, velocity=np.zeros(3, np.float32))


def test_every_command_of_a_chunk_flies_around_what_the_eye_sees(walled):
    straight = Small.act(walled.fork(), BLACK)
    chunk = walled.act(AHEAD)
    assert chunk.shape == straight.shape == (2, 4)
    assert chunk.dtype == np.float32
    assert (chunk != walled.last.action).any(axis=1).all()
    assert (np.linalg.norm(chunk[:, :3], axis=1) <= np.linalg.norm(walled.last.action[:, :3], axis=1) + 1e-6).all()
    assert np.array_equal(straight, walled.fork().act(BLACK))


def test_flights_at_once_fly_around_obstacles_as_each_alone(walled):
    observations = [replace(seen, velocity=np.zeros(3, np.float32)) for seen in several(5)]
    answers = walled.act_batch([walled.fork() for _ in range(5)], observations)
    for seen, answer in zip(observations, answers, strict=True):
        assert np.array_equal(answer, walled.fork().act(seen))
    walled.close()


def test_an_eye_that_fails_fails_the_flight(walled, monkeypatch):
    def fail(_):
        raise PolicyError("the obstacle eye answers with values that are not numbers")

    monkeypatch.setattr(walled._eye, "look", fail, raising=True)
    with pytest.raises(PolicyError, match="not numbers"):
        walled.act(OBSERVATION)


def test_it_flies_without_its_eye_where_it_is_told_to(tmp_path):
    policy = make_policy(f"small:{open_model_file(tmp_path / 'model.onnx')},avoid=no")
    policy.reset(EpisodeContext(TEXT))
    assert np.array_equal(policy.act(AHEAD), policy.last.action)
    assert policy.last.occupied is None


def test_a_racing_policy_has_no_eye():
    assert Race()._eye is None
    assert Race().act(OBSERVATION).shape == (1, 4)


# ---- directives


def test_a_directive_is_followed_by_looks_alone(policy, monkeypatch):
    """What panels show, and what a language makes of it, says nothing about which gate is the small red round one."""
    looks = np.zeros((3, 8), np.float32)
    looks[:, [0, 3, 6]] = 0.97  # red, round, big
    looks[1, [0, 1]] = 0.0, 0.97  # green
    looks[2, [0, 2, 6, 7]] = 0.0, 0.97, 0.1, 0.9  # blue, small
    see = policy.model.eyes.see

    def seeing(images):
        sight = see(images)
        slots = sight.slots.copy()
        slots[..., -8:] = looks
        return replace(sight, slots=slots)

    monkeypatch.setattr(policy.model.eyes, "see", seeing)
    for text, gate in (("Fly through the big green gate", 1), ("Fly through the small red round gate", 0)):
        policy.act(replace(OBSERVATION, instruction=text))
        assert policy.last.choice.argmax() == gate  # of another size than read, but the only red one
        assert not policy.declines
    for _ in range(8):
        policy.act(replace(OBSERVATION, instruction="Fly through the blue square gate"))
    assert policy.declines
