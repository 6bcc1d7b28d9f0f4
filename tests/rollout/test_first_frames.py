"""A pool whose workers cannot all draw on one card."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from cognitivedrone.errors import FirstFrameError
from cognitivedrone.rollout.process_pool import ProcessPool


class Drawing:
    renderer = "a card"

    def close(self) -> None:
        pass


@dataclass(frozen=True)
class CardFor:
    """Work on a card that returns frames to the first `most` processes alone."""

    folder: Path
    most: int
    time_limit_s: float = 60.0

    def open(self, watch: object = None) -> Drawing:
        for number in range(self.most):
            try:
                (self.folder / str(number)).touch(exist_ok=False)
            except FileExistsError:
                continue
            return Drawing()
        raise FirstFrameError("a card drew no frame within 60 s; let fewer processes draw on it.")

    def fly(self, worker: Drawing, item: int) -> Iterable[int]:
        yield item * item

    def title(self, item: int) -> str:
        return f"item {item}"

    def lost(self, item: int, message: str, trace: str) -> Any:
        raise AssertionError(message)

    def differences(self) -> str:
        return ""


def test_fewer_workers_go_on_where_a_card_draws_for_no_more(tmp_path: Path) -> None:
    with warnings.catch_warnings(record=True) as said, ProcessPool(CardFor(tmp_path, 1), 3) as pool:
        warnings.simplefilter("always")
        answers = sorted(answer for answer, _ in pool.fly(range(6)))
        while pool.size > 1:  # those that are late to fail
            list(pool.fly([0]))
    assert answers == [0, 1, 4, 9, 16, 25]
    assert [str(warning.message).partition("on it. ")[2] for warning in said] == [
        "2 of 3 workers go on.",
        "1 of 3 workers go on.",
    ]


@pytest.mark.filterwarnings("ignore:a card drew no frame")
def test_without_any_that_draws_the_error_is_raised(tmp_path: Path) -> None:
    pool = ProcessPool(CardFor(tmp_path, 0), 2)
    with pytest.raises(FirstFrameError, match="drew no frame"):
        pool.__enter__()
