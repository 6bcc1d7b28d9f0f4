"""Reasoners: image and instruction in, a plain directive out.

`REASONERS` names those that come with the package; `make_reasoner` also takes a user's own "module:attribute", and
arguments for either, as `registry` says.
"""

from __future__ import annotations

from pathlib import Path

from cognitivedrone import registry
from cognitivedrone.adapters import as_reasoner
from cognitivedrone.interfaces import Reasoner

REASONERS: dict[str, str] = {
    "small": "cognitivedrone.reasoners.small:SmallReasoner",
    "oracle": "cognitivedrone.reasoners.oracle:Oracle",
    "noisy-oracle": "cognitivedrone.reasoners.noisy_oracle:NoisyOracle",
    "replay": "cognitivedrone.reasoners.replay:Replay",
    "vlm": "cognitivedrone.reasoners.vlm:Vlm",
    "vlm-local": "cognitivedrone.reasoners.vlm_local:LocalVlm",
}
NONE = "none"
"""Name of flying by the raw instruction."""


def reasoner_file(name: str) -> Path | None:
    """The file of weights or answers that a reasoner of the package by this name uses; none where it uses none.

    Raises `PolicyError` where the file is missing.
    """
    return None if name == NONE else registry.file_of("reasoner", name, REASONERS)


def make_reasoner(name: str) -> Reasoner | None:
    """A new reasoner by name and arguments, in the syntax of `registry`, or none for "none"; raises `PolicyError`."""
    if name == NONE:
        return None
    return as_reasoner(f"reasoner {name!r}", registry.make("reasoner", name, {**REASONERS, NONE: NONE}))
