"""The shapes that annotations name are checked in every call, as long as tests run."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import TypeCheckError
from typechecked import unchecked

from cognitivedrone.frames import rotation_matrix
from cognitivedrone.models.small_file import Flown
from cognitivedrone.types import DroneState, Observation

FRAME = np.zeros((256, 256, 3), np.uint8)
AT_REST = np.zeros(3)
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def test_values_of_the_right_shapes_are_made():
    assert DroneState(AT_REST, AT_REST, LEVEL, AT_REST).position is AT_REST
    assert Observation(FRAME, "", AT_REST, 1.0, 0.0, 0.0).image is FRAME
    assert rotation_matrix(np.tile(LEVEL, (5, 2, 1))).shape == (5, 2, 3, 3)


def test_another_shape_fails():
    with pytest.raises(TypeCheckError, match="position"):
        DroneState(np.zeros(2), AT_REST, LEVEL, AT_REST)
    with pytest.raises(TypeCheckError, match="image"):
        Observation(FRAME[..., 0], "", AT_REST, 1.0, 0.0, 0.0)
    with pytest.raises(TypeCheckError, match="quaternion"):
        rotation_matrix(AT_REST)


def test_another_kind_of_number_fails():
    with pytest.raises(TypeCheckError, match="image"):
        Observation(FRAME / 255, "", AT_REST, 1.0, 0.0, 0.0)  # type: ignore[arg-type]
    with pytest.raises(TypeCheckError, match="position"):
        DroneState(np.zeros(3, int), AT_REST, LEVEL, AT_REST)


def test_lengths_that_belong_together_and_differ_fail():
    options = np.zeros((2, 4, 1, 4), np.float32)
    assert Flown(options, np.zeros((2, 4), np.float32)).options is options
    with pytest.raises(TypeCheckError, match="inclination"):
        Flown(options, np.zeros((1, 4), np.float32))


def test_what_a_user_may_pass_is_passed_unchecked():
    with unchecked():
        assert DroneState(np.zeros(2), AT_REST, LEVEL, AT_REST).position.shape == (2,)
    with pytest.raises(TypeCheckError):
        DroneState(np.zeros(2), AT_REST, LEVEL, AT_REST)
