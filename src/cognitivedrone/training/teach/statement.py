"""A way to ask for some of the pictures of a lesson."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Statement:
    """A way to ask, and the taught pictures for which it is right and clearly wrong."""

    phrases: tuple[str, ...]
    """Noun phrases, as in "the gate with ..."."""
    sentences: tuple[str, ...]
    """Whole instructions."""
    true: tuple[str, ...]
    """Names of attribute values, as in "concept/thing:violin"."""
    false: tuple[str, ...]
    by_name: bool = False
    """Whether it asks for a concept by its name."""
