"""Policies: image and text in, velocity commands out.

`POLICIES` lists the package's own. `make_policy` also takes a user's "module:attribute"; both may have arguments, in
the syntax of `registry`.
"""

from __future__ import annotations

from pathlib import Path

from cognitivedrone import registry
from cognitivedrone.adapters import POLICY_METHODS, as_policy
from cognitivedrone.errors import PluginError
from cognitivedrone.interfaces import Policy

POLICIES: dict[str, str] = {
    "oracle": "cognitivedrone.policies.expert:Expert",
    "colour_seeker": "cognitivedrone.policies.colour_seeker:ColourSeeker",
    "small": "cognitivedrone.policies.small:Small",
    "race": "cognitivedrone.policies.small:Race",
    "openvla": "cognitivedrone.policies.openvla:OpenVla",
    "lerobot": "cognitivedrone.policies.lerobot:LeRobot",
    "remote": "cognitivedrone.policies.remote:Remote",
    "hover": "cognitivedrone.policies.baselines:Hover",
    "random": "cognitivedrone.policies.baselines:Random",
}
SELF_CONTAINED = ("oracle", "colour_seeker", "small", "race", "hover", "random")
"""Those that need no file of the user's, no server and no download: a file from somebody else may name them."""


def policy_files(name: str) -> tuple[Path, ...]:
    """Every file that the policy of this name decides by; none if it has none.

    Raises `PolicyError` if the file is missing.
    """
    return registry.files_of("policy", name, POLICIES, POLICY_METHODS)


def make_policy(name: str) -> Policy:
    """A new policy by its name and arguments, in the syntax of `registry`; raises `PolicyError`."""
    if name.endswith(".onnx") and ":" not in name:
        raise PluginError(f"policy {name!r} is a model file; write small:{name}")
    return as_policy(f"policy {name!r}", registry.make("policy", name, POLICIES, POLICY_METHODS))
