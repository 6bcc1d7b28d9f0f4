"""The pages of a Parquet file: what each says of its size, which readers believe when they make room for it.

The footer of a file says how large its columns are when unpacked, but a forged one may say less than its pages do. A
page begins with a Thrift structure in the compact protocol (https://parquet.apache.org/docs/file-format/data-pages/,
https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md).
"""

from __future__ import annotations

import mmap
from pathlib import Path
from typing import Any, Final

from cognitivedrone.files import open_regular

_UNPACKED, _PACKED = 2, 3  # fields of a page's header
_STOP, _TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = 0, 1, 2, 3, 7, 8, 9, 10, 12
_WHOLE: Final = (4, 5, 6)  # of 16, 32 and 64 bits
_DEEPEST: Final = 8
_BESIDE: Final = 16
"""Pages beside those with rows, such as the dictionary's."""


def check_pages(path: Path, metadata: Any) -> None:
    """Raise `ValueError` if the pages of a column unpack to more than the footer says, or cannot be followed."""
    with open_regular(path) as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for number in range(metadata.num_row_groups):
            group = metadata.row_group(number)
            for column in map(group.column, range(group.num_columns)):
                where = f"column {column.path_in_schema} of row group {number}"
                _check_column(content, column, group.num_rows + _BESIDE, where)


def _check_column(content: mmap.mmap, column: Any, most_pages: int, where: str) -> None:
    begin = column.data_page_offset
    if column.has_dictionary_page and column.dictionary_page_offset is not None:
        begin = min(begin, column.dictionary_page_offset)
    end, at, unpacked = begin + column.total_compressed_size, begin, 0
    if not 0 <= begin <= end <= len(content):
        raise ValueError(f"{where} lies outside of the file")
    pages = 0
    while at < end:
        pages += 1
        if pages > most_pages:
            raise ValueError(f"{where} has more pages than rows")
        try:
            sizes, at = _header(content, at)
        except IndexError:
            raise ValueError(f"{where} is cut off") from None
        packed = sizes.get(_PACKED, -1)
        unpacked += max(sizes.get(_UNPACKED, 0), 0)
        if packed < 0 or at + packed > end:
            raise ValueError(f"{where} has a page outside of it")
        if unpacked > column.total_uncompressed_size:
            raise ValueError(f"{where} unpacks to more than the {column.total_uncompressed_size:,} bytes of its footer")
        at += packed


def _header(content: mmap.mmap, at: int) -> tuple[dict[int, int], int]:
    """The numbers of a structure by field, and where it ends."""
    numbers: dict[int, int] = {}
    field = 0
    while (head := content[at]) != _STOP:
        at += 1
        if head >> 4:
            field += head >> 4
        else:
            field, at = _number(content, at)
        kind = head & 15
        if kind in _WHOLE:
            numbers[field], at = _number(content, at)
        elif kind not in (_TRUE, _FALSE):  # their value is the kind itself
            at = _skipped(content, at, kind)
    return numbers, at + 1


def _skipped(content: mmap.mmap, at: int, kind: int, depth: int = 0) -> int:
    """Where a value of that kind ends."""
    if kind in (*_WHOLE, _BINARY):
        length, after = _varint(content, at)
        return after + (length if kind == _BINARY else 0)
    if kind in (_TRUE, _FALSE, _BYTE):  # in a list, a truth value has a byte
        return at + 1
    if kind == _DOUBLE:
        return at + 8
    if kind == _STRUCT and depth < _DEEPEST:
        while (head := content[at]) != _STOP:
            at += 1
            if not head >> 4:
                _, at = _varint(content, at)
            if head & 15 not in (_TRUE, _FALSE):
                at = _skipped(content, at, head & 15, depth + 1)
        return at + 1
    raise ValueError("a page has a header that no writer of Parquet makes")


def _number(content: mmap.mmap, at: int) -> tuple[int, int]:
    coded, at = _varint(content, at)
    return (coded >> 1) ^ -(coded & 1), at


def _varint(content: mmap.mmap, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError("a page has a number that is too long")
