"""The pilot of a flight: a policy with its reasoner, made from the names in a plan."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from cognitivedrone.interfaces import Checked, Policy, Reasoner
from cognitivedrone.plan import PilotSpec
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner


@dataclass(frozen=True, slots=True)
class Pilot:
    """What flies."""

    policy: Policy
    reasoner: Reasoner | None = None


@contextmanager
def open_pilot(spec: PilotSpec) -> Iterator[Pilot]:
    """Policy and reasoner, ready to fly; whatever they hold open is closed at the end.

    Raises `PolicyError` where one cannot be made, or reports that it could not fly.
    """
    with ExitStack() as stack:
        pilot = Pilot(make_policy(spec.policy), make_reasoner(spec.reasoner))
        for part in (pilot.policy, pilot.reasoner):
            close = getattr(part, "close", None)
            if callable(close):
                stack.callback(close)
        check_ready(pilot)
        yield pilot


def check_ready(pilot: Pilot) -> None:
    """Raise `PolicyError` where policy or reasoner report that they could not fly."""
    for part in (pilot.policy, pilot.reasoner):
        if isinstance(part, Checked):
            part.check()
