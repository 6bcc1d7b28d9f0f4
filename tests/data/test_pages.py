"""Pages of Parquet files are followed without being unpacked; a footer that says too little of them is found out."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cognitivedrone.data.pages import check_pages

TABLE = pa.table(
    {
        "number": np.arange(300.0),
        "list": pa.array([[1.0, 2.0]] * 300, pa.list_(pa.float32(), 2)),
        "image": pa.array([b"x" * 40] * 300),
    }
)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pages") / "table.parquet"
    pq.write_table(TABLE, path, compression="zstd", row_group_size=100)
    return path


def footer(path: Path, **changes: Any) -> SimpleNamespace:
    """What a file's footer says, with changes to all columns."""
    found = pq.read_metadata(path)
    names = ("path_in_schema", "data_page_offset", "dictionary_page_offset", "has_dictionary_page",
             "total_compressed_size", "total_uncompressed_size")  # fmt: skip

    def group(number: int) -> SimpleNamespace:
        here = found.row_group(number)
        columns = [
            SimpleNamespace(**{name: getattr(here.column(k), name) for name in names} | changes)
            for k in range(here.num_columns)
        ]
        return SimpleNamespace(num_rows=here.num_rows, num_columns=here.num_columns, column=columns.__getitem__)

    return SimpleNamespace(num_row_groups=found.num_row_groups, row_group=group)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "gzip"},
        {"compression": "none", "use_dictionary": False},
        {"data_page_version": "2.0", "write_page_checksum": True},
        {"data_page_size": 100, "use_dictionary": False},
        {"write_statistics": False, "row_group_size": 7},
    ],
)
def test_sound_files_pass(tmp_path: Path, options: dict[str, Any]) -> None:
    path = tmp_path / "table.parquet"
    pq.write_table(TABLE, path, **options)
    check_pages(path, pq.read_metadata(path))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"total_uncompressed_size": 20}, "column number of row group 0 unpacks to more than the 20 bytes"),
        ({"total_compressed_size": 10**9}, "lies outside of the file"),
        ({"data_page_offset": -5}, "lies outside of the file"),
        ({"total_compressed_size": 30}, "has a page outside of it"),
    ],
)
def test_a_footer_that_says_too_little_is_found_out(file: Path, change: dict[str, int], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        check_pages(file, footer(file, **change))


@given(st.data())
@settings(max_examples=200, deadline=None)
def test_any_damage_is_found_or_does_no_harm(file: Path, data: st.DataObject) -> None:
    metadata = pq.read_metadata(file)
    content = bytearray(file.read_bytes())
    begin = metadata.row_group(0).column(0).dictionary_page_offset
    for _ in range(data.draw(st.integers(1, 8))):
        content[begin + data.draw(st.integers(0, 60))] = data.draw(st.integers(0, 255))
    damaged = file.with_name("damaged.parquet")
    damaged.write_bytes(content)
    try:
        check_pages(damaged, metadata)
    except ValueError as error:
        assert str(error)  # noqa: PT017 - or nothing is raised
