"""Networks whose weights are not numbers: they are told of at their first answer."""

import numpy as np
import pytest

from cognitivedrone.errors import ModelError
from cognitivedrone.models.onnx_file import numbers_of


class Session:
    """Answers with what it was made with."""

    def __init__(self, *answers: list[float]) -> None:
        self.answers = [np.array(each, np.float32) for each in answers]

    def run(self, outputs: tuple[str, ...], inputs: object) -> list[np.ndarray]:
        return self.answers[: len(outputs)]


def test_values_that_are_no_numbers_are_told_with_their_network() -> None:
    sound = numbers_of(Session([1.0, -np.inf]), ("logits",), {}, "the gate selector")
    assert sound[0].tolist() == [1.0, -np.inf]  # as of what is masked
    with pytest.raises(ModelError, match=r"the gate selector answers with values that are not numbers \(looks\)"):
        numbers_of(Session([1.0], [np.nan]), ("readings", "looks"), {}, "the gate selector")
