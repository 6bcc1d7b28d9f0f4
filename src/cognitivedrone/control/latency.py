"""Inference latency: measured, and charged to the clock of a simulated flight.

A simulated clock stands still while a policy or reasoner computes. To fly as on a real drone, their latency is charged
to the clock: as measured on this machine, as a fixed number, or drawn from samples taken on another machine.
"""

from __future__ import annotations

import hashlib
import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cognitivedrone.control.calls import NO_WATCH, Watch, calling, check_chunk
from cognitivedrone.errors import SimulationError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.files.texts import decoded
from cognitivedrone.interfaces import Policy
from cognitivedrone.types import Action, ActionChunk, EpisodeContext, Observation

LONGEST_S = 60.0
"""Longest delay that can be charged."""
_LARGEST_FILE = 16_000_000
_UNITS_S = {"ms": 1e-3, "s": 1.0}
_HOW = "give none, measured, or parts as policy=80ms,reasoner=450ms; a part may also be measured, or a file of ms"

LatencyModel = Callable[[float], float]
"""From the measured seconds to the seconds that are charged."""


class TimedPolicy(Policy):
    """Wraps a policy, measures its decisions and reports its calls to a watch.

    Each method raises `PolicyRaised` if the policy raises an exception that is not one of this package.
    """

    def __init__(self, policy: Policy, watch: Watch = NO_WATCH) -> None:
        self.policy = policy
        self.needs_ground_truth, self.needs_seed = policy.needs_ground_truth, policy.needs_seed
        self._watch = watch
        self.took_s: list[float] = []
        """Duration of each decision, s of wall time."""
        self._first: ActionChunk | None = None
        self._varies = False

    @property
    def declines(self) -> bool:  # type: ignore[override]
        """Whether the policy declines."""
        with calling("the policy", self._watch):
            return self.policy.declines

    @property
    def present(self) -> float | None:  # type: ignore[override]
        """The policy's probability that a gate matches the instruction."""
        with calling("the policy", self._watch):
            return self.policy.present

    @property
    def trouble(self) -> str:  # type: ignore[override]
        """Why the policy only holds the position."""
        with calling("the policy", self._watch):
            return self.policy.trouble

    def around(self, action: Action) -> Action:
        """As `Policy.around`."""
        with calling("the policy", self._watch):
            return self.policy.around(action)

    def reset(self, context: EpisodeContext) -> None:
        """Start a stage."""
        with calling("the policy", self._watch):
            self.policy.reset(context)

    def act(self, observation: Observation) -> ActionChunk:
        """Decide, and measure the time. Raises `ActionError` for what is no chunk of actions."""
        begin = time.perf_counter()
        with calling("the policy", self._watch):
            chunk = check_chunk(self.policy.act(observation))
        self.took_s.append(time.perf_counter() - begin)
        if self._first is None:
            self._first = chunk.copy()
        elif not self._varies:
            self._varies = not np.array_equal(self._first, chunk)
        return chunk

    @property
    def repeated(self) -> tuple[float, float, float, float] | None:
        """The first action of its answer, if that was the same every time and at least twice; otherwise none."""
        if self._first is None or self._varies or len(self.took_s) < 2:
            return None
        vx, vy, vz, yaw_rate = map(float, self._first[0])
        return vx, vy, vz, yaw_rate

    def check(self) -> None:
        """Call the policy's method."""
        self.policy.check()

    def close(self) -> None:
        """Call the policy's method."""
        self.policy.close()


@dataclass(frozen=True, slots=True)
class Delay:
    """The latency charged for each decision of policy or reasoner."""

    samples_s: tuple[float, ...] = (0.0,)
    """Samples to draw from, all equally likely; a single one is a fixed delay."""
    measured: bool = False
    """Charge the measured time instead."""

    def latency_model(self, rng: np.random.Generator) -> LatencyModel:
        """The latency model of one flight; draws depend only on `rng`."""
        if self.measured:
            return lambda needed_s: needed_s
        if len(self.samples_s) == 1:
            return lambda _: self.samples_s[0]
        return lambda _: self.samples_s[int(rng.integers(len(self.samples_s)))]


@dataclass(frozen=True, slots=True)
class Delays:
    """The latencies charged for policy and reasoner."""

    policy: Delay = Delay()
    reasoner: Delay = Delay()
    identity: str = "none"
    """The option's text with file names replaced by hashes: equal for equal delays."""


def parse_delays(text: str, *, files: bool = True) -> Delays:
    """Delays from "none", "measured", "policy=80ms,reasoner=0.45s", "reasoner=measured" or "reasoner=samples.txt".

    A file contains one delay in ms per line; empty lines and text after a # are skipped. Raises `SimulationError`, also
    for a file where none is allowed: where the text is not this person's.
    """
    text = text.strip()
    if text == "none":
        return Delays()
    if text == "measured":
        return Delays(Delay(measured=True), Delay(measured=True), text)
    parts: dict[str, Delay] = {}
    identity = []
    for item in text.split(","):
        name, _, value = (word.strip() for word in item.partition("="))
        if name not in ("policy", "reasoner") or not value or name in parts:
            raise SimulationError(f"--latency {text}: cannot read {item.strip()!r}; {_HOW}")
        parts[name], canonical = _delay(value, text, files)
        identity.append(f"{name}={canonical}")
    return Delays(**parts, identity=",".join(sorted(identity)))


def _delay(value: str, text: str, files: bool) -> tuple[Delay, str]:
    """One part's delay, and what identifies it."""
    if value == "measured":
        return Delay(measured=True), value
    number = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)(ms|s)", value)
    if number:
        return Delay((_checked(float(number[1]) * _UNITS_S[number[2]], f"--latency {text}"),)), value
    if not files:
        raise SimulationError(f"--latency {text[:80]!r} depends on a file, which is not read here; {_HOW}")
    path = Path(value)
    if not path.is_file():
        raise SimulationError(f"--latency {text}: {value!r} is neither a time such as 80ms nor a file; {_HOW}")
    if path.stat().st_size > _LARGEST_FILE:
        raise SimulationError(f"--latency {text}: {path} is over {_LARGEST_FILE // 10**6} MB; give fewer samples")
    try:
        content = read_regular(path, _LARGEST_FILE)
    except OSError as error:
        raise SimulationError(f"--latency {text}: {path} cannot be read: {reason_of(error)}; {_HOW}") from None
    try:
        samples = tuple(_samples(decoded(content), path))
    except ValueError as error:
        raise SimulationError(f"--latency {text}: {path} cannot be read: {error}") from None
    if not samples:
        raise SimulationError(f"--latency {text}: {path} contains no number; write one delay in ms per line")
    return Delay(samples), f"sha256:{hashlib.sha256(content).hexdigest()}"


def _samples(content: str, path: Path) -> list[float]:
    samples = []
    for number, line in enumerate(content.splitlines(), start=1):
        value = line.partition("#")[0].strip()
        if not value:
            continue
        try:
            samples.append(_checked(float(value) * 1e-3, f"{path}, line {number}"))
        except ValueError:
            raise SimulationError(f"{path}, line {number}: {value!r} is not a number (of ms)") from None
    return samples


def _checked(seconds: float, where: str) -> float:
    if not (math.isfinite(seconds) and 0 <= seconds <= LONGEST_S):
        raise SimulationError(f"{where}: the delay is {seconds:g} s; it must be from 0 to {LONGEST_S:.0f} s")
    return seconds
