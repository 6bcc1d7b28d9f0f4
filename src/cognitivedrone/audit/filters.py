"""Pilots that see the same flight through another camera: darker, turned about its axis, or shifted.

    cognitivedrone.audit.filters:FilteredPolicy:small,light=0.5

A turn about the optical axis and a small shift are what a crooked mounting does to the picture; what the camera would
see beyond the picture's edge is the edge repeated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from PIL import Image as PillowImage

from cognitivedrone.interfaces import Policy, Reasoner
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.types import ActionChunk, EpisodeContext, Guidance, Image, Observation, SubGoal

_GAMMA = 2.2


@dataclass(frozen=True, slots=True)
class Filter:
    """What is done to every picture."""

    light: float = 1.0
    """Share of the light that reaches the camera."""
    roll_deg: float = 0.0
    """Turn of the camera about its axis, clockwise as seen from behind it."""
    shift_px: float = 0.0
    """Shift of the picture to the right and down, px."""

    def __call__(self, image: Image) -> Image:
        """The picture (H, W, 3) as this camera takes it."""
        if self.light != 1.0:
            scale = self.light ** (1 / _GAMMA)
            image = np.clip(image.astype(np.float32) * scale, 0, 255).astype(np.uint8)
        if not self.roll_deg and not self.shift_px:
            return image
        height, width = image.shape[:2]
        edge = max(height, width) // 3
        wide = PillowImage.fromarray(np.pad(image, ((edge, edge), (edge, edge), (0, 0)), mode="edge"))
        turned = wide.rotate(
            self.roll_deg, PillowImage.Resampling.BILINEAR, translate=(round(self.shift_px), round(self.shift_px))
        )
        return np.asarray(turned)[edge : edge + height, edge : edge + width].copy()


class FilteredPolicy(Policy):
    """A policy behind a filter."""

    def __init__(self, policy: str, light: float = 1.0, roll_deg: float = 0.0, shift_px: float = 0.0) -> None:
        self._filter, self._policy = Filter(light, roll_deg, shift_px), make_policy(policy)
        self.needs_ground_truth, self.needs_seed = self._policy.needs_ground_truth, self._policy.needs_seed
        self.needs_down_camera = self._policy.needs_down_camera

    @property
    def declines(self) -> bool:  # type: ignore[override]
        """As the policy."""
        return self._policy.declines

    @property
    def present(self) -> float | None:  # type: ignore[override]
        """As the policy."""
        return self._policy.present

    def reset(self, context: EpisodeContext) -> None:
        """As the policy."""
        self._policy.reset(context)

    def check(self) -> None:
        """As the policy."""
        self._policy.check()

    def act(self, observation: Observation) -> ActionChunk:
        """As the policy, of the filtered picture."""
        down = None if observation.down is None else self._filter(observation.down)
        return self._policy.act(replace(observation, image=self._filter(observation.image), down=down))

    def close(self) -> None:
        """As the policy."""
        self._policy.close()


class FilteredReasoner(Reasoner):
    """A reasoner behind a filter."""

    def __init__(self, reasoner: str, light: float = 1.0, roll_deg: float = 0.0, shift_px: float = 0.0) -> None:
        made = make_reasoner(reasoner)
        assert made is not None  # noqa: S101  ("none" is not filtered)
        self._filter, self._reasoner = Filter(light, roll_deg, shift_px), made
        self.needs_ground_truth, self.needs_seed = made.needs_ground_truth, made.needs_seed

    def reset(self, context: EpisodeContext) -> None:
        """As the reasoner."""
        self._reasoner.reset(context)

    def check(self) -> None:
        """As the reasoner."""
        self._reasoner.check()

    def refine(self, image: Image, instruction: str) -> Guidance:
        """As the reasoner, of the filtered picture."""
        return self._reasoner.refine(self._filter(image), instruction)

    def plan(self, mission: str) -> tuple[SubGoal, ...] | None:
        """As the reasoner."""
        return self._reasoner.plan(mission)

    def close(self) -> None:
        """As the reasoner."""
        self._reasoner.close()
