"""What is changed in an audit, how much, and what a sound pilot then does.

Pilots that see the same flight through another camera: darker, turned about its axis, or shifted.

    cognitivedrone.audit.catalogue:FilteredPolicy:small,light=0.5

A turn about the optical axis and a small shift are what a crooked mounting does to the picture; what the camera would
see beyond the picture's edge is the edge repeated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from PIL import Image as PillowImage

from cognitivedrone.audit import scenes
from cognitivedrone.audit.scenes import Change, TrackChange
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


Expected = Literal["as before", "follows", "same choice", "chance"]
"""`as before`: the rate falls by at most `FALL`. `follows`: the gate that is now right, in at least `FOLLOWED` of the
flights. `same choice`: the gate that was chosen before, right or wrong, in at least as many. `chance`: of the flights
that chose a gate, a third at the right one, to within `CHANCE_BAND`."""

FALL, FOLLOWED, CHANCE_BAND = 0.10, 0.95, 0.07


@dataclass(frozen=True, slots=True)
class Variant:
    """A change of one strength."""

    name: str
    change: Change | None = None
    """Of single tasks."""
    mission: TrackChange | None = None
    """Of missions. A variant without either flies both as they are."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Of the run, such as wind."""
    camera: Mapping[str, float] = field(default_factory=dict)
    """Of the picture: the fields of `filters.Filter`."""
    seed_name: str = ""
    """Seeds the draws of `change` in place of the names of audit and variant: a renamed variant draws as before."""


@dataclass(frozen=True, slots=True)
class Audit:
    """A change in up to three strengths."""

    name: str
    question: str
    expected: Expected
    variants: tuple[Variant, ...]


def _latency(policy_ms: int, reasoner_ms: int) -> Variant:
    return Variant(
        f"{policy_ms} and {reasoner_ms} ms", options={"latency": f"policy={policy_ms}ms,reasoner={reasoner_ms}ms"}
    )


AUDITS: tuple[Audit, ...] = (
    Audit(
        "no question",
        "Without a meaningful sentence, does it still find the right gate? Then something else gives the answer away.",
        "chance",
        (
            Variant("blank", scenes.blank),
            Variant("random words", scenes.random_words),
            Variant("random letters", scenes.random_letters),
        ),
    ),
    Audit(
        "other question",
        "Asked for another gate of the same scene, does it fly there?",
        "follows",
        (
            Variant("the same gate, plainly", scenes.ask_plainly),
            Variant("the next gate", scenes.ask_for_another(1)),
            Variant("the gate after that", scenes.ask_for_another(2)),
        ),
    ),
    Audit(
        "panels swapped",
        "When the panels change places, does it follow the right one?",
        "follows",
        (
            Variant("by one gate", scenes.turned_panels(1)),
            Variant("by two gates", scenes.turned_panels(2)),
            Variant("outer two", scenes.mirrored_panels),
        ),
    ),
    Audit(
        "order swapped",
        "When the sub-goals of a mission change places, does it follow the new order?",
        "follows",
        (
            Variant("in order", mission=scenes.in_order(swapped=False), seed_name="order"),
            Variant("the other way round", mission=scenes.in_order(swapped=True), seed_name="order"),
        ),
    ),
    Audit(
        "appearance swapped",
        "The gates exchange their appearance, which no sentence mentions. Does that matter?",
        "as before",
        (
            Variant("colours", scenes.turned_looks("color")),
            Variant("shapes", scenes.turned_looks("shape")),
            Variant("all looks", scenes.turned_looks("color", "shape", "size")),
        ),
    ),
    Audit("mirrored stage", "Left and right exchanged.", "as before", (Variant("mirrored", scenes.mirrored_stage),)),
    Audit(
        "paraphrases",
        "The same question in another form.",
        "as before",
        (
            Variant("polite", scenes.polite),
            Variant("no punctuation", scenes.unpunctuated),
            Variant("typing error", scenes.misspelt, seed_name="paraphrases/a slip of the finger"),
        ),
    ),
    Audit(
        "gates moved",
        "Gates aside, turned, higher or lower.",
        "as before",
        tuple(Variant(f"up to {share * 1.5:.1f} m", scenes.moved_gates(share)) for share in (1 / 3, 2 / 3, 1.0)),
    ),
    Audit(
        "another place",
        "In three photographed places, does it choose the gate that it chose in the plain room?",
        "same choice",
        tuple(Variant(place, options={"place": place}) for place in ("forest", "warehouse", "city")),
    ),
    Audit(
        "place alone",
        "In a photographed place without a meaningful sentence, does it find the right gate? Then the place tells.",
        "chance",
        (Variant("blank", scenes.blank, options={"place": "kept"}),),
    ),
    Audit(
        "light",
        "Less light.",
        "as before",
        tuple(Variant(f"{light:.0%}", camera={"light": light}) for light in (0.6, 0.4, 0.25)),
    ),
    Audit(
        "wind",
        "Steady wind, from a direction that every flight draws.",
        "as before",
        tuple(Variant(f"{speed:g} m/s", options={"wind": speed}) for speed in (1.0, 2.0, 4.0)),
    ),
    Audit(
        "camera shift",
        "The picture shifted to the right and down, as by a crooked mounting.",
        "as before",
        tuple(Variant(f"{shift:g} px", camera={"shift_px": shift}) for shift in (4.0, 8.0, 16.0)),
    ),
    Audit(
        "camera roll",
        "The camera turned about its axis.",
        "as before",
        tuple(Variant(f"{angle:g} degrees", camera={"roll_deg": angle}) for angle in (3.0, 6.0, 12.0)),
    ),
    Audit(
        "latency",
        "Slower policy and reasoner, charged to the simulated clock.",
        "as before",
        (_latency(50, 500), _latency(100, 1000), _latency(200, 2000)),
    ),
)
