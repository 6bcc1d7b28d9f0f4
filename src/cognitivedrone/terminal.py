"""The one console of all commands: what it is given is text, never markup.

Tasks, labels, directives, data sets and models come from anywhere. A bracket in one of them must not be taken for a
style of rich's, nor an escape sequence reach the terminal.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from cognitivedrone.printable import visible


class _PlainConsole(Console):
    """Shows control characters of texts as their escape sequences; styles come from the program alone."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """As rich renders, with every text made visible."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(visible(segment.text, keep="\n"), segment.style)


def console(
    *, stderr: bool = False, quiet: bool = False, width: int | None = None, file: IO[str] | None = None
) -> Console:
    """A console on standard output, standard error or a file, that takes no text for markup, emoji codes or numbers.

    `quiet` prints nothing; `width` is in characters, that of the terminal by default.
    """
    return _PlainConsole(stderr=stderr, quiet=quiet, width=width, file=file, markup=False, emoji=False, highlight=False)
