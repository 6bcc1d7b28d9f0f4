"""Gymnasium environments of the simulator, and the simulator as a `Drone`.

Importing this package registers `CognitiveDrone-v1` with Gymnasium, for `gymnasium.make` and `gymnasium.make_vec`;
`gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1")` does both in one line.
"""

from __future__ import annotations

import gymnasium

if "CognitiveDrone-v1" not in gymnasium.registry:
    gymnasium.register(
        "CognitiveDrone-v1",
        entry_point="cognitivedrone.envs.gym:CognitiveDroneEnv",
        vector_entry_point="cognitivedrone.envs.vector:CognitiveDroneVectorEnv",
    )
