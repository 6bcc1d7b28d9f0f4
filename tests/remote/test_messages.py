"""What messages contain, and what is said of those that contain something else."""

import json

import numpy as np
import pytest
from policy_clients import observation

from cognitivedrone.errors import (
    ActionError,
    MessageError,
    NonFiniteAction,
    PolicyError,
    ReasonerError,
    ServerError,
)
from cognitivedrone.remote.messages import (
    check_protocol,
    code_of,
    error_frame,
    observation_message,
    pack,
    raise_error,
    read_ask,
    read_guidance,
    read_observation,
    read_resets,
    reset_message,
    unpack,
)
from cognitivedrone.types import EpisodeContext, Observation


def test_the_policy_on_the_server_sees_the_same_numbers():
    rng = np.random.default_rng(0)
    seen = Observation(
        image=rng.integers(0, 256, (256, 256, 3), dtype=np.uint8), instruction="Fly through the gate with 3×4",
        velocity=rng.normal(size=3).astype(np.float32), height=float(rng.normal()), yaw_rate=float(rng.normal()),
        time=1 / 3,
    )  # fmt: skip
    read = read_observation(unpack(pack(observation_message(seen))), 0.0)
    assert np.array_equal(read.image, seen.image)
    assert read.velocity.dtype == np.float32
    assert np.array_equal(read.velocity, seen.velocity)
    assert (read.instruction, read.height, read.yaw_rate, read.time) == (
        seen.instruction, seen.height, seen.yaw_rate, seen.time,
    )  # fmt: skip


def test_a_client_may_leave_out_the_time():
    assert read_observation(observation(), 2.5).time == 2.5


@pytest.mark.parametrize("name", ["observation/image", "observation/state", "prompt"])
def test_a_missing_field_is_named(name):
    message = observation()
    del message[name]
    with pytest.raises(MessageError, match=f"no '{name}'; it has ") as caught:
        read_observation(message, 0.0)
    assert caught.value.code == "missing_field"


IMAGE = np.zeros((256, 256, 3), np.uint8)


@pytest.mark.parametrize(
    "changed",
    [
        {"observation__image": IMAGE[:255]}, {"observation__image": IMAGE.astype(np.float32)},
        {"observation__image": IMAGE[None]}, {"observation__image": [1, 2]}, {"observation__image": "image"},
        {"observation__state": np.zeros(4)}, {"observation__state": np.zeros((1, 5))},
        {"observation__state": np.array([0, 0, np.nan, 1, 0])},
        {"observation__state": np.array([0, 0, np.inf, 1, 0])},
        {"observation__state": np.array([0, 0, -1e300, 1, 0])}, {"observation__state": np.full(5, -(2**63))},
        {"observation__state": np.zeros(5, bool)}, {"observation__state": [0.0] * 5}, {"prompt": 3},
        {"prompt": b"Fly"}, {"prompt": "x" * 10_001}, {"time": "now"}, {"time": float("nan")}, {"time": True},
        {"time": [1]},
    ],
)  # fmt: skip
def test_a_field_of_another_kind_is_refused_in_one_sentence(changed):
    with pytest.raises(MessageError, match=next(iter(changed)).replace("__", "/")) as caught:
        read_observation(observation(**changed), 0.0)
    assert caught.value.code == "bad_field"
    assert len(str(caught.value)) < 200


def test_stages_begin_as_the_client_says():
    contexts = [EpisodeContext("a", 5, 0), EpisodeContext("b", 5, 1), EpisodeContext("c", 5, 1, same_stage=True)]
    assert read_resets({"reset": [reset_message(context) for context in contexts]}) == contexts
    assert read_resets({"reset": True, "prompt": "c"}) == [EpisodeContext("c")]
    assert read_resets({}) is read_resets({"reset": False}) is None


@pytest.mark.parametrize(
    "reset",
    [1, "yes", {}, [3], [{}], [{"prompt": "a", "stage": -1}], [{"prompt": "a", "seed": 2**40}],
     [{"prompt": "a", "stage": True}], [{"prompt": "a"}] * 257],
)  # fmt: skip
def test_any_other_reset_is_refused(reset):
    with pytest.raises(MessageError):
        read_resets({"reset": reset})


def test_what_is_asked_for_is_checked():
    assert (read_ask({}), read_ask({"ask": "policy"})) == ("pilot", "policy")
    for ask in ("poem", 3, [1], {}, np.zeros(2)):
        with pytest.raises(MessageError, match="expected pilot, policy, guidance"):
            read_ask({"ask": ask})


def test_another_version_and_another_session_are_refused():
    check_protocol({}, "a")
    check_protocol({"protocol": 1, "session": "a"}, "a")
    with pytest.raises(MessageError, match="version 2 of the protocol, this server 1; install the same") as caught:
        check_protocol({"protocol": 2}, "a")
    assert caught.value.code == "protocol_version"
    with pytest.raises(MessageError, match="no session 'b'") as caught:
        check_protocol({"session": "b"}, "a")
    assert caught.value.code == "unknown_session"
    for strange in (np.zeros(2), [], None, 1.0, True):
        for key in ("protocol", "session"):
            with pytest.raises(MessageError):
                check_protocol({key: strange}, "a")


@pytest.mark.parametrize(
    "error",
    [
        PolicyError("no"), ActionError("no"), NonFiniteAction("no"), ReasonerError("unsure", "no"),
        ReasonerError("unsure", "no", certainty=0.75),
    ],
)  # fmt: skip
def test_a_policys_error_is_raised_as_what_it_was(error):
    reported = {"fault": getattr(error, "kind", None), "certainty": getattr(error, "certainty", None)}
    frame = error_frame(code_of(error), str(error), **reported)
    with pytest.raises(type(error), match=r"^no$") as caught:
        raise_error(frame, "here")
    assert type(caught.value) is type(error)
    assert getattr(caught.value, "kind", None) == reported["fault"]
    assert getattr(caught.value, "certainty", None) == reported["certainty"]


@pytest.mark.parametrize("strange", [2, -0.5, "0.5", None, [], float("nan")])
def test_a_certainty_that_is_no_share_is_none(strange):
    frame = json.dumps({"error": {"code": "no_answer", "message": "no", "fault": "unsure", "certainty": strange}})
    with pytest.raises(ReasonerError) as caught:
        raise_error(frame, "here")
    assert caught.value.certainty is None


STRANGE = [
    '{"error": {"code": [], "message": "no"}}',
    '{"error": {"code": "no_answer", "fault": {}, "message": "no"}}',
    '{"error": ' * 2000 + "1" + "}" * 2000,
]


@pytest.mark.parametrize(
    "frame", ["Traceback\n  ...\nKeyError: 'x'", '{"error": 3}', "[]", "", "\n", '{"error": {}}', *STRANGE]
)
def test_any_other_servers_error_is_reported_by_its_last_line(frame):
    with pytest.raises(ServerError, match="the policy server at here failed: ") as caught:
        raise_error(frame, "here")
    assert "\n" not in str(caught.value)
    if "KeyError" in frame:
        assert str(caught.value).endswith("KeyError: 'x'")


def test_a_refusal_is_reported_with_its_code():
    with pytest.raises(ServerError, match=r"refused the message \(busy\): later"):
        raise_error(json.dumps({"error": {"code": "busy", "message": "later"}}), "here")


def test_guidance_without_a_part_is_a_fault():
    with pytest.raises(ReasonerError, match="'gate'"):
        read_guidance({"directive": "x"})
