"""Velocities, bins and words; the statistics that scale them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cognitivedrone.errors import PolicyError
from cognitivedrone.models.openvla.actions import BINS, ActionStatistics, choose_statistics, from_tokens, to_tokens

PLAIN = ActionStatistics((-0.2, -0.6, -0.4, -0.9), (2.0, 0.6, 0.4, 0.9))
DRONE = {"action": PLAIN.to_json()}
ARM = {"action": {"q01": [-1.0] * 7, "q99": [1.0] * 7}}


@given(arrays(np.float64, (5, 4), elements=st.floats(-1, 1)))
def test_words_mean_what_they_were_made_of(normalised):
    back = from_tokens(to_tokens(normalised))
    assert np.abs(back - normalised).max() <= 1 / (BINS - 1) + 1e-9


def test_the_words_are_the_last_256():
    every = to_tokens(np.linspace(-1, 1, 100_000))
    assert (every.min(), every.max()) == (31_744, 31_999)
    assert np.array_equal(np.unique(every), np.arange(31_744, 32_000))


def test_beyond_the_range_is_the_end_of_it():
    assert to_tokens(np.array([-7.0, 7.0])).tolist() == [31_999, 31_744]
    assert from_tokens(np.array([5, 31_743, 31_744])).tolist() == [254 / 255] * 3
    assert from_tokens(np.array([32_063, 31_999])).tolist() == [-254 / 255] * 2


@given(arrays(np.float64, (3, 4), elements=st.floats(0, 1)))
def test_scaling_is_undone(shares):
    low, high = np.array(PLAIN.q01), np.array(PLAIN.q99)
    actions = low + shares * (high - low)
    assert np.allclose(PLAIN.flown(PLAIN.normalise(actions)), actions, atol=1e-12)


def test_what_lies_beyond_the_quantiles_is_clipped_in_training():
    assert PLAIN.normalise(np.array([[9.0, -9.0, 0.0, 0.0]])).tolist() == [[1.0, -1.0, 0.0, 0.0]]


def test_a_dimension_that_never_moves_stays_where_it_was():
    still = ActionStatistics((-1.0, 0.0, 0.25, -1.0), (1.0, 0.0, 0.25, 1.0))
    assert still.normalise(np.array([[0.5, 0.0, 0.25, -0.5]])).tolist() == [[0.5, 0.0, 0.0, -0.5]]
    assert still.flown(np.array([[0.5, -0.9, 0.7, -0.5]])).tolist() == [[0.5, 0.0, 0.25, -0.5]]


def test_a_masked_dimension_is_not_scaled():
    masked = ActionStatistics((0.0,) * 4, (4.0,) * 4, (True, True, True, False))
    assert masked.flown(np.array([0.5, 0.5, 0.5, 0.5])).tolist() == [3.0, 3.0, 3.0, 0.5]
    assert masked.normalise(np.array([3.0, 3.0, 3.0, 0.5])).tolist() == [0.5, 0.5, 0.5, 0.5]


def test_the_only_statistics_of_a_drone_are_taken():
    assert choose_statistics({"cognitive_drone": DRONE}, None) == ("cognitive_drone", PLAIN)
    assert choose_statistics({"arm": ARM, "drone": DRONE, "odd": 3}, None) == ("drone", PLAIN)
    assert choose_statistics({"arm": ARM, "drone": DRONE}, "drone") == ("drone", PLAIN)


@pytest.mark.parametrize(
    ("stats", "key", "says"),
    [
        ({}, None, "no action statistics"),
        ({"b": DRONE, "arm": ARM, "a": DRONE}, None, "2 data sets of drones; add unnorm_key=NAME, one of a, b"),
        ({"arm": ARM, "leg": ARM}, None, "2 data sets, none with the 4 numbers of a drone's action"),
        ({"cognitive_drone": DRONE}, "cognitive_dron", "did you mean 'cognitive_drone'"),
        ({"arm": ARM}, None, "statistics 'arm' have 7 numbers; a drone's action has 4"),
        ({"drone": {"action": {"q01": [0, 0, 0, 0]}}}, None, "lack readable q01 and q99"),
        ({"drone": {"action": {"q01": [0, 0, 0, "x"], "q99": [1] * 4}}}, None, "lack readable"),
        ({"drone": 3}, None, "lack readable"),
        ({"drone": {"action": {"q01": [1] * 4, "q99": [0] * 4}}}, None, "must be finite, q01 <= q99"),
        ({"drone": {"action": {"q01": [0] * 4, "q99": [float("nan")] * 4}}}, None, "must be finite"),
        ({"drone": {"action": {"q01": [0] * 4, "q99": [1] * 4, "mask": [True]}}}, None, "have 4, 4 and 1 numbers"),
    ],
)
def test_statistics_that_do_not_do(stats, key, says):
    with pytest.raises(PolicyError, match=says.replace("(", "\\(")):
        choose_statistics(stats, key)
