"""A sample of the attacks over the network; `benchmarks/network_attacks.py` tries all of them."""

import sys
from collections import Counter
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from network_attacks import attacks

SAMPLE = (
    "idle: half a second request",
    "idle: an upgrade with a length",
    "token: a beginning",
    "server: no metadata",
    "server: metadata of 40 MB",
    "server: a redirect",
    "server: an error that no file takes",
)


def test_every_attack_has_a_name_of_its_own():
    names = Counter(attack.name for attack in attacks())
    assert len(names) >= 45
    assert set(names.values()) == {1}
    assert set(SAMPLE) <= set(names)


@pytest.mark.parametrize("name", SAMPLE)
def test_the_package_holds(name, tmp_path):
    (attack,) = [attack for attack in attacks() if attack.name == name]
    assert attack.run(tmp_path) == ""
