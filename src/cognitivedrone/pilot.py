"""The pilot of a flight: a policy with its reasoner, made from the names in a plan."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from cognitivedrone import registry
from cognitivedrone.interfaces import Policy, Reasoner
from cognitivedrone.plan import PilotSpec
from cognitivedrone.policies import POLICIES, make_policy
from cognitivedrone.reasoners import NONE, REASONERS, make_reasoner


@dataclass(frozen=True, slots=True)
class Pilot:
    """A policy and an optional reasoner."""

    policy: Policy
    reasoner: Reasoner | None = None

    def check(self) -> None:
        """Raise `PolicyError` if policy or reasoner cannot fly."""
        self.policy.check()
        if self.reasoner is not None:
            self.reasoner.check()


def on_card(policy: str, reasoner: str = NONE) -> bool:
    """Whether each pilot of these names holds a network on a graphics card; raises `PluginError`."""
    return registry.on_card("policy", policy, POLICIES) or registry.on_card("reasoner", reasoner, REASONERS)


@contextmanager
def open_pilot(spec: PilotSpec) -> Iterator[Pilot]:
    """Policy and reasoner, ready to fly; both are closed on exit.

    Raises `PolicyError` if one cannot be made or cannot fly.
    """
    with ExitStack() as stack:
        policy = make_policy(spec.policy)
        stack.callback(policy.close)
        reasoner = make_reasoner(spec.reasoner)
        if reasoner is not None:
            stack.callback(reasoner.close)
        pilot = Pilot(policy, reasoner)
        pilot.check()
        yield pilot
