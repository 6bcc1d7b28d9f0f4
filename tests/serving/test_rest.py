"""OpenVLA's REST: requests as its deployment script takes them, with and without json-numpy."""

import base64
import http.client
import json

import numpy as np
import pytest

from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import serving


@pytest.fixture(scope="module")
def address():
    with serving(ServePlan.of(policy="served_pilots:Faulty", port=0)) as where:
        yield where


def encoded(array):
    """As json-numpy does."""
    return {
        "__numpy__": base64.b64encode(array.tobytes()).decode(),
        "dtype": np.lib.format.dtype_to_descr(array.dtype),
        "shape": array.shape,
    }


def decoded(table):
    return np.frombuffer(base64.b64decode(table["__numpy__"]), table["dtype"]).reshape(table["shape"])


def post(address, body, **headers):
    connection = http.client.HTTPConnection(address.host, address.port, timeout=60)
    body = body if isinstance(body, bytes) else json.dumps(body).encode()
    connection.request("POST", "/act", body, {"Content-Type": "application/json"} | headers)
    answer = connection.getresponse()
    content = json.loads(answer.read())
    connection.close()
    return answer.status, content


IMAGE = encoded(np.zeros((256, 256, 3), np.uint8))


def request(instruction="Fly", **changed):
    return {"image": IMAGE, "instruction": instruction} | changed


@pytest.mark.parametrize("doubly", [False, True])
def test_an_image_and_an_instruction_give_an_action_encoded_as_they_were(address, doubly):
    asked = request(unnorm_key=None)
    for _ in range(2):  # each is the first of a flight
        status, action = post(address, {"encoded": json.dumps(asked)} if doubly else asked)
        assert status == 200
        assert decoded(json.loads(action) if doubly else action).tolist() == [0, 1, 3, 1]


def test_a_state_may_be_given(address):
    state = np.array([0.0, 0.0, 0.0, 2.5, 0.0])
    assert decoded(post(address, request(state=encoded(state)))[1])[3] == 2.5


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        (b"", 400, "bad_message"),
        (b"{", 400, "bad_message"),
        (b"[" * 100_000, 400, "bad_message"),
        ({}, 400, "missing_field"),
        ({"encoded": 3}, 400, "missing_field"),
        (request(image=[[0]]), 400, "bad_field"),
        (request(image=encoded(np.zeros((8, 8, 3), np.uint8))), 400, "bad_field"),
        (request(image=IMAGE | {"dtype": "|O"}), 400, "bad_array"),
        (request(instruction=3), 400, "bad_field"),
        (request(state=encoded(np.full(5, np.nan))), 400, "bad_field"),
        (request(unnorm_key="bridge_orig"), 400, "bad_field"),
        (request("raise"), 500, "policy_error"),
        (request("nan"), 500, "non_finite_action"),
        (bytes(1_100_000), 413, "too_large"),
    ],
)
def test_a_request_that_will_not_do_gets_a_status_and_a_code(address, body, status, code):
    answered, content = post(address, body)
    assert (answered, content["error"]["code"]) == (status, code)
    assert "\n" not in content["error"]["message"]
    assert post(address, request())[0] == 200


def test_web_pages_are_refused(address):
    assert post(address, request(), Origin="http://a.page")[0] == 401


def test_an_image_of_a_camera_is_refused_with_the_size_that_is_meant(address):
    status, large = post(address, request(image=encoded(np.zeros((480, 640, 3), np.uint8))))
    assert (status, large["error"]["code"]) == (413, "too_large")
    assert "images of 256x256 pixels, which take 262 kB here" in large["error"]["message"]
    status, small = post(address, request(image=encoded(np.zeros((240, 320, 3), np.uint8))))
    assert status == 400
    assert "(240, 320, 3); expected uint8 (256, 256, 3), red first; crop and resize it" in small["error"]["message"]
