"""The one reader of JSON: what it refuses, and that nothing in the package reads JSON beside it."""

import ast
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import cognitivedrone
from cognitivedrone.text.json_text import MAX_DEPTH, NotJSON, parse_json

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=20,
)


@given(PLAIN)
def test_what_is_written_is_read(value: object) -> None:
    assert parse_json(json.dumps(value)) == value
    assert parse_json(json.dumps(value, ensure_ascii=False).encode("utf-8", "surrogatepass")) == value


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * 2000 + "]" * 2000, "deep within each other"),
        ("[" * 1_000_000, "deep within each other"),
        ('{"a":' * 70 + "1" + "}" * 70, "deep within each other"),
        ('{"a": 1, "a": 2}', "the name 'a' is given twice"),
        ("NaN", "NaN is no finite number"),
        ("[-Infinity]", "-Infinity is no finite number"),
        ("1e400", "1e400 is no finite number"),
        ("1" + "0" * 400, "a number of 401 digits"),
        ("-1" + "0" * 400 + ".5", "no finite number"),
        ("1" + "0" * 5000, "digits"),
        (b'"\xff"', "no text in UTF-8"),
        ("", "Expecting value"),
        ("{} {}", "Extra data"),
    ],
)
def test_what_has_no_single_plain_meaning_is_refused(text: str | bytes, reason: str) -> None:
    with pytest.raises(NotJSON, match=reason):
        parse_json(text)


def test_a_text_may_be_as_deep_and_as_large_as_the_limits() -> None:
    assert parse_json("[" * MAX_DEPTH + "]" * MAX_DEPTH) is not None
    with pytest.raises(NotJSON, match="deep"):
        parse_json("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1))
    assert parse_json(json.dumps("[" * 1000)) == "[" * 1000  # brackets of a text are no lists
    assert parse_json(json.dumps([[1]] * 1000)) == [[1]] * 1000
    assert parse_json("[1]", max_bytes=3) == [1]
    with pytest.raises(NotJSON, match="4 bytes, and at most 3"):
        parse_json("[12]", max_bytes=3)


def test_what_may_be_infinite_is_read_so_if_asked_for() -> None:
    assert parse_json("[1e400, -Infinity]", non_finite=True) == [float("inf"), float("-inf")]


def test_nothing_in_the_package_reads_json_beside_it() -> None:
    root = Path(cognitivedrone.__file__).parent
    readers = [
        f"{path.relative_to(root)}:{node.lineno}"
        for path in sorted(root.rglob("*.py"))
        if path.name != "json_text.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
        and node.attr in ("load", "loads", "JSONDecoder")
        and isinstance(node.value, ast.Name)
        and node.value.id == "json"
    ]
    assert readers == []
