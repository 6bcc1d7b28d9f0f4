"""Reasoners: image and instruction in, a plain directive out.

`REASONERS` lists the package's own. `make_reasoner` also takes a user's "module:attribute"; both may have arguments, in
the syntax of `registry`.
"""

from __future__ import annotations

from pathlib import Path

from cognitivedrone import registry
from cognitivedrone.adapters import REASONER_METHODS, as_reasoner
from cognitivedrone.interfaces import Reasoner

REASONERS: dict[str, str] = {
    "small": "cognitivedrone.reasoners.small:SmallReasoner",
    "oracle": "cognitivedrone.reasoners.oracle:Oracle",
    "noisy-oracle": "cognitivedrone.reasoners.oracle:NoisyOracle",
    "replay": "cognitivedrone.reasoners.replay:Replay",
    "published": "cognitivedrone.reasoners.replay:Published",
    "vlm": "cognitivedrone.reasoners.vlm:Vlm",
    "remote": "cognitivedrone.reasoners.remote:Remote",
    "vlm-local": "cognitivedrone.reasoners.vlm_local:LocalVlm",
}
NONE = "none"
"""Name for no reasoner: the policy gets the raw instruction."""
SELF_CONTAINED = ("small", "oracle", "noisy-oracle")
"""Those that need no file of the user's and no server: a file from somebody else may name them."""


def reasoner_files(name: str) -> tuple[Path, ...]:
    """The files that the package's reasoner of this name answers by; raises `PolicyError` if one is missing."""
    return () if name == NONE else registry.files_of("reasoner", name, REASONERS, REASONER_METHODS)


def make_reasoner(name: str) -> Reasoner | None:
    """A new reasoner by name and arguments, in the syntax of `registry`, or none for "none"; raises `PolicyError`."""
    if name == NONE:
        return None
    made = registry.make("reasoner", name, {**REASONERS, NONE: NONE}, REASONER_METHODS)
    return as_reasoner(f"reasoner {name!r}", made)
