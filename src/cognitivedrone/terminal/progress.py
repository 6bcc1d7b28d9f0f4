"""Progress bars on standard error, within 80 columns: progress, total, rate, time left."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from cognitivedrone.terminal import console

T = TypeVar("T")
BAR_WIDTH = 16


def redraws(screen: Console) -> bool:
    """Whether lines on it can change; a notebook needs ipywidgets for that, and shows a warning instead."""
    return not screen.is_jupyter or find_spec("ipywidgets") is not None


def progress_bar(
    *fields: str, show: bool = True, columns: Iterable[ProgressColumn] = (), screen: Console | None = None
) -> Progress:
    """A progress bar; `fields` are texts that `update` changes, `columns` come before the remaining time."""
    screen = screen or console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=BAR_WIDTH),
        MofNCompleteColumn(),
        *columns,
        TimeRemainingColumn(compact=True),
        *map(_Field, fields),
        console=screen,
        disable=not (show and redraws(screen)),
    )


class _Field(ProgressColumn):
    """A text of the task; on a long line it is truncated first."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def render(self, task: Task) -> Text:
        return Text(str(task.fields[self._name]), no_wrap=True, overflow="ellipsis")


def counted(items: Iterable[T], description: str, total: int | None, *, show: bool = True) -> Iterator[T]:
    """The items, counted by a bar."""
    with progress_bar(show=show) as bar:
        task = bar.add_task(description, total=total)
        for item in items:
            yield item
            bar.advance(task)


@contextmanager
def loading(description: str, modules: int) -> Iterator[None]:
    """A bar on a terminal, or else a line, for imports in the block, which load about so many modules."""
    bar = progress_bar()
    if not bar.console.is_terminal:
        bar.console.print(description)
        yield
        return
    before, over = len(sys.modules), threading.Event()
    task = bar.add_task(description, total=modules)

    def follow() -> None:
        while not over.wait(0.2):
            bar.update(task, completed=min(len(sys.modules) - before, modules - 1))

    thread = threading.Thread(target=follow, daemon=True)
    with bar:
        thread.start()
        try:
            yield
            bar.update(task, completed=modules)
        finally:
            over.set()
            thread.join()
