"""The words that decide something in more than one room, as types. Options use them, so nothing heavy is imported."""

from __future__ import annotations

from typing import Literal

AppearanceName = Literal["plain", "varied"]
"""`plain`: the room as published. `varied`: floor, walls, light, colours and camera noise drawn from the seed."""

ReasonerFault = Literal[
    "unreachable", "timeout", "http", "too_long", "garbage", "schema", "refusal", "no_such_gate", "unsure", "raised"
]
"""What was wrong with an answer: no connection, too late, an HTTP error, more text than anybody needs, not JSON and not
a sentence about a gate, a value of another shape, a polite refusal, a gate that there is not, "cannot tell", an
exception of the reasoner's own."""

AnswerKind = Literal["adopted", "agreed", "kept"]
"""What became of a directive: flown by from now on, the same as the present one, or not enough to replace it."""

EventKind = (
    Literal["leg", "asked", "stale", "late", "guard", "hold", "sure", "over", "landed"] | AnswerKind | ReasonerFault
)
"""What happened in a flight: a new instruction, a question, an answer to an earlier instruction, a missed deadline,
what became of an answer; of `fly` also the safety rules' decision, `hold` and `sure` (it hovers since it is unsure, and
flies on), and the flight's end."""

DecisionKind = Literal["fly", "hold", "brake", "land", "hands_off"]
"""What the safety rules decide, from the mildest to the last: `hands_off` leaves the vehicle to its pilot."""
