"""Parameters of a vehicle that are changed for a flight, and put back after it, whatever ends it.

A journal on disk keeps the old values, written before anything is changed: a program that is killed leaves it, and the
next one that meets the vehicle puts the values back first. A value that has been changed by others meanwhile stays.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import re
import threading
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from cognitivedrone.errors import LinkError
from cognitivedrone.files import read_regular, reason_of, remove, replace_file, safe_name
from cognitivedrone.text.json_text import parse_json

ACTS_IN_FLIGHT: Final = frozenset(
    {
        *("FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "FENCE_ENABLE", "FENCE_ACTION", "BATT_FS_LOW_ACT"),
        *("NAV_DLL_ACT", "GF_ACTION", "COM_LOW_BAT_ACT"),
    }
)
"""What makes a vehicle change its mode by itself: put back as soon as a pilot has taken over. The rest waits for the
ground: `FS_OPTIONS` spares a pilot, and the failsafe must not begin to watch another ground station in the air."""
REPEAT_S = 0.5
LARGEST = 100_000


class ChangedParameters(Protocol):
    """A vehicle that is asked for parameters: `Connection`."""

    def parameters(self, names: Sequence[str]) -> dict[str, float | None]:
        """The values; none where it does not answer."""

    def set_parameter(self, name: str, value: float) -> None:
        """Set one and see that it took."""

    def send_parameter(self, name: str, value: float) -> None:
        """Set one, without waiting."""

    def reported_parameter(self, name: str) -> float | None:
        """The value that the vehicle last reported."""


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter."""

    was: float
    now: float
    """As we set it."""


def journal_of(vehicle: str) -> Path:
    """Where changes to a vehicle are kept from one run of the program to the next."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "cognitivedrone" / "parameters" / f"{safe_name(vehicle)}.json"


def vehicle_key(uid: int, uid2: Collection[int], system: int, url: str) -> str:
    """A name for a vehicle that stays the same: its own number where it has one."""
    if any(uid2):
        return bytes(uid2).hex()
    return f"{uid:016x}" if uid else f"system {system} {hashlib.sha256(url.encode()).hexdigest()[:8]}"


class ParameterChanges:
    """What was changed on one vehicle and not put back yet.

    Without a `journal` (a vehicle that ends with the program) nothing is kept, and nothing put back.
    """

    def __init__(self, journal: Path | None) -> None:
        self._journal = journal
        self._open = {} if journal is None else _read(journal)
        self._printed_at = -math.inf
        self._waiting = False
        """A thread waits in `put_back`: the loop that reads the link leaves it the work. Both may still send once."""
        self._keeping = threading.Lock()

    @property
    def open(self) -> Mapping[str, Change]:
        """By name."""
        return self._open

    def make(self, link: ChangedParameters, values: Mapping[str, float | None], wanted: Mapping[str, float]) -> None:
        """Set what is wanted. Raises `LinkError` where a value does not take, or what was cannot be kept."""
        for name, value in wanted.items():
            was = self._open[name].was if name in self._open else values[name]
            if was is not None:
                self._open[name] = Change(was, value)
        self._keep()
        for name, value in wanted.items():
            link.set_parameter(name, value)

    def put_back(self, link: ChangedParameters, *, flying: bool = False) -> tuple[str, ...]:
        """Put back what may go now, waiting for it; the names of those that stay as we set them."""
        if self._journal is None or not self._open:
            return ()
        self._waiting = True
        try:
            changes = dict(self._open)
            failed = [name for name in changes if flying and name not in ACTS_IN_FLIGHT]
            for name, value in link.parameters([name for name in changes if name not in failed]).items():
                if value is None:
                    failed.append(name)
                    continue
                if math.isclose(value, changes[name].now, rel_tol=1e-5):
                    try:
                        link.set_parameter(name, changes[name].was)
                    except LinkError:
                        failed.append(name)
                        continue
                self._open.pop(name, None)
            self._keep()
        finally:
            self._waiting = False
        return tuple(failed)

    def put_back_meanwhile(self, link: ChangedParameters, now: float, *, flying: bool) -> None:
        """Put back, without waiting, what may go now: called again and again, from where the link is listened to."""
        if self._journal is None or not self._open or self._waiting:
            return
        changes = {name: change for name, change in dict(self._open).items() if not flying or name in ACTS_IN_FLIGHT}
        # MAVLink brings a value back in single precision.
        back = [name for name, it in changes.items() if link.reported_parameter(name) == float(np.float32(it.was))]
        for name in back:
            self._open.pop(name, None)
        if back:
            with contextlib.suppress(LinkError):  # a full disk: the next start finds them as they were
                self._keep()
        if now - self._printed_at >= REPEAT_S:
            self._printed_at = now
            for name, change in changes.items():
                if name not in back:
                    link.send_parameter(name, change.was)

    def _keep(self) -> None:
        """Write the journal whole, or remove it with the last change."""
        if self._journal is None:
            return
        try:
            with self._keeping:
                content = {name: [change.was, change.now] for name, change in dict(self._open).items()}
                if not content:
                    remove(self._journal.parent, self._journal.name)
                    return
                self._journal.parent.mkdir(parents=True, exist_ok=True)
                replace_file(self._journal, json.dumps(content, indent=1).encode())
        except OSError as error:
            raise LinkError(
                f"cannot write {self._journal}, the journal of the vehicle's parameters: {reason_of(error)}"
            ) from None


_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,15}")
"""How vehicles name their parameters."""


def _read(journal: Path) -> dict[str, Change]:
    """What an earlier run left behind."""
    try:
        content = parse_json(read_regular(journal, LARGEST))
        changes = {name: Change(float(was), float(now)) for name, (was, now) in content.items()}
        for name, change in changes.items():
            if not (_NAME.fullmatch(name) and math.isfinite(change.was) and math.isfinite(change.now)):
                raise ValueError(f"{name[:40]!r} is no parameter with two finite values")
        return changes
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise LinkError(
            f"cannot read {journal}, the journal of the vehicle's parameters before an earlier flight: {error};"
            " check them with a ground station, then remove it"
        ) from None
