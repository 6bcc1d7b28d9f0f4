"""Missions: one sentence for a whole flight, read into sub-goals, one for each stage. Pure text."""

from cognitivedrone.tasks.missions.corrections import rejects
from cognitivedrone.tasks.missions.parts import LONGEST, lands, pad_directive
from cognitivedrone.tasks.missions.phrases import LOOKS
from cognitivedrone.tasks.missions.reading import (
    asked_of,
    forbidden,
    is_mission,
    problem_of,
    read,
    sub_goals,
    told,
)

__all__ = [
    "LONGEST",
    "LOOKS",
    "asked_of",
    "forbidden",
    "is_mission",
    "lands",
    "pad_directive",
    "problem_of",
    "read",
    "rejects",
    "sub_goals",
    "told",
]
