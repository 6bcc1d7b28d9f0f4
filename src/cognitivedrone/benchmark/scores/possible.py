"""What a suite says of the flights through it: records and submissions of other flights are recognised by it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from cognitivedrone.types import Outcome, Task

_GOES_ON: Final = ("passed", "wrong_gate")
"""Outcomes after which a track goes on."""


def impossible(track: Sequence[Task], ends: Sequence[tuple[Outcome, int | None]]) -> str | None:
    """Why a flight through a track cannot have ended so, in one clause; None if it can.

    `ends` are outcome and chosen gate, 0 to 2, of every stage.
    """
    if len(ends) != len(track):
        return f"it has {len(ends)} stages, and its track {len(track)}"
    over = False
    for task, (outcome, chosen) in zip(track, ends, strict=True):
        if over != (outcome == "not_reached") or not _fits(outcome, chosen, task.target):
            return f"{task.id} cannot have ended as {outcome} with the gate {chosen}"
        over = outcome not in _GOES_ON
    return None


def _fits(outcome: Outcome, chosen: int | None, target: int | None) -> bool:
    """Whether a stage with this right gate can have ended so."""
    if chosen is not None and not 0 <= chosen <= 2:
        return False
    match outcome:
        case "passed":
            return chosen == target
        case "wrong_gate":
            return chosen not in (None, target)
        case "hesitated":
            return target is None
        case "false_alarm":
            return target is not None
        case "invalid" | "policy_error" | "not_reached":
            return chosen is None
        case _:
            return True
