"""The exchange formats by name, for export and import."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import cast

from cognitivedrone.data.episode import Episode, Split
from cognitivedrone.errors import DataError, PluginError
from cognitivedrone.registry import load

EXPORTS: dict[str, str] = {
    "rlds": "cognitivedrone.data.formats.rlds:export",
    "lerobot": "cognitivedrone.data.formats.lerobot:export",
    "lerobot-video": "cognitivedrone.data.formats.lerobot:export_video",
    "published": "cognitivedrone.data.formats.published:export",
    "mcap": "cognitivedrone.data.formats.mcap:export",
}
"""Writers by format name: `(episodes, out) -> count`."""

IMPORTS: dict[str, str] = {
    "rlds": "cognitivedrone.data.formats.rlds:read",
    "lerobot": "cognitivedrone.data.formats.lerobot:read",
    "published": "cognitivedrone.data.formats.published:read",
    "mcap": "cognitivedrone.data.formats.mcap:read",
}
"""Readers by format name: `(path) -> iterator of (split, episode)`. `lerobot` reads images and video."""


def export(episodes: Iterable[tuple[Split, Episode]], to: str, out: Path) -> int:
    """Write the episodes in the format `to`, a key of `EXPORTS` or the user's "module:attribute"; returns their number.

    `out` becomes a complete data set or stays unchanged. Raises `DataError` for an unknown format, a folder that is not
    empty, and anything that cannot be written.
    """
    try:
        writer = load("export format", to, EXPORTS)
    except PluginError as error:
        raise DataError(str(error)) from None
    return cast(int, writer(episodes, out))


def import_(path: Path, source: str) -> Iterator[tuple[Split, Episode]]:
    """The episodes of a data set in the format `source`, a key of `IMPORTS` or the user's "module:attribute".

    Raises `DataError` for an unknown format, and while reading for anything missing or broken, with the file's name.
    """
    try:
        reader = load("import format", source, IMPORTS)
    except PluginError as error:
        raise DataError(str(error)) from None
    return cast(Iterator[tuple[Split, Episode]], reader(path))
