"""The shared console of all commands: its input is plain text, never markup.

Tasks, labels, directives, data sets and models are untrusted. A bracket in one of them must not become one of rich's
styles, nor may an escape sequence reach the terminal.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from cognitivedrone.text.printable import visible


class _PlainConsole(Console):
    """Shows control characters in texts as escape sequences; styles come only from the program."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Render like rich, with every text made visible."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(visible(segment.text, keep="\n"), segment.style)


def console(
    *, stderr: bool = False, quiet: bool = False, width: int | None = None, file: IO[str] | None = None
) -> Console:
    """A console on standard output, standard error or a file, without markup, emoji codes or number highlighting.

    `quiet` prints nothing; `width` is in characters, by default the terminal's. A file gets plain text, also in a
    notebook, which otherwise counts as a terminal.
    """
    plain: dict[str, Any] = {"color_system": None, "force_jupyter": False} if file is not None else {}
    options = {"markup": False, "emoji": False, "highlight": False, **plain}
    return _PlainConsole(stderr=stderr, quiet=quiet, width=width, file=file, **options)
