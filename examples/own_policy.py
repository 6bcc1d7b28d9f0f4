"""Score a policy of your own: any class with `reset` and `act`.

Run: PYTHONPATH=examples cognitivedrone bench --policy own_policy:Straight --suite open-v1:smoke --out results/straight
"""

import numpy as np

from cognitivedrone.types import ActionChunk, EpisodeContext, Observation


class Straight:
    """Flies straight ahead at the gates' height, whatever it is asked; passes the middle gate if it starts in line."""

    def reset(self, context: EpisodeContext) -> None:
        """A stage begins: `context.instruction` says what to do."""

    def act(self, observation: Observation) -> ActionChunk:
        """vx, vy, vz in m/s and yaw rate in rad/s, in the heading frame; one row a control step of 0.1 s."""
        return np.array([[1.2, 0.0, 0.9 - observation.height, 0.0]], dtype=np.float32)
