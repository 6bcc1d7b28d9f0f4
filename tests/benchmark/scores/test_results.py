"""Files of results: values written and read back, and what is refused."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import benchmark_fakes
import numpy as np
import pytest
from numpy.typing import NDArray

from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.scores.results import (
    decode,
    dumps,
    encode,
    read_results,
    results_from_json,
    results_to_json,
)
from cognitivedrone.errors import RunError

DOCS = Path(__file__).parents[3] / "docs" / "benchmark.md"


@pytest.fixture
def results(config):
    return run(config, progress=False, runner=benchmark_fakes.FakeRunner)


@pytest.fixture
def document(results, config):
    return json.loads((config.out / "results.json").read_text())


def test_the_file_holds_the_scores_of_both_rules(results, document):
    for rule in ("through", "within_1m"):
        overall = document["scores"][rule]["overall"]
        assert overall["passed"] == results.summary(rule).overall.passed
        assert overall["n"] == 20
    assert document["scores"]["within_1m"]["overall"]["passed"] > document["scores"]["through"]["overall"]["passed"]


def test_the_schema_page_names_every_key_and_no_other(document):
    keys = set()

    def collect(value, path):
        if isinstance(value, dict):
            for key, item in value.items():
                name = "*" if path in OPEN else key
                keys.add(f"{path}{name}")
                collect(item, f"{path}{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for item in value:
                collect(item, path[:-1] + "[].")

    collect(document, "")
    page = DOCS.read_text().partition("\n## Files of a run\n")[2]
    reported = set(re.findall(r"^\| `([^`]+)` \|", page, flags=re.MULTILINE))
    # A table of the page that begins with a dot goes on for every score.
    score_keys = {key.removeprefix(".") for key in reported if key.startswith(".")}
    prefixes = ("scores.*.overall.", "scores.*.categories.*.", "scores.*.families.*.")
    reported = {key for key in reported if not key.startswith(".")}
    reported |= {prefix + key for prefix in prefixes for key in score_keys}
    assert keys == reported


OPEN = ("versions.", "scores.", "scores.*.categories.", "scores.*.families.")
"""Objects whose keys are names of things."""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("suite"), "suite is missing"),
        (lambda d: d["options"].update(seed="0"), r"options.seed must be a whole number, not '0'"),
        (lambda d: d["episodes"][3]["stages"][0].update(outcome="won"), r"episodes\[3\].stages\[0\].outcome is 'won'"),
        (lambda d: d["episodes"][0].update(stages=[]), "episode 0 has no stage; the file was changed"),
        (lambda d: d["scores"]["through"]["overall"].update(passed=20), "scores.through does not follow"),
        (lambda d: d["episodes"].pop(), "scores.through does not follow"),
        (lambda d: d.pop("scores"), "scores.through does not follow"),
    ],
)
def test_a_malformed_file_is_refused_with_the_place(document, change, message):
    change(document)
    with pytest.raises(RunError, match=message):
        results_from_json(document, "results.json")


def test_a_missing_or_broken_file_is_reported(tmp_path):
    with pytest.raises(RunError, match="give the --out folder of a finished run"):
        read_results(tmp_path)
    for text, says in (("{", "cannot be read"), ('{"schema": NaN}', "NaN is no finite number")):
        (tmp_path / "results.json").write_text(text)
        with pytest.raises(RunError, match=says):
            read_results(tmp_path)
    (tmp_path / "results.json").write_text("[]")
    with pytest.raises(RunError, match="is no results file of this version: its schema is None"):
        read_results(tmp_path)


def test_writing_and_reading_is_stable(document):
    assert results_to_json(results_from_json(document, "here")) == document


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
