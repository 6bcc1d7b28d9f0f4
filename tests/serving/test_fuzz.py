"""Some hundred of the hostile messages that `benchmarks/fuzz_server.py` sends by the ten thousand."""

import sys
from pathlib import Path

import pytest

from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import serving

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from fuzz_server import Failed, fuzz, outcome
from hostile_messages import TEXT


def test_hostile_messages_are_answered_or_closed_and_disturb_nobody(tiny_model_file):
    with serving(ServePlan.of(policy=f"small:{tiny_model_file}", port=0)) as address:
        counts, witness = fuzz(address.port, 200, seed=1)
    assert counts.total() >= 200
    assert {kind.partition(":")[0] for kind, _ in counts} >= {"fields", "frames", "http", "REST", "msgpack mutated"}
    assert len(witness.took_s) > 0


@pytest.mark.parametrize(
    "frame", [b'{"error": {"code": "internal", "message": "x"}}', b"Traceback (most recent call last)", b"no JSON"]
)
def test_a_server_that_fails_is_noticed(frame):
    with pytest.raises((Failed, ValueError)):
        outcome((TEXT, frame))
