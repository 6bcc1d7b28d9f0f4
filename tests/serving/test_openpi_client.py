"""openpi's own client, from the package index and in an environment of its own, flies our policies."""

import json
import subprocess

import numpy as np
import pytest
from environments import python_with

from cognitivedrone.policies import make_policy
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import serving
from cognitivedrone.types import EpisodeContext, Observation

PACKAGE = "openpi-client==0.1.2"
TOKEN = "a-token-of-the-tests-0123"  # noqa: S105
SCRIPT = """
import json, sys
import numpy as np
from openpi_client.websocket_client_policy import WebsocketClientPolicy

host, port, token = sys.argv[1:]
policy = WebsocketClientPolicy(host, int(port), api_key=token or None)
rng = np.random.default_rng(0)
actions = []
for step in range(3):
    seen = {
        "observation/image": rng.integers(0, 256, (256, 256, 3), dtype=np.uint8),
        "observation/state": rng.normal(size=5).astype(np.float32),
        "prompt": "Fly through the red gate",
    }
    answer = policy.infer(seen)
    actions.append(answer["actions"].tolist())
try:
    policy.infer({"prompt": "Fly"})
    error = ""
except RuntimeError as refused:
    error = str(refused)
again = policy.infer(seen)["actions"].tolist()
print(json.dumps([policy.get_server_metadata()["cognitivedrone"]["policy"], actions, error, again, sorted(answer)]))
"""


@pytest.fixture(scope="module")
def python(pytestconfig):
    return python_with(pytestconfig, PACKAGE, "typing-extensions")  # which it imports without requiring it


@pytest.mark.slow  # it is installed from the package index
@pytest.mark.parametrize("token", ["", TOKEN])
def test_it_gets_the_actions_of_the_local_policy_to_the_bit(python, tiny_model_file, token, monkeypatch):
    monkeypatch.setenv("COGNITIVEDRONE_SERVER_TOKEN", token)
    with serving(ServePlan.of(policy=f"small:{tiny_model_file}", port=0)) as address:
        done = subprocess.run(
            [str(python), "-c", SCRIPT, address.host, str(address.port), token], capture_output=True, text=True,
            check=False, timeout=300, env={},
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    name, actions, error, again, keys = json.loads(done.stdout)
    assert name == "small"
    assert error.startswith("Error in inference server:\n{")
    assert json.loads(error.partition("\n")[2])["error"]["code"] == "missing_field"
    assert {"actions", "server_timing"} <= set(keys)
    policy = make_policy(f"small:{tiny_model_file}")
    policy.reset(EpisodeContext("Fly through the red gate"))
    rng = np.random.default_rng(0)
    for answered in actions:
        image = rng.integers(0, 256, (256, 256, 3), dtype=np.uint8)
        state = rng.normal(size=5).astype(np.float32)
        expected = policy.act(
            Observation(image, "Fly through the red gate", state[:3], float(state[3]), float(state[4]), 0.0)
        )
        assert answered == expected.tolist()
    assert again == actions[-1]
