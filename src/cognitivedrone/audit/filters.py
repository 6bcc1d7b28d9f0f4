"""Pilots that see the same flight through another camera: darker, turned about its axis, or shifted.

    cognitivedrone.audit.filters:FilteredPolicy:small,light=0.5

A turn about the optical axis and a small shift are what a crooked mounting does to the picture; what the camera would
see beyond the picture's edge is the edge repeated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from PIL import Image as PillowImage

from cognitivedrone.interfaces import PlugIn, Policy, Reasoner
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.types import ActionChunk, Guidance, Image, Observation

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


class _Filtered(PlugIn):
    """A pilot's part behind a filter; all but what it sees is its own."""

    def __init__(self, part: PlugIn, camera: Filter) -> None:
        self.camera = camera
        self.needs_ground_truth, self.needs_seed = part.needs_ground_truth, part.needs_seed
        self.needs_down_camera = part.needs_down_camera
        self.reset, self.check, self.close = part.reset, part.check, part.close  # type: ignore[method-assign]


class FilteredPolicy(_Filtered, Policy):
    """A policy behind a filter."""

    def __init__(self, policy: str, light: float = 1.0, roll_deg: float = 0.0, shift_px: float = 0.0) -> None:
        self._policy = make_policy(policy)
        super().__init__(self._policy, Filter(light, roll_deg, shift_px))

    @property
    def declines(self) -> bool:  # type: ignore[override]
        """As the policy."""
        return self._policy.declines

    @property
    def present(self) -> float | None:  # type: ignore[override]
        """As the policy."""
        return self._policy.present

    def act(self, observation: Observation) -> ActionChunk:
        """As the policy, of the filtered picture."""
        down = None if observation.down is None else self.camera(observation.down)
        return self._policy.act(replace(observation, image=self.camera(observation.image), down=down))


class FilteredReasoner(_Filtered, Reasoner):
    """A reasoner behind a filter."""

    def __init__(self, reasoner: str, light: float = 1.0, roll_deg: float = 0.0, shift_px: float = 0.0) -> None:
        made = make_reasoner(reasoner)
        assert made is not None  # noqa: S101  ("none" is not filtered)
        super().__init__(made, Filter(light, roll_deg, shift_px))
        self._refine, self.plan = made.refine, made.plan  # type: ignore[method-assign]

    def refine(self, image: Image, instruction: str) -> Guidance:
        """As the reasoner, of the filtered picture."""
        return self._refine(self.camera(image), instruction)
