"""Statistics, splits and the summary say what is in a set; splits are fixed, with their share of every family."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_stores import write_store
from rich.console import Console

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.overview import Histogram, bars, histogram, megabytes, overview, summary
from cognitivedrone.data.statistics import EXACT, draw_of, draw_splits, spread, threshold_indices
from cognitivedrone.data.store import Store
from cognitivedrone.tasks import BASE_FAMILIES

FAMILY_NAMES = st.sampled_from(["letters", "digits", "food"])


def test_statistics_follow_from_the_flights(sound_store: Path, flights: list[Episode]) -> None:
    store = Store.open(sound_store)
    for split in ("train", "val"):
        chosen = [flight for flight in flights if store.split_of(flight.index) == split]
        actions = np.concatenate([flight.action for flight in chosen])
        output = store.statistics()[split]
        assert output["episodes"] == len(chosen)
        assert output["steps"] == len(actions)
        assert output["length"] == pytest.approx(
            {"min": min(map(len, chosen)), "max": max(map(len, chosen)), "mean": len(actions) / len(chosen)}
        )
        np.testing.assert_allclose(output["action"]["mean"], actions.mean(axis=0), rtol=1e-5)
        np.testing.assert_array_equal(output["action"]["max"], actions.max(axis=0))
        assert sum(output["families"].values()) == sum(output["categories"].values()) == len(chosen)
    assert store.statistics()["all"]["families"] == dict.fromkeys(sorted(BASE_FAMILIES), 4)


def test_spread_of_a_known_sample() -> None:
    values = np.column_stack([np.arange(101), -2.0 * np.arange(101)])
    found = spread(values)
    assert found["q01"] == pytest.approx([1, -198])
    assert found["q99"] == pytest.approx([99, -2])
    assert found["mean"] == pytest.approx([50, -100])
    assert found["std"] == pytest.approx([values[:, 0].std(), values[:, 1].std()])
    assert (found["min"], found["max"]) == ([0, -200], [100, 0])


def test_a_large_set_has_a_twentieth_to_validate_and_says_nothing_of_it() -> None:
    families = {index: BASE_FAMILIES[index % 10] for index in range(8062)}
    splits = draw_splits("ab" * 32, families)
    val = splits["val"]
    assert 0.04 < len(val) / 8062 < 0.06
    assert splits == {"train": 8062 - len(val), "val": [i for i in range(8062) if draw_of("ab" * 32, i) < 0.05]}
    assert {families[index] for index in val} == set(BASE_FAMILIES)
    assert val != draw_splits("cd" * 32, families)["val"]


@pytest.mark.parametrize(
    ("episodes", "wanted"), [(1, 0), (2, 1), (20, 1), (24, 1), (30, 2), (49, 2), (50, 3), (300, 15), (999, 50)]
)
def test_a_small_set_has_exactly_a_twentieth_to_validate(episodes: int, wanted: int) -> None:
    families = {index: BASE_FAMILIES[index % 10] for index in range(episodes)}
    splits = draw_splits("ab" * 32, families)
    assert splits["rule"] == EXACT
    assert len(splits["val"]) == wanted
    assert splits["train"] == episodes - wanted
    each = [sum(families[index] == family for index in splits["val"]) for family in BASE_FAMILIES]
    assert max(each) - min(each) <= 1
    if episodes > 1:
        assert splits["val"] != [0]


def test_families_of_unlike_size_have_their_share() -> None:
    families = {index: "letters" if index % 3 else "digits" for index in range(600)}
    val = draw_splits("ab" * 32, families)["val"]
    assert [sum(families[index] == name for index in val) for name in ("letters", "digits")] == [20, 10]


@given(st.dictionaries(st.integers(0, 10_000), FAMILY_NAMES, max_size=60), st.text("0123456789abcdef", min_size=4))
def test_splits_depend_on_what_is_in_the_set_alone(families: dict[int, str], digest: str) -> None:
    splits = draw_splits(digest, families)
    val = splits["val"]
    assert val == sorted(set(val) & families.keys())
    assert splits["train"] + len(val) == len(families)
    assert abs(len(val) - len(families) / 20) <= 0.5 or len(val) == 1
    assert splits == draw_splits(digest, dict(reversed(families.items())))


@given(st.dictionaries(st.integers(0, 10_000), FAMILY_NAMES, max_size=60), st.text("0123456789abcdef", min_size=4))
def test_by_the_threshold_families_of_two_or_more_are_in_both_splits(families: dict[int, str], digest: str) -> None:
    val = threshold_indices(digest, families)
    assert val == sorted(set(val) & families.keys())
    for family in set(families.values()):
        members = {index for index, name in families.items() if name == family}
        if len(members) > 1:
            assert 0 < len(members & set(val)) < len(members)


def shown(store: Path) -> str:
    console = Console(width=160, record=True)
    with console.capture() as captured:
        console.print(summary(store))
    return captured.get()


def test_summary_names_what_is_in_the_set(sound_store: Path, flights: list[Episode], tmp_path: Path) -> None:
    assert "No flight was dropped." in shown(write_store(tmp_path / "one", flights[:1]))
    text = shown(sound_store)
    assert f"40 episodes, {sum(map(len, flights))} steps" in text
    assert "recipe test, suite open-v1:train, seed 3" in text
    assert "frames as png (40 episodes)" in text
    assert "10 collision" in text
    assert all(family.replace("_", " ") in text for family in BASE_FAMILIES)
    assert all(name in text for name in ("vx", "vy", "vz", "yaw rate"))


def test_overview_counts_every_episode_and_every_byte(sound_store: Path, flights: list[Episode]) -> None:
    seen = overview(Store.open(sound_store))
    assert sum(family.total for family in seen.families) == 40
    assert all(sum(shape.counts) == sum(map(len, flights)) for shape in seen.actions)
    assert sum(seen.lengths.counts) == 40
    assert (seen.lengths.low, seen.lengths.high) == pytest.approx((0.2, 0.5))
    assert seen.bytes_on_disk == sum(file.stat().st_size for file in sound_store.rglob("*") if file.is_file())


def test_histogram_of_a_constant_is_one_full_bin() -> None:
    shape = histogram(np.zeros(7), "vy", "m/s")
    assert sum(shape.counts) == max(shape.counts) == 7
    assert shape.low < 0 < shape.high


def test_bars_show_every_bin_that_is_not_empty() -> None:
    assert bars(Histogram("x", "m", 0, 1, (0, 1, 500, 1000))) == " ▁▄█"


def test_sizes_are_readable() -> None:
    assert [megabytes(size) for size in (12, 4_600, 512_000, 80_300_000, 2.5e9)] == [
        "12 bytes", "4.6 KB", "512 KB", "80.3 MB", "2.50 GB"
    ]  # fmt: skip
