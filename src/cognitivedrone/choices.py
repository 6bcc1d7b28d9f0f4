"""Literal types shared by several packages. Options use them, so this module imports nothing heavy."""

from __future__ import annotations

from typing import Literal

AppearanceName = Literal["plain", "varied", "photo"]
"""`plain`: the room as published. `varied`: floor, walls, light, colours and camera noise drawn from the seed. `photo`:
a place, with its light, and a camera drawn from the seed."""

ReasonerFault = Literal[
    "unreachable",
    "timeout",
    "http",
    "too_long",
    "unfinished",
    "garbage",
    "schema",
    "refusal",
    "no_such_gate",
    "unsure",
    "raised",
]
"""Why an answer is unusable: no connection, too late, an HTTP error, too much text, neither JSON nor a sentence about a
gate, a value of the wrong type, a refusal, a gate that does not exist, "cannot tell", an exception of the reasoner's
own."""

MessageFault = Literal[
    "bad_message",
    "bad_array",
    "bad_field",
    "missing_field",
    "too_large",
    "protocol_version",
    "unknown_session",
    "unauthorized",
    "too_many_clients",
    "too_many_requests",
    "busy",
    "no_reasoner",
    "no_answer",
    "policy_error",
    "bad_action",
    "non_finite_action",
    "internal",
]
"""Why a policy server refuses a message; the table in docs/own_policy.md explains each."""

AnswerKind = Literal["adopted", "agreed", "kept"]
"""What the filter did with a directive: adopted it, found it equal to the current one, or kept the current one."""

EventKind = (
    Literal[
        "segment",
        "corrected",
        "asked",
        "stale",
        "late",
        "unaided",
        "declined",
        "resumed",
        "lost",
        "back",
        "guard",
        "hold",
        "sure",
        "over",
        "landed",
    ]
    | AnswerKind
    | ReasonerFault
)
"""What happened in a flight: a new instruction, another gate is wanted for it (`corrected`), a question, an answer to
an earlier instruction, a missed deadline, that the reasoner has been late for so long that the policy flies without it
(`unaided`), what the filter did with an answer, the pilot reports that no gate matches the instruction (`declined`),
and no longer does (`resumed`), the policy only holds the position because its server does not answer (`lost`), and no
longer does (`back`). `fly` adds the safety rules' decisions, `hold` and `sure` (it hovers because the reasoner is
unsure, and flies on), and the flight's end."""

DecisionKind = Literal["fly", "hold", "brake", "land", "hands_off"]
"""Decisions of the safety rules, from mildest to strictest; `hands_off` leaves the vehicle to its pilot."""
