"""Reasoners: image and instruction in, a plain directive out.

`REASONERS` names those that come with the package; `make_reasoner` also takes a user's own "module:attribute".
"""

from __future__ import annotations

from cognitivedrone import plugins
from cognitivedrone.interfaces import Reasoner

REASONERS: dict[str, str] = {
    "oracle": "cognitivedrone.reasoners.oracle:Oracle",
}
NONE = "none"
"""Name of flying by the raw instruction."""


def make_reasoner(name: str) -> Reasoner | None:
    """A new reasoner by name or "module:attribute", or none for "none"; raises `PolicyError`."""
    if name == NONE:
        return None
    reasoner: Reasoner = plugins.make("reasoner", name, {**REASONERS, NONE: NONE}, ("refine",))
    return reasoner
