"""The policy and the reasoner on a server: the same answers to the bit, and what happens where there are none."""

import re
import threading
import time
import warnings

import numpy as np
import pytest
from policy_clients import openpi_server

from cognitivedrone.control.calls import begin_stage
from cognitivedrone.errors import ActionError, NonFiniteAction, PluginError, PolicyError, ReasonerError, ServerError
from cognitivedrone.policies import make_policy, remote
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.remote import connection
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import serving
from cognitivedrone.types import EpisodeContext, Observation

INSTRUCTION = "Fly through the red gate with the letter A"


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """Nothing waits for long."""
    monkeypatch.setattr(connection, "_FIRST_WAIT_S", 0.01)
    monkeypatch.setattr(connection, "_LONGEST_WAIT_S", 0.05)


@pytest.fixture
def pilot():
    """Makes served policies and closes them."""
    made = []

    def make(address, *, reasoner=False, **options):
        text = f"remote:ws://{address}" + "".join(f",{name}={value}" for name, value in options.items())
        made.append((make_reasoner if reasoner else make_policy)(text))
        made[-1].check()
        return made[-1]

    yield make
    for one in made:
        one.close()


def seen(step=0, instruction=INSTRUCTION, height=1.0):
    rng = np.random.default_rng(step)
    image = rng.integers(0, 256, (256, 256, 3), dtype=np.uint8)
    return Observation(image, instruction, rng.normal(size=3).astype(np.float32), height, 0.1, step / 10)


@pytest.mark.parametrize("name", ["colour_seeker", "random", "small:FILE", "small:FILE,stack=4"])
def test_a_served_policy_answers_to_the_bit_as_a_local_one(name, pilot, tiny_model_file):
    name = name.replace("FILE", str(tiny_model_file))
    with serving(ServePlan.of(policy=name, port=0)) as address:
        here, there = make_policy(name), pilot(address)
        assert there.needs_seed == here.needs_seed
        for stage, text in enumerate([INSTRUCTION, "Fly through the small round gate"]):
            for policy in (here, there):
                begin_stage(policy, EpisodeContext(text, seed=11, stage=stage))
            for step in range(3):
                expected, answered = here.act(seen(step, text)), there.act(seen(step, text))
                assert answered.dtype == expected.dtype == np.float32
                assert np.array_equal(answered, expected)
                assert there.declines == here.declines
                assert there.present == here.present
    here.close()


def test_a_session_hears_of_every_stage_even_of_those_without_a_frame(pilot):
    with serving(ServePlan.of(policy="served_pilots:Counting", port=0)) as address:
        policy = pilot(address)
        policy.reset(EpisodeContext("first"))
        policy.reset(EpisodeContext("second", stage=1))
        policy.reset(EpisodeContext("third", stage=2))
        assert policy.act(seen(instruction="third", height=2.5)).tolist() == [[2, 1, 5, 2.5]]
        assert policy.act(seen(instruction="a directive")).tolist() == [[2, 2, 11, 1]]
        policy.reset(EpisodeContext("again"))
        assert policy.act(seen(instruction="again please, and decline")).tolist()[0][:2] == [0, 1]
        assert policy.declines


def test_the_errors_of_a_served_policy_are_its_own(pilot):
    with serving(ServePlan.of(policy="served_pilots:Faulty", port=0)) as address:
        policy = pilot(address)
        policy.reset(EpisodeContext("go"))
        for text, error, message in (
            ("raise", PolicyError, "the policy raised ZeroDivisionError: a secret of the server"),
            ("exit", PolicyError, "sys.exit"),
            ("nan", NonFiniteAction, "nan"),
            ("shape", ActionError, r"shape \(2, 3\)"),
            ("text", ActionError, "'str'"),
        ):
            with pytest.raises(error, match=message):
                policy.act(seen(instruction=text))
        assert policy.act(seen(instruction="go")).shape == (1, 4)
        policy.reset(EpisodeContext(" "))
        with pytest.raises(PolicyError, match=r"^the instruction is empty"):
            policy.act(seen(instruction="go"))


def test_a_served_reasoner_answers_as_a_local_one(pilot):
    import served_pilots

    with serving(ServePlan.of(policy="hover", reasoner="served_pilots:Stages", port=0)) as address:
        here, there = served_pilots.Stages(), pilot(address, reasoner=True)
        for stage in (0, 1):
            for reasoner in (here, there):
                begin_stage(reasoner, EpisodeContext(INSTRUCTION, stage=stage))
            for step in (0, 1):
                assert there.refine(seen(step).image, INSTRUCTION) == here.refine(seen(step).image, INSTRUCTION)
        assert there.refine(seen().image, "nothing") == here.refine(seen().image, "nothing")
        with pytest.raises(ReasonerError, match="gates have been in view") as caught:
            there.refine(seen().image, "unsure")
        assert caught.value.kind == "unsure"


def test_a_server_without_a_reasoner_is_no_reasoner():
    with serving(ServePlan.of(policy="hover", port=0)) as address:
        reasoner = make_reasoner(f"remote:ws://{address}")
        with pytest.raises(ServerError, match="has no reasoner; start it with --reasoner NAME"):
            reasoner.check()
        reasoner.close()


def test_a_reasoner_whose_server_is_gone_is_a_fault_of_its_own(pilot):
    with serving(ServePlan.of(policy="hover", reasoner="served_pilots:Stages", port=0)) as address:
        reasoner = pilot(address, reasoner=True, timeout=0.3)
        reasoner.reset(EpisodeContext(INSTRUCTION))
        reasoner.refine(seen().image, INSTRUCTION)
    with pytest.raises(ReasonerError) as caught:
        reasoner.refine(seen().image, INSTRUCTION)
    assert caught.value.kind == "unreachable"


class TestOpenpisServer:
    def test_it_gets_the_observation_and_nothing_else(self, pilot):
        got = []

        def infer(message):
            got.append(message)
            return {"actions": np.arange(8.0).reshape(2, 4)}

        with openpi_server(infer, {"robot": "drone"}) as address:
            policy = pilot(address)
            policy.reset(EpisodeContext(INSTRUCTION))
            chunk = policy.act(seen(3))
            assert pilot(address, rows=1).act(seen(3)).tolist() == [[0, 1, 2, 3]]
        assert chunk.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
        assert chunk.dtype == np.float32
        first, flown = got[:2]
        assert set(first) == set(flown) == {"observation/image", "observation/state", "prompt", "time"}
        assert first["observation/image"].shape == (256, 256, 3)
        assert np.array_equal(flown["observation/image"], seen(3).image)
        assert flown["prompt"] == INSTRUCTION

    @pytest.mark.parametrize("answer", [{}, {"actions": [[1, 2, 3, 4]]}, {"actions": np.array(["a"])[:0].astype(bool)}])
    def test_an_answer_without_actions_is_the_policys_error(self, pilot, answer):
        with openpi_server(lambda _: dict(answer)) as address:
            policy = pilot(address)
            policy.reset(EpisodeContext(INSTRUCTION))
            with pytest.raises(ActionError, match="without an array of actions"):
                policy.act(seen())


class Slow:
    """Answers with the height that it saw, once it may."""

    def __init__(self):
        self.go = threading.Event()
        self.go.set()

    def __call__(self, message):
        assert self.go.wait(60)
        return {"actions": np.full((1, 4), message["observation/state"][3])}


def test_a_late_answer_is_discarded_and_the_drone_holds_meanwhile(pilot):
    slow = Slow()
    with openpi_server(slow) as address:
        policy = pilot(address, deadline=30)
        policy.reset(EpisodeContext(INSTRUCTION, real_time=True))
        assert policy.act(seen(height=1.0)).tolist() == [[1.0] * 4]
        slow.go.clear()
        policy._deadline_s = 0.05
        for height in (2.0, 3.0):
            assert policy.act(seen(height=height)).tolist() == [[0.0] * 4]
            assert "has not answered in time" in policy.trouble
        slow.go.set()
        policy._deadline_s = 30
        assert policy.act(seen(height=4.0)).tolist() == [[4.0] * 4]
        assert policy.trouble == ""


def test_where_a_server_is_killed_in_flight_the_drone_holds_and_flies_on_when_it_returns(pilot):
    plan = ServePlan.of(policy="served_pilots:Counting", port=0)
    with serving(plan) as address:
        policy = pilot(address, deadline=30)
        policy.reset(EpisodeContext(INSTRUCTION, real_time=True))
        assert policy.act(seen()).tolist()[0][:2] == [0, 1]
    policy._deadline_s = 0.05
    assert policy.act(seen()).tolist() == [[0.0] * 4]
    assert re.match(rf"the policy server at ws://{address} (is gone|has not answered)", policy.trouble)
    policy._deadline_s = 30.0
    with serving(plan.changed(port=address.port)):
        assert policy.connection.wait(60)
        assert policy.act(seen()).tolist()[0][:2] == [0, 1]
        assert policy.trouble == ""


def test_in_virtual_time_the_flight_waits_for_the_server(pilot, monkeypatch):
    plan = ServePlan.of(policy="served_pilots:Counting", port=0)
    with serving(plan) as address:
        policy = pilot(address)
        policy.reset(EpisodeContext(INSTRUCTION))
        policy.act(seen())
        policy.act(seen())
    with serving(plan.changed(port=address.port)), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it may be connected again before it is asked
        # The new server knows nothing of the flight; it is told of its stages.
        assert policy.act(seen()).tolist()[0][:2] == [0, 1]
    monkeypatch.setattr(remote, "PATIENCE_S", 0.2)
    with pytest.warns(RuntimeWarning, match="is gone"), pytest.raises(ServerError, match="is gone: "):
        policy.act(seen())


def test_nobody_there_is_reported_before_take_off(monkeypatch):
    monkeypatch.setattr(connection, "CONNECT_S", 0.2)
    policy = make_policy("remote:ws://127.0.0.1:9")
    began = time.monotonic()
    with pytest.raises(
        ServerError, match=r"at ws://127\.0\.0\.1:9 does not answer .*; start one with `cognitivedrone serve`"
    ):
        policy.connection.open(0.2)
    assert time.monotonic() - began < 30
    policy.close()


@pytest.mark.parametrize("token", [None, "another-token-0123456789"])
def test_a_client_without_the_servers_token_is_refused(token, monkeypatch, tmp_path):
    (tmp_path / "token").write_text("the-servers-token-0123456789\n")
    (tmp_path / "token").chmod(0o600)
    plan = ServePlan.of(policy="hover", port=0, token_file=tmp_path / "token")
    with serving(plan) as address:
        monkeypatch.delenv("COGNITIVEDRONE_SERVER_TOKEN", raising=False)
        if token:
            monkeypatch.setenv("COGNITIVEDRONE_SERVER_TOKEN", token)
        policy = make_policy(f"remote:ws://{address}")
        with pytest.raises(ServerError, match=r"refuses this client .*; set COGNITIVEDRONE_SERVER_TOKEN"):
            policy.check()
        policy.close()
        monkeypatch.setenv("COGNITIVEDRONE_SERVER_TOKEN", "the-servers-token-0123456789")
        policy = make_policy(f"remote:ws://{address}")
        policy.check()
        policy.close()


def test_another_version_of_the_protocol_is_refused():
    with openpi_server(lambda _: {}, {"cognitivedrone": {"protocol": 2}}) as address:
        policy = make_policy(f"remote:ws://{address}")
        with pytest.raises(ServerError, match="speaks version 2 of the protocol, this client 1; install the same"):
            policy.check()
        policy.close()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("remote", "needs url"),
        ("remote:ws://user:secret@127.0.0.1:8000", "a login in the address of a policy server would appear in results"),
        ("remote:ws://a b", "no address of a policy server"),
        ("remote:ws://127.0.0.1:8000#x", "no address of a policy server"),
        ("remote:ws://[::1", "no address of a policy server"),
        ("remote:http://127.0.0.1:8000", "no address of a policy server"),
        ("remote:ws://h:1,deadline=0", "deadline is 0"),
        ("remote:ws://h:1,rows=0", "rows is 0"),
    ],
)
def test_an_argument_that_will_not_do_is_named(text, message):
    with pytest.raises(PluginError, match=message):
        make_policy(text)
