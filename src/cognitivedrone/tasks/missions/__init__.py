"""Missions: one sentence for a whole flight, read into sub-goals, one for each stage. Pure text."""

from cognitivedrone.tasks.missions.goals import (
    LONGEST,
    asked_of,
    changed,
    is_mission,
    lands,
    longest,
    look_of,
    looks_of,
    pad_directive,
    parts_of,
    rejects,
    shuts,
    things_of,
    told,
    way,
)
from cognitivedrone.tasks.missions.reading import forbidden, forbidding, problem_of, read, sub_goals

__all__ = [
    "LONGEST",
    "asked_of",
    "changed",
    "forbidden",
    "forbidding",
    "is_mission",
    "lands",
    "longest",
    "look_of",
    "looks_of",
    "pad_directive",
    "parts_of",
    "problem_of",
    "read",
    "rejects",
    "shuts",
    "sub_goals",
    "things_of",
    "told",
    "way",
]
