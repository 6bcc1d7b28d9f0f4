import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from cognitivedrone.benchmark.scores.results import decode, dumps, encode
from cognitivedrone.errors import RunError


@dataclass(frozen=True)
class Inner:
    name: str
    mode: Literal["a", "b"]


@dataclass(frozen=True)
class Outer:
    points: NDArray[np.float32]
    pair: tuple[int, int]
    inners: tuple[Inner, ...]
    table: Mapping[str, float]
    maybe: float | None = None
    rare: str = field(default="", metadata={"json": "where set"})


VALUE = Outer(
    np.array([[0.12345, 1, 2]], np.float32), (1, 2), (Inner("x", "a"),), {"one": 1.5, "not finite": math.nan}, None
)


def test_a_value_is_read_back_as_it_was_written():
    document = encode(VALUE)
    assert document == {
        "points": [[0.123, 1.0, 2.0]],
        "pair": [1, 2],
        "inners": [{"name": "x", "mode": "a"}],
        "table": {"one": 1.5, "not finite": None},
        "maybe": None,
    }
    back = decode(Outer, document, "file")
    assert back.points.shape == (1, 3)
    assert back.points.dtype == np.float32
    assert (back.pair, back.inners, back.maybe, back.rare) == ((1, 2), VALUE.inners, None, "")
    assert back.table["one"] == 1.5
    assert math.isnan(back.table["not finite"])


def test_numbers_of_numpy_and_whole_floats_are_written_plainly():
    value = {"a": np.int64(3), "b": np.float32(0.5), "c": np.bool_(True).item(), "d": 2.0, "e": math.inf, "f": True}
    assert dumps(value) == '{"a":3,"b":0.5,"c":true,"d":2.0,"e":null,"f":true}'


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pair": [1]}, r"file\.pair has 1 items; it must have 2"),
        ({"pair": [1, True]}, r"file\.pair\[1\] must be a whole number, not True"),
        ({"pair": {}}, r"file\.pair must be a list, not {}"),
        ({"inners": [{"name": "x", "mode": "c"}]}, r"file\.inners\[0\]\.mode is 'c'; it must be one of 'a', 'b'"),
        ({"inners": [{"name": "x"}]}, r"file\.inners\[0\]\.mode is missing"),
        ({"inners": [[]]}, r"file\.inners\[0\] must be an object, not \[\]"),
        ({"inners": [{"name": "x", "mode": "a", "z": 1}]}, r"file\.inners\[0\] has 'z', which .* known: name, mode"),
        ({"table": {"one": "1"}}, r"file\.table\['one'\] must be a number, not '1'"),
        ({"table": []}, r"file\.table must be an object"),
        ({"points": "nan"}, r"file\.points must be a list of \[x, y, z\]"),
        ({"points": [[1, 2]]}, r"file\.points must be a list of \[x, y, z\]"),
        ({"maybe": "x @ y"}, r"file\.maybe must be a number, not 'x @ y'"),
    ],
)
def test_a_wrong_value_is_refused_with_its_place(change, message):
    with pytest.raises(RunError, match=message):
        decode(Outer, {**encode(VALUE), **change}, "file")


def test_surrogates_are_spelled_out_so_that_a_file_takes_them_and_reads_the_same_again():
    text = dumps({"message": "a\ud800b\ud83d\ude00", "more": "drone \U0001f681"})
    assert text.encode("utf-8")
    assert json.loads(text) == {"message": r"a\ud800b\ud83d\ude00", "more": "drone \U0001f681"}
    assert dumps(json.loads(text)) == text
