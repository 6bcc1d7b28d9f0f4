"""Which of the heartbeats under the vehicle's id are believed.

A heartbeat is one packet, and anybody behind the same router may send as the vehicle: a second vehicle of the same
system id does so all the time. What ends our part in a flight, a mode that we did not order or motors that stand
still, is therefore believed only when heartbeat after heartbeat shows it and nothing speaks against it. Until then the
drone is stopped, and no mode is ordered: it may be the pilot. When the vehicle shows itself again as we fly it,
the heartbeats have contradicted each other: two send as one.

A packet that was overtaken is no contradiction: by its sequence number it is older than one that we have, and it
shows what the vehicle has just left.

Where heartbeats go on contradicting each other, a pilot may have taken over the vehicle while somebody else sends as
it. Its own heartbeats are those whose sequence numbers follow those of its other messages. They alone are believed
then, and while it is not clear which they are, no mode is ordered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

SEEN, LASTS_S = 3, 0.25
"""What ends the flight is believed after so many heartbeats of the kind in a row, so long after the last other one."""
SEEN_IN_DOUBT, LASTS_IN_DOUBT_S = 6, 1.0
"""The same once heartbeats have contradicted each other: some of the vehicle's own may be lost."""
UNPROVEN_S = 3.0
"""And for motors that are said to stand still where height or speed speak against it, or nothing is known of them."""
STALE_S = 1.0
"""A packet may be overtaken by so much."""
DOUBT_S, CHAINED_S = 1.0, 0.5
"""After a heartbeat that does not agree, so long no mode is ordered; unless one that follows the vehicle's messages has
agreed within the shorter time, and none that does has not."""
TURNS, TURNS_S = 3, 2.5
"""Where every mode is right, so many returns to what was left, each and all within this time, are two vehicles. It is
longer than `STALE_S`, since of two vehicles that both count on, one always seems to be overtaken until that is over."""
_HALF = 128
"""Sequence numbers count to 255 and begin again: what is less than half of that ahead is newer."""

Grounded = Literal["yes", "no", "unproven"]
"""Whether the vehicle may stand on the ground: `no` where it reports that it flies, `unproven` where it does not report
it, and its height or speed speak against it."""


@dataclass(frozen=True, slots=True)
class Shown:
    """What one heartbeat shows."""

    mode: str
    armed: bool
    sequence: int
    """Of its packet, 0 to 255."""
    chained: bool = True
    """Whether another message with the number before came just now."""

    @property
    def words(self) -> str:
        """As a description."""
        return self.mode if self.armed else f"{self.mode} with stopped motors"

    def like(self, other: Shown) -> bool:
        """Whether both show the same."""
        return (self.mode, self.armed) == (other.mode, other.armed)


@dataclass(frozen=True, slots=True)
class Flown:
    """How the vehicle must show itself while it is ours."""

    modes: frozenset[str] | None = None
    """The mode that we ordered and, until it shows, those that it might be in; none for all."""
    armed: bool = False
    """Whether its motors must be running."""
    grounded: Grounded = "yes"

    def agrees(self, shown: Shown) -> bool:
        """Whether this heartbeat shows it so."""
        return (self.modes is None or shown.mode in self.modes) and (shown.armed or not self.armed)


@dataclass(frozen=True, slots=True)
class Heartbeats:
    """What the vehicle's heartbeats have shown; a time of -inf is never, by our steady clock, s."""

    last: Shown | None = None
    """The last that agrees with how we fly it."""
    last_at: float = -math.inf
    newest: int = 0
    """The newest sequence number of those."""
    left: tuple[tuple[Shown, float], ...] = ()
    """What it has just left, and when."""
    turns: tuple[float, ...] = ()
    """When it returned to that."""
    others: int = 0
    """Heartbeats since the last one that do not agree."""
    other: Shown | None = None
    """The newest of them."""
    believed: bool = False
    """Whether that is believed."""
    other_at: float = -math.inf
    """When one last did not."""
    chained_at: float = -math.inf
    """When one that is chained last agreed."""
    others_chained: int = 0
    """Chained ones since then that do not."""
    other_chained_at: float = -math.inf
    """When one last did not."""
    contradicted_at: float = -math.inf
    contradiction: str = ""
    """A description of the last one."""

    def suspicion(self, now: float) -> str:
        """Why the vehicle's mode is not known for sure, as a description; empty where it is."""
        if self.other is not None and not self.believed:
            return f"a heartbeat shows {self.other.words}, which was not ordered here: the next ones are waited for"
        proven = now - self.chained_at <= CHAINED_S and now - self.other_chained_at > DOUBT_S
        return self.contradiction if now - self.other_at <= DOUBT_S and not (proven or self.believed) else ""

    def foreign(self, now: float) -> bool:
        """Whether the vehicle's own heartbeats show something else, whatever others send as the vehicle."""
        return self.others_chained >= SEEN_IN_DOUBT and LASTS_IN_DOUBT_S <= now - self.chained_at < math.inf

    def accepts(self, shown: Shown) -> bool:
        """Whether the vehicle is as this heartbeat shows it, which `heard` was just given."""
        return self.last is shown or (self.other is shown and self.believed)


def heard(before: Heartbeats, shown: Shown, flown: Flown, now: float) -> Heartbeats:
    """What is known after one more heartbeat; whether that counts, `accepts` says."""
    left = tuple(each for each in before.left if now - each[1] < TURNS_S)
    before = replace(before, left=left, turns=tuple(at for at in before.turns if now - at < TURNS_S))
    if _just_left(before, shown, now) and not _newer(before, shown, now):
        return before
    if flown.agrees(shown):
        if not shown.chained and before.foreign(now):
            return before
        return _agreed(before, shown, now, any_mode=flown.modes is None)
    return _doubted(before, shown, flown.grounded, now)


def _agreed(before: Heartbeats, shown: Shown, now: float, *, any_mode: bool) -> Heartbeats:
    last, left, turns = before.last, before.left, before.turns
    if last is not None and not last.like(shown):
        turns = (*turns, now)[-TURNS:] if any(each.like(shown) for each, _ in left) else turns
        left = (*(each for each in left if not each[0].like(last) and not each[0].like(shown)), (last, now))
    after = replace(
        before,
        last=shown,
        last_at=now,
        newest=shown.sequence if _newer(before, shown, now) else before.newest,
        left=left,
        turns=turns,
        others=0,
        other=None,
        believed=False,
        chained_at=now if shown.chained else before.chained_at,
        others_chained=0 if shown.chained else before.others_chained,
    )
    other = before.other
    if other is None and any_mode and len(turns) == TURNS:
        other = last
    if other is None or (not any_mode and _just_left(before, other, now)):
        return after
    words = f"heartbeats contradict each other ({other.words}, then {shown.words})"
    return replace(after, contradicted_at=now, contradiction=words)


def _doubted(before: Heartbeats, shown: Shown, grounded: Grounded, now: float) -> Heartbeats:
    others, passed = before.others + 1, now - before.last_at
    in_doubt = bool(before.contradiction)
    enough = others >= (SEEN_IN_DOUBT if in_doubt else SEEN)
    lasts = enough and passed >= (LASTS_IN_DOUBT_S if in_doubt else LASTS_S)
    after = replace(before, others=others, other=shown, other_at=now)
    if shown.chained:
        after = replace(after, others_chained=before.others_chained + 1, other_chained_at=now)
    # Where some follow the vehicle's messages, the ones that do not are another's.
    own = shown.chained or not after.others_chained
    after = replace(after, believed=(lasts and own) or (shown.chained and after.foreign(now)))
    if shown.armed or grounded == "yes":
        return after
    if not after.believed and (others < SEEN or passed < LASTS_S):
        return after
    words = f"{others} heartbeats show stopped motors, while position and speed are those of a flight"
    believed = grounded == "unproven" and passed >= UNPROVEN_S
    return replace(after, believed=believed, contradicted_at=now, contradiction=words)


def _just_left(beats: Heartbeats, shown: Shown, now: float) -> bool:
    return any(each.like(shown) and now - at < STALE_S for each, at in beats.left)


def _newer(beats: Heartbeats, shown: Shown, now: float) -> bool:
    """Whether it was sent after all that agree, as far as that can be told."""
    return now - beats.last_at >= STALE_S or 0 < (shown.sequence - beats.newest) % 256 < _HALF


CHAIN_S = 0.1
"""So long ago the message before a heartbeat may have come."""


class Chain:
    """The sequence numbers of the messages that are no heartbeats."""

    def __init__(self) -> None:
        self._came = [-math.inf] * 256

    def note(self, sequence: int, now: float) -> None:
        """A message with this number came."""
        self._came[sequence] = now

    def follows(self, sequence: int, now: float) -> bool:
        """Whether the message with the number before came just now."""
        return now - self._came[(sequence - 1) % 256] <= CHAIN_S
