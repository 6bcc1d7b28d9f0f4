"""The exchange formats by name, for export and import: each is a module of this folder."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import cast

from cognitivedrone.data.episode import Episode, Split
from cognitivedrone.errors import DataError, PluginError
from cognitivedrone.registry import load


def _named(functions: str) -> dict[str, str]:
    """The functions with such a name, by "MODULE", or "MODULE-VARIANT" for `export_VARIANT`.

    They are found in the text of this folder's modules, which are imported only when they are used.
    """
    return {
        f"{file.stem}{variant}".replace("_", "-"): f"{__name__}.{file.stem}:{name}{variant}"
        for file in sorted(Path(__file__).parent.glob("[a-z]*.py"))
        for name, variant in re.findall(rf"^def {functions}\(", file.read_text(encoding="utf-8"), re.MULTILINE)
    }


EXPORTS: dict[str, str] = _named("(export)((?:_[a-z]+)?)")
"""Writers by format name: `(episodes, out) -> count`."""
IMPORTS: dict[str, str] = _named("(read)()")
"""Readers by format name: `(path) -> iterator of (split, episode)`. `lerobot` reads images and video."""


COLUMNED = frozenset({"rlds", "lerobot"})
"""Readers that take `columns`."""
FRONT_ONLY = frozenset({"published"})
"""Formats that have no place for the camera that looks down, and leave its frames out."""


def export(episodes: Iterable[tuple[Split, Episode]], to: str, out: Path) -> int:
    """Write the episodes in the format `to`, a key of `EXPORTS` or the user's "module:attribute"; returns their number.

    `out` becomes a complete data set or stays unchanged. Raises `DataError` for an unknown format, no episode, a folder
    that is not empty, and anything that cannot be written.
    """
    writer = _function("export format", to, EXPORTS)
    return cast(int, writer(_some(episodes, out) if to in EXPORTS else episodes, out))


def _some(episodes: Iterable[tuple[Split, Episode]], out: Path) -> Iterator[tuple[Split, Episode]]:
    """The same episodes; raises `DataError` where there is none."""
    count = 0
    for split, episode in episodes:
        count += 1
        yield split, episode
    if not count:
        raise DataError(f"{out}: there is no episode to export")


def import_(path: Path, source: str, columns: str = "") -> Iterator[tuple[Split, Episode]]:
    """The episodes of a data set in the format `source`, a key of `IMPORTS` or the user's "module:attribute".

    `columns` maps the numbers of others' data sets, in formats that take that (`foreign.Columns`).
    Raises `DataError` for an unknown format, and while reading for anything missing or broken, with the file's name.
    """
    reader = _function("import format", source, IMPORTS)
    if columns and "columns" not in inspect.signature(reader).parameters:
        raise DataError(f"--columns is for {', '.join(sorted(COLUMNED))}, not {source!r}; leave it out")
    return cast(Iterator[tuple[Split, Episode]], reader(path, columns=columns) if columns else reader(path))


def _function(kind: str, name: str, table: Mapping[str, str]) -> Callable[..., object]:
    """A reader or writer by name. A user's own must look like one before it is called: `os:system` does not."""
    try:
        function = load(kind, name, table)
    except PluginError as error:
        raise DataError(str(error)) from None
    annotated = "return" in getattr(function, "__annotations__", {})
    if name not in table and not (annotated or inspect.isgeneratorfunction(function)):
        raise DataError(
            f"{kind} {name!r} is not called: it is neither a generator function nor annotated with what it returns; see"
            " docs/data.md for the form of a reader and a writer"
        )
    return function
