"""Frames of aerospace code against those of this package."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cognitivedrone.frames import enu_to_ned, flu_to_frd, ned_euler, ned_quaternion, rotation_matrix


@settings(max_examples=50)
@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_attitudes_are_those_of_the_frames(numbers: list[float]) -> None:
    q = np.array(numbers) / np.linalg.norm(numbers)
    expected = flu_to_frd(enu_to_ned(rotation_matrix(q).T).T)
    assert rotation_matrix(ned_quaternion(q)) == pytest.approx(expected, abs=1e-9)
    roll, pitch, yaw = ned_euler(q)
    assert math.sin(pitch) == pytest.approx(-expected[2, 0], abs=1e-9)
    if abs(expected[2, 0]) < 0.999:
        assert math.cos(yaw) * math.cos(pitch) == pytest.approx(expected[0, 0], abs=1e-9)
        assert math.sin(yaw) * math.cos(pitch) == pytest.approx(expected[1, 0], abs=1e-9)
        assert math.cos(roll) * math.cos(pitch) == pytest.approx(expected[2, 2], abs=1e-9)


def test_batches_of_attitudes_convert_one_by_one_and_back() -> None:
    q = np.random.default_rng(0).standard_normal((3, 5, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    there = ned_quaternion(q)
    assert np.array_equal(there[2, 3], ned_quaternion(q[2, 3]))
    assert ned_quaternion(there) == pytest.approx(q, abs=1e-12)
