"""Statistics say what the actions are; splits are fixed and have every family."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.statistics import draw_of, spread, validation_indices
from cognitivedrone.data.store import Store
from cognitivedrone.tasks import BASE_FAMILIES

FAMILY_NAMES = st.sampled_from(["letters", "digits", "food"])


def test_statistics_follow_from_the_flights(sound_store: Path, flights: list[Episode]) -> None:
    store = Store.open(sound_store)
    for split in ("train", "val"):
        chosen = [flight for flight in flights if store.split_of(flight.index) == split]
        actions = np.concatenate([flight.action for flight in chosen])
        said = store.statistics()[split]
        assert said["episodes"] == len(chosen)
        assert said["steps"] == len(actions)
        assert said["length"] == pytest.approx(
            {"min": min(map(len, chosen)), "max": max(map(len, chosen)), "mean": len(actions) / len(chosen)}
        )
        np.testing.assert_allclose(said["action"]["mean"], actions.mean(axis=0), rtol=1e-5)
        np.testing.assert_array_equal(said["action"]["max"], actions.max(axis=0))
        assert sum(said["families"].values()) == sum(said["categories"].values()) == len(chosen)
    assert store.statistics()["all"]["families"] == dict.fromkeys(sorted(BASE_FAMILIES), 4)


def test_spread_of_a_known_sample() -> None:
    values = np.column_stack([np.arange(101), -2.0 * np.arange(101)])
    found = spread(values)
    assert found["q01"] == pytest.approx([1, -198])
    assert found["q99"] == pytest.approx([99, -2])
    assert found["mean"] == pytest.approx([50, -100])
    assert found["std"] == pytest.approx([values[:, 0].std(), values[:, 1].std()])
    assert (found["min"], found["max"]) == ([0, -200], [100, 0])


def test_a_large_set_has_a_twentieth_to_validate() -> None:
    families = {index: BASE_FAMILIES[index % 10] for index in range(8062)}
    val = validation_indices("ab" * 32, families)
    assert 0.04 < len(val) / 8062 < 0.06
    assert val == [index for index in range(8062) if draw_of("ab" * 32, index) < 0.05]
    assert {families[index] for index in val} == set(BASE_FAMILIES)
    assert val != validation_indices("cd" * 32, families)


@given(st.dictionaries(st.integers(0, 10_000), FAMILY_NAMES, max_size=60), st.text("0123456789abcdef", min_size=4))
def test_families_of_two_or_more_are_in_both_splits(families: dict[int, str], digest: str) -> None:
    val = validation_indices(digest, families)
    assert val == sorted(set(val) & families.keys())
    for family in set(families.values()):
        members = {index for index, name in families.items() if name == family}
        if len(members) > 1:
            assert 0 < len(members & set(val)) < len(members)
    assert val == validation_indices(digest, dict(reversed(families.items())))
