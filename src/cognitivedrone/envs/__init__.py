"""Gymnasium environments over the simulator, and the simulator as a `Drone`.

`gymnasium.make("CognitiveDrone-v1")` and `gymnasium.make_vec("CognitiveDrone-v1", num_envs=16)` work once the package
is installed.
"""

from __future__ import annotations


def register() -> None:
    """Add the environments to Gymnasium's registry; called by Gymnasium itself through the package's entry point."""
    import gymnasium

    if "CognitiveDrone-v1" not in gymnasium.registry:
        gymnasium.register(
            "CognitiveDrone-v1",
            entry_point="cognitivedrone.envs.gym:CognitiveDroneEnv",
            vector_entry_point="cognitivedrone.envs.vector:CognitiveDroneVectorEnv",
        )
