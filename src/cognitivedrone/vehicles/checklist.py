"""What a vehicle reports of its fitness before a flight, as a person reads it."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from itertools import zip_longest
from typing import Literal

State = Literal["ok", "warn", "bad"]
"""Good; for the person to judge; and what nobody should fly with."""
COLUMNS, FOUND, GAP = 80, 25, "  "
"""Of the checklist as text: its width, that of what was found, and what is between two columns."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One row of the checklist."""

    what: str
    state: State
    found: str
    needed: str = ""
    why: str = ""
    settable: bool = False
    """Whether it is bad and, with consent, would be set."""


@dataclass(frozen=True, slots=True)
class Checklist:
    """All of it; `str` of it is what a person reads before saying yes, in a terminal of 80 columns or more.

    What is not ok has its reason below it.
    """

    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        names = max(len(finding.what) for finding in self.findings)
        needed = COLUMNS - len("[warn] ") - names - len(GAP) - FOUND - len(GAP)
        lines = [_line("      ", ("what", names), ("found", FOUND), ("needed", needed))]
        for f in self.findings:
            cells = [_wrapped(text, width) for text, width in ((f.what, names), (f.found, FOUND), (f.needed, needed))]
            for number, (what, found, need) in enumerate(zip_longest(*cells, fillvalue="")):
                mark = "      " if number else f"[{f.state:^4}]"
                lines.append(_line(mark, (what, names), (found, FOUND), (need, needed)))
            if f.why and f.state != "ok":
                below = _wrapped(f.why, FOUND + len(GAP) + needed)
                lines += [_line("      ", ("", names), (why, 0)) for why in below]
        return "\n".join(lines)

    def refusal(self, *, consent: bool) -> str:
        """All of it and what to do about what is bad; `consent` is whether parameters may be set already."""
        settable = [] if consent else [finding.what for finding in self.bad if finding.settable]
        by_us = f"; --set-parameters sets {', '.join(settable)} for the flight" if settable else ""
        bad = ", ".join(finding.what for finding in self.bad)
        return f"not fit to fly:\n{self}\nchange what is bad ({bad}), and try again{by_us}"

    @property
    def bad(self) -> tuple[Finding, ...]:
        """What nobody should fly with."""
        return tuple(finding for finding in self.findings if finding.state == "bad")


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, break_on_hyphens=False) or [""]


def _line(mark: str, *cells: tuple[str, int]) -> str:
    """A line of the checklist: texts, each padded to its width."""
    return f"{mark} {GAP.join(text.ljust(width) for text, width in cells)}".rstrip()
