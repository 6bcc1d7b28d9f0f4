"""The server on loopback, with clients written after openpi's description: sessions, batches, errors, limits."""

import contextlib
import http.client
import json
import logging
from concurrent.futures import ThreadPoolExecutor, as_completed

import msgpack
import numpy as np
import pytest
import websockets.exceptions
from policy_clients import Client, observation, packed
from served_pilots import TOKEN, Held, served

from cognitivedrone.errors import GroundTruthError, PluginError, PolicyError, ServerError, UsageError
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import logging_to_stderr, serving


@pytest.fixture(scope="module")
def address():
    with serving(ServePlan.of(policy="served_pilots:Faulty", reasoner="none", port=0)) as where:
        yield where


def error_of(answer):
    """The code of an error frame, checked for its form."""
    assert isinstance(answer, str), answer
    error = json.loads(answer)["error"]
    assert error["message"]
    assert "\n" not in error["message"]
    assert "Traceback" not in answer
    return error["code"]


def counted(client, **changed):
    """Stage and number of the observation."""
    return client.ask(observation(**changed))["actions"][0, :2].tolist()


def test_metadata_comes_first_then_actions_with_timing(address):
    with Client(address) as client:
        about = client.metadata["cognitivedrone"]
        assert (about["protocol"], about["policy"], about["reasoner"]) == (1, "served_pilots:Faulty", None)
        answer = client.ask(observation("Fly"))
        assert answer["actions"].tolist() == [[0, 1, 3, 1.5]]
        assert answer["actions"].dtype == np.float32
        assert answer["declines"] is False
        assert answer["server_timing"]["infer_ms"] >= 0
        assert "prev_total_ms" not in answer["server_timing"]
        assert client.ask(observation("Fly"))["server_timing"]["prev_total_ms"] > 0


def test_the_health_page(address):
    page = http.client.HTTPConnection(address.host, address.port)
    page.request("GET", "/healthz")
    answer = page.getresponse()
    assert (answer.status, answer.read()) == (200, b"OK\n")
    page.request("GET", "/nothing")
    assert page.getresponse().status == 404
    page.close()


def test_a_flight_begins_with_the_connection_a_new_prompt_and_by_request(address):
    with Client(address) as client:
        assert [counted(client), counted(client)] == [[0, 1], [0, 2]]
        assert counted(client, prompt="Fly home") == [0, 1]
        assert counted(client, prompt="Fly home", reset=True) == [0, 1]
        assert counted(client, prompt="Fly on", reset=[{"prompt": "x", "stage": 4}]) == [4, 1]
        assert counted(client, prompt="a directive") == [4, 2]  # from now on the client says when


def test_clients_do_not_see_each_other(address):
    with Client(address) as one, Client(address) as other:
        assert counted(one) == [0, 1]
        assert counted(other) == [0, 1]
        assert [counted(one), counted(one), counted(other)] == [[0, 2], [0, 3], [0, 2]]


def crowd(stack, address, count):
    """That many clients: the observation of the first is held, and those of the others wait."""
    clients = [stack.enter_context(Client(address)) for _ in range(count)]
    clients[0].send(observation())
    assert Held.busy.wait(60)
    for client in clients[1:]:
        client.send(observation())
    return clients


def test_what_waits_goes_into_one_batch(monkeypatch):
    monkeypatch.setattr(Held, "sizes", [])
    Held.hold()
    with served(policy="served_pilots:Held", batch=3) as address, contextlib.ExitStack() as stack:
        clients = crowd(stack, address, 5)
        # The server answers each client in turn: this one's answer shows that the others' observations have arrived.
        with Client(address) as last:
            last.send(observation(observation__image=None))
            error_of(last.receive())
        Held.go.set()
        assert [client.receive()["actions"][0, 1] for client in clients] == [1] * 5
    assert Held.sizes[0] == 1
    assert sum(Held.sizes) == 5
    assert max(Held.sizes) <= 3
    assert len(Held.sizes) < 5


def test_a_client_that_leaves_in_the_middle_disturbs_nobody():
    Held.hold()
    with served(policy="served_pilots:Held", clients=2) as address, Client(address) as one:
        with Client(address) as leaving:
            leaving.send(observation())
            assert Held.busy.wait(60)
            one.send(observation())
        Held.go.set()
        assert one.receive()["actions"][0, 1] == 1
        with Client(address) as other:  # there is room again
            assert counted(other) == [0, 1]


@pytest.mark.parametrize(
    ("prompt", "code"),
    [("raise", "policy_error"), ("exit", "policy_error"), ("nan", "non_finite_action"), ("shape", "bad_action"),
     ("text", "bad_action"), (" ", "policy_error")],
)  # fmt: skip
def test_a_policy_that_fails_is_told_to_its_client_alone(address, prompt, code, caplog):
    with Client(address) as client, Client(address) as other, caplog.at_level(logging.INFO):
        assert counted(other) == [0, 1]
        assert error_of(client.ask(observation(prompt))) == code
        assert counted(client) == [0, 1]
        assert counted(other) == [0, 2]
    if prompt == "raise":
        assert "Traceback" in caplog.text
        assert "a secret of the server" in caplog.text


MALFORMED = {
    "no image": (observation(observation__image=None), "missing_field"),
    "a number as prompt": (observation(3), "bad_field"),
    "another question": (observation(ask="poem"), "bad_field"),
    "no reasoner": (observation(ask="guidance"), "no_reasoner"),
    "a list": ([1, 2], "bad_message"),
    "text": ("hello", "bad_message"),
    "nothing at all": (b"", "bad_message"),
    "half a message": (packed(observation())[:1000], "bad_message"),
    "an array of objects": (
        msgpack.packb({b"__ndarray__": True, b"data": b"x", b"dtype": "|O", b"shape": [1]}),
        "bad_array",
    ),
}
"""Of every way to a code; `tests/remote` has all that leads there."""


@pytest.mark.parametrize(("message", "code"), MALFORMED.values(), ids=MALFORMED)
def test_a_message_that_will_not_do_is_answered_with_its_code_and_the_session_goes_on(address, message, code):
    with Client(address) as client:
        assert counted(client) == [0, 1]
        assert error_of(client.ask(message)) == code
        assert counted(client) == [0, 2]


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"protocol": 2}, "protocol_version"),
        ({"protocol": "x"}, "protocol_version"),
        ({"session": "x"}, "unknown_session"),
    ],
)
def test_another_version_or_session_ends_the_connection(address, changed, code):
    with Client(address) as client:
        assert error_of(client.ask(observation(**changed))) == code
        with pytest.raises(websockets.exceptions.ConnectionClosed):
            client.receive()


def test_a_message_beyond_the_limit_ends_its_own_connection(address):
    with Client(address) as client, Client(address) as other:
        with pytest.raises(websockets.exceptions.ConnectionClosed) as caught:
            client.ask(bytes(1_100_000))
        assert caught.value.rcvd is None or caught.value.rcvd.code == 1009
        assert counted(other) == [0, 1]


def test_no_more_clients_than_allowed():
    with served(clients=1) as address, Client(address) as client:
        with pytest.raises(websockets.exceptions.InvalidStatus) as caught, Client(address):
            pass
        assert caught.value.response.status_code == 503
        assert error_of(caught.value.response.body.decode()) == "too_many_clients"
        assert counted(client) == [0, 1]


def test_no_more_requests_than_allowed():
    with served(rate=1.0) as address, Client(address) as client, Client(address) as other:
        assert counted(client) == [0, 1]
        assert error_of(client.ask(observation())) == "too_many_requests"
        assert counted(other) == [0, 1]


def test_a_silent_client_makes_room():
    with served(idle=0.05, clients=1) as address:
        with Client(address) as silent:
            assert error_of(silent.receive()) == "busy"
            with pytest.raises(websockets.exceptions.ConnectionClosed):
                silent.receive()
        with Client(address) as client:
            assert "cognitivedrone" in client.metadata


def test_no_more_waiting_observations_than_allowed():
    Held.hold()
    with served(policy="served_pilots:Held", queue=1) as address, contextlib.ExitStack() as stack:
        clients = crowd(stack, address, 3)
        with ThreadPoolExecutor() as pool:
            answers = [pool.submit(client.receive) for client in clients]
            first = next(as_completed(answers, timeout=60)).result()
            Held.go.set()
        assert error_of(first) == "busy"
        assert sum(isinstance(answer.result(), dict) for answer in answers) == 2


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    file = tmp_path_factory.mktemp("token") / "token"
    file.write_text(f"{TOKEN}\n")
    file.chmod(0o600)
    with served(token_file=file) as where:
        yield where


class TestAccess:
    @pytest.mark.parametrize(
        "headers",
        [{}, {"Authorization": "Api-Key wrong-wrong-wrong-wrong"}, {"Authorization": f"Api-Key {TOKEN}x"},
         {"Authorization": f"Basic {TOKEN}"}, {"Authorization": TOKEN}, {"Authorization": "Api-Key é"},
         {"Authorization": f"Api-Key {TOKEN}", "Origin": "http://a.page"}],
    )  # fmt: skip
    def test_no_token_or_a_wrong_one_is_refused(self, guarded, headers):
        with pytest.raises(websockets.exceptions.InvalidStatus) as caught, Client(guarded, **headers):
            pass
        assert caught.value.response.status_code == 401
        assert error_of(caught.value.response.body.decode()) == "unauthorized"
        rest = http.client.HTTPConnection(guarded.host, guarded.port)
        rest.request("POST", "/act", b"{}", {name: value.encode() for name, value in headers.items()})
        assert rest.getresponse().status == 401
        rest.close()

    @pytest.mark.parametrize("scheme", ["Api-Key", "Bearer"])
    def test_with_the_token_it_serves(self, guarded, scheme):
        with Client(guarded, Authorization=f"{scheme} {TOKEN}") as client:
            assert counted(client) == [0, 1]

    @pytest.mark.parametrize("token", ["short", "with a blank in the middle", "ünprintable-in-headers"])
    def test_a_token_that_can_be_guessed_or_not_sent_is_refused(self, token, monkeypatch):
        monkeypatch.setenv("COGNITIVEDRONE_SERVER_TOKEN", token)
        with pytest.raises(ServerError, match="at least 16 printable ASCII characters") as caught, served():
            pass
        assert token not in str(caught.value)


@pytest.fixture(scope="module")
def pilot():
    with served(reasoner="served_pilots:Stages") as where:
        yield where


class TestPilot:
    def test_a_plain_client_flies_by_the_reasoners_directives(self, pilot):
        directive = len("stages [0], question 1")
        with Client(pilot) as client:
            for _ in range(5):
                answer = client.ask(observation())
                assert answer["actions"][0, 2] == directive
            assert answer["server_timing"]["reason_ms"] >= 0
            # Half a second later, counted in control steps, the reasoner is asked again.
            assert client.ask(observation())["actions"][0, 1] == 6
            assert client.ask(observation(time=30.0))["actions"][0, 2] == directive

    @pytest.mark.parametrize(
        ("sentence", "holds", "present"), [("nothing", True, None), ("surely nothing", False, 0.99)]
    )
    def test_the_directive_hold_holds_but_a_policy_that_is_sure_is_not_stopped(self, pilot, sentence, holds, present):
        with Client(pilot) as client:
            answers = [client.ask(observation(sentence, time=seconds)) for seconds in (0.0, 0.5, 1.0, 1.5)]
            assert [answer["declines"] for answer in answers] == [False, False, holds, holds]
            assert (answers[2]["actions"].tolist() == [[0, 0, 0, 0]]) == holds
            assert answers[-1].get("present") == present

    def test_without_an_answer_the_prompt_counts(self, pilot):
        with Client(pilot) as client:
            assert client.ask(observation("unsure"))["actions"][0, 2] == len("unsure")

    def test_the_policy_alone_and_the_reasoner_alone(self, pilot):
        with Client(pilot) as client:
            assert client.ask(observation("Fly", ask="policy"))["actions"][0, 2] == len("Fly")
            assert client.ask(observation("Fly", ask="guidance", reset=True))["directive"] == "stages [0], question 1"
            assert client.ask(observation("Fly", ask="guidance"))["gate"] == 1
            answer = json.loads(client.ask(observation("unsure", ask="guidance")))["error"]
            assert (answer["code"], answer["fault"]) == ("no_answer", "unsure")


def test_a_seed_reaches_the_policy():
    with served(policy="served_pilots:Seeded") as address, Client(address) as client:
        assert client.metadata["cognitivedrone"]["needs_seed"] is True
        answer = client.ask(observation("x", reset=[{"prompt": "x", "seed": 77}], ask="policy"))
        assert answer["actions"].tolist() == [[77] * 4] * 2


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"policy": "oracle"}, GroundTruthError, "'oracle' uses privileged state, which no client sends"),
        ({"reasoner": "oracle"}, GroundTruthError, "'oracle' uses privileged state, which no client sends"),
        ({"policy": "served_pilots:LooksDown"}, PolicyError, "needs a camera that looks down, which no client sends"),
        ({"policy": "smal"}, PluginError, "unknown policy"),
        *(({"host": host}, ServerError, "needs a token") for host in ("0.0.0.0", "::", "192.168.1.2", "")),  # noqa: S104
    ],
)
def test_what_is_not_served_is_refused_before_the_port_is_used(monkeypatch, options, error, says):
    monkeypatch.delenv("COGNITIVEDRONE_SERVER_TOKEN", raising=False)
    with pytest.raises(error, match=says), served(**options):
        pass


def test_a_port_that_is_taken_is_named(address):
    says = rf"cannot listen at 127.0.0.1, port {address.port}: .*; give another --host"
    with pytest.raises(ServerError, match=says), served(port=address.port):
        pass


@pytest.mark.parametrize("option", ["clients", "rate", "queue", "batch", "message_kb", "idle", "port"])
def test_a_limit_that_is_none_is_refused(option):
    with pytest.raises(UsageError, match=f"--{option.replace('_', '-')} is -1"):
        ServePlan.of(**{option: -1})


def test_200_frames_that_the_policy_fails_at_leave_few_lines_in_the_log(capsys):
    with (
        logging_to_stderr(),
        serving(ServePlan.of(policy="served_pilots:Faulty", reasoner="none", port=0)) as address,
        Client(address) as client,
    ):
        for _ in range(100):
            client.ask(observation("raise"))
            client.ask(observation("exit"))
    log = capsys.readouterr().err
    assert "Traceback" in log
    assert len(log.splitlines()) < 200
