"""Registers CognitiveDrone with LeRobot: `lerobot-eval --env.type=cognitivedrone`.

The environment itself is `cognitivedrone.integrations.lerobot.LeRobotEnv`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import gymnasium
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

ENV = "CognitiveDrone-v1"

# Without Gymnasium's own wrappers: LeRobot reads the instruction from the environment itself.
if f"{__name__}/{ENV}" not in gymnasium.registry:
    gymnasium.register(
        f"{__name__}/{ENV}",
        entry_point="cognitivedrone.integrations.lerobot:LeRobotEnv",
        order_enforce=False,
        disable_env_checker=True,
    )


def _features() -> dict[str, PolicyFeature]:
    return {
        "action": PolicyFeature(type=FeatureType.ACTION, shape=(4,)),
        "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(5,)),
        "pixels/front": PolicyFeature(type=FeatureType.VISUAL, shape=(256, 256, 3)),
    }


def _features_map() -> dict[str, str]:
    return {
        "action": "action",
        "agent_pos": "observation.state",
        "pixels/front": "observation.images.front",
    }


@EnvConfig.register_subclass("cognitivedrone")
@dataclass
class CognitiveDroneConfig(EnvConfig):
    """Options of `LeRobotEnv`, as `--env.NAME=VALUE`."""

    task: str | None = None
    """Keep the tracks of one family, such as "letters"; several, separated by commas, are reported one by one."""
    fps: int = 10
    features: dict[str, PolicyFeature] = field(default_factory=_features)
    features_map: dict[str, str] = field(default_factory=_features_map)
    suite: str = "open-v1:test"
    """Name of a suite of tasks."""
    tasks: str | None = None
    """Task file, or folder of them, in place of a suite."""
    labels: str | None = None
    """Folder of label images that take precedence over the shipped ones."""
    seed: int = 0
    """Seed of start, appearance and wind, as of `cognitivedrone bench --seed`."""
    track: bool = False
    """Chain single tasks into tracks of five."""
    appearance: str = "plain"
    """How the room looks: plain, varied, or photo: photographed places."""
    place: str = ""
    """Where to fly with photo: training, kept, a name of `cognitivedrone list`, or a panorama's file."""
    airframe: str = "racer"
    """The drone that flies: racer or iris."""
    wind: float = 0.0
    """Speed of a steady wind, m/s."""
    time_limit_s: float = 30.0
    """Seconds for each stage."""
    results: str | None = None
    """File that receives the whole result of every episode, one line of JSON each."""

    @property
    def package_name(self) -> str:
        """The package that registers the environment with Gymnasium."""
        return __name__

    @property
    def gym_id(self) -> str:
        """The environment's name in Gymnasium."""
        return f"{__name__}/{ENV}"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """The environment's arguments."""
        own = {each.name for each in fields(self)} - {each.name for each in fields(EnvConfig)}
        return {name: getattr(self, name) for name in ("task", *sorted(own))}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gymnasium.vector.VectorEnv]]:
        """One group of environments for every family in `task`, or one of all tracks. LeRobot 0.6 and newer call it."""
        groups = {}
        for family in (self.task or "").split(","):
            one = replace(self, task=family.strip() or None)
            ((vectors),) = EnvConfig.create_envs(one, n_envs, use_async_envs).values()
            groups[family.strip() or self.type] = vectors
        return groups
