"""Delays: fixed, measured, or drawn from a file, and clear words about everything else."""

from typing import Any

import numpy as np
import pytest

from cognitivedrone.control import latency
from cognitivedrone.control.latency import TimedPolicy, parse_delays
from cognitivedrone.errors import SimulationError
from cognitivedrone.interfaces import Policy
from cognitivedrone.types import EpisodeContext


def charges(delay, seed=0, needed=0.123, n=200):
    latency_model = delay.latency_model(np.random.default_rng(seed))
    return [latency_model(needed) for _ in range(n)]


def test_none_measured_and_fixed():
    assert charges(parse_delays("none").policy, n=1) == [0.0]
    assert charges(parse_delays("measured").reasoner, n=1) == [0.123]
    delays = parse_delays(" policy=80ms, reasoner=0.45s ")
    assert charges(delays.policy, n=1) == [pytest.approx(0.08)]
    assert charges(delays.reasoner, n=1) == [pytest.approx(0.45)]
    mixed = parse_delays("reasoner=measured")
    assert (charges(mixed.policy, n=1), charges(mixed.reasoner, n=1)) == ([0.0], [0.123])


def test_a_file_is_drawn_from_by_the_seed(tmp_path):
    file = tmp_path / "samples.txt"
    file.write_text("# from the vehicle\n100\n\n250.5  # once\n")
    delay = parse_delays(f"reasoner={file}").reasoner
    drawn = charges(delay)
    assert set(drawn) == {0.1, 0.2505}
    assert 60 < drawn.count(0.1) < 140
    assert drawn == charges(delay)
    assert drawn != charges(delay, seed=1)


def test_equal_delays_have_equal_identities(tmp_path):
    one, two = tmp_path / "a.txt", tmp_path / "b.txt"
    one.write_text("100\n")
    two.write_text("100\n")
    assert parse_delays(f"reasoner={one}").identity == parse_delays(f"reasoner={two}").identity
    two.write_text("101\n")
    assert parse_delays(f"reasoner={one}").identity != parse_delays(f"reasoner={two}").identity
    swapped = "reasoner=450ms,policy=80ms"
    assert parse_delays("policy=80ms,reasoner=450ms").identity == parse_delays(swapped).identity


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fast", "cannot read 'fast'"),
        ("policy=80", "neither a time such as 80ms nor a file"),
        ("pilot=80ms", "cannot read 'pilot=80ms'"),
        ("policy=80ms,policy=90ms", "cannot read 'policy=90ms'"),
        ("policy=", "cannot read 'policy='"),
        ("policy=90s", "from 0 to 60 s"),
        ("", "cannot read ''"),
    ],
)
def test_what_cannot_be_read_is_reported(text, message):
    with pytest.raises(SimulationError, match=message):
        parse_delays(text)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "contains no number"),
        ("fast\n", "line 1: 'fast' is not a number"),
        ("1\n-3\n", "line 2"),
        ("nan\n", "line 1"),
    ],
)
def test_a_file_that_cannot_be_read_is_reported_with_its_line(tmp_path, content, message):
    file = tmp_path / "samples.txt"
    file.write_text(content)
    with pytest.raises(SimulationError, match=message):
        parse_delays(f"policy={file}")


class Slow(Policy):
    """A policy that takes a quarter of a second a decision, by a clock of its own."""

    needs_ground_truth = needs_seed = True

    def __init__(self):
        self.told, self.clock = [], 0.0

    def perf_counter(self):
        return self.clock

    def reset(self, context):
        self.told.append(context)

    def act(self, observation):
        self.clock += 0.25
        return observation

    def check(self):
        self.told.append("check")

    def close(self):
        self.told.append("close")


def test_a_measured_policy_is_called_as_ever_and_needs_what_it_needs(monkeypatch):
    slow = Slow()
    monkeypatch.setattr(latency, "time", slow)
    timed: Any = TimedPolicy(slow)
    assert timed.needs_ground_truth
    assert timed.needs_seed
    timed.check()
    timed.reset(EpisodeContext("go"))
    chunks: Any = (np.zeros((1, 4), np.float32), np.ones((2, 4), np.float32))
    for chunk in chunks:
        np.testing.assert_array_equal(timed.act(chunk), chunk)
    assert timed.took_s == [0.25, 0.25]
    timed.close()
    assert slow.told == ["check", EpisodeContext("go"), "close"]
