"""Missions: one sentence for a whole flight, cut into sub-goals, one for each stage. Pure text."""

from cognitivedrone.tasks.missions.corrections import rejects
from cognitivedrone.tasks.missions.cutting import (
    LONGEST,
    forbidden_colors,
    is_mission,
    lands,
    pad_directive,
    problem_of,
    sub_goals,
)

__all__ = [
    "LONGEST",
    "forbidden_colors",
    "is_mission",
    "lands",
    "pad_directive",
    "problem_of",
    "rejects",
    "sub_goals",
]
