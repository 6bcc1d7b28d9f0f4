"""A shard: one of n equal parts of a run, flown on its own and joined to the others by `merge`."""

from __future__ import annotations

import re
from dataclasses import dataclass

from cognitivedrone.errors import RunError


@dataclass(frozen=True, order=True, slots=True)
class Shard:
    """Part `number` of `count`, written "2/8": every eighth episode, from the second."""

    number: int
    """From 1."""
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def of(self, episodes: range) -> range:
        """Its share of the episodes; neighbours, which are often of one family, go to different shards."""
        return episodes[self.number - 1 :: self.count]


def parse_shard(text: str) -> Shard:
    """The shard written as "i/n", i from 1 to n. Raises `RunError`."""
    found = re.fullmatch(r"([1-9][0-9]{0,5})/([1-9][0-9]{0,5})", text)
    shard = Shard(*map(int, found.groups())) if found else None
    if shard is None or shard.number > shard.count:
        raise RunError(f"--shard is {text!r}; give i/n, such as 2/8 for the second of eight parts")
    return shard
