"""What a film shows: one value for every control step, the scenes, and how it ended."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from cognitivedrone.envs.captions import readable
from cognitivedrone.envs.track_runner import TrackRunner, scenery_of
from cognitivedrone.reasoners.scene_text import UNREADABLE
from cognitivedrone.sim.simulator import Scenery
from cognitivedrone.types import (
    Action,
    Event,
    Guidance,
    Image,
    Outcome,
    Quaternion,
    SeenPanel,
    Stage,
    StageResult,
    Vector,
)

OUTCOME_TEXTS: dict[Outcome, str] = {
    "passed": "Passed", "wrong_gate": "Wrong gate", "collision": "Collision", "missed": "Missed the gate",
    "out_of_bounds": "Out of bounds", "timeout": "Out of time", "invalid": "Invalid flight",
    "policy_error": "The policy failed", "not_reached": "Not reached", "hesitated": "Hesitated",
    "false_alarm": "Declined, but one gate fits",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class FilmFrame:
    """One control step of a filmed flight."""

    image: Image
    """First-person."""
    instruction: str
    """The policy's input: the instruction, or the directive of `guidance`."""
    guidance: Guidance | None
    """The reasoner's answer in effect, if any."""
    action: Action
    """As flown."""
    time: float
    """Since the start of the flight, s."""
    stage: int
    """Index in the track."""
    asked: str = ""
    """The user's instruction."""
    position: Vector | None = None
    """(3,) world, m; none if unknown."""
    quaternion: Quaternion | None = None
    """(4,) w, x, y, z, body to world; none if unknown."""
    seen: tuple[SeenPanel, ...] = ()
    """What the reasoner has read of the panels; empty if it does not say."""


def reading_of(panel: SeenPanel) -> tuple[str, tuple[tuple[str, float], ...]]:
    """What a panel is read as, and the likeliest things with their probabilities; none of these for sums and people,
    which are of several readings. Things without a name are left out.
    """
    things = tuple((name, share) for name, share in panel.readings if name)
    unread = panel.shown == UNREADABLE
    if things and (unread or things[0][1] > 0.5 or things[0][0].casefold() in panel.shown.casefold()):
        return things[0][0], things
    return "nothing known" if unread else panel.shown, ()


@dataclass(frozen=True, slots=True)
class Scene:
    """A stage with its pictures, and what its panels show in words."""

    stage: Stage
    scenery: Scenery
    names: tuple[str, ...] = ()
    """Of the three panels, readable; may be empty."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The end card."""

    kind: Literal["good", "bad", "open"]
    """`open`: nobody but the user can judge it."""
    headline: str
    lines: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Film:
    """A flight to be shown."""

    title: str
    """Who flew what, in a line."""
    frames: Iterable[FilmFrame]
    scenes: Sequence[Scene]
    """By `FilmFrame.stage`; empty if the world is unknown."""
    verdict: Verdict
    events: Sequence[Event] = ()
    """For the page."""


def verdict_of(results: Sequence[StageResult]) -> Verdict:
    """The end card of a judged flight."""
    passed = sum(result.outcome == "passed" for result in results)
    last = next((result for result in results if result.outcome != "passed"), results[-1])
    headline = OUTCOME_TEXTS[last.outcome]
    if last.outcome == "passed" and last.chosen is not None and len(results) == 1:
        headline = f"Passed: through gate {last.chosen + 1}"
    elif last.outcome == "passed" and last.target is None and len(results) == 1:
        headline = "Passed: declined, no gate fits"
    elif last.outcome == "wrong_gate" and last.chosen is not None:
        right = "none" if last.target is None else f"gate {last.target + 1}"
        headline = f"Wrong gate: {last.chosen + 1}, right was {right}"
    lines = [
        f"{sum(result.time_s for result in results):.1f} s, {sum(result.path_m for result in results):.1f} m flown"
    ]
    if len(results) > 1:
        lines.insert(0, f"{passed} of {len(results)} stages passed")
    return Verdict("good" if passed == len(results) else "bad", headline, tuple(lines))


def scenes_of(track: TrackRunner) -> tuple[Scene, ...]:
    """The stages that were flown, with their pictures."""
    return tuple(
        Scene(stage, scenery_of(stage, track.labels, track.appearance), tuple(map(readable, task.options)))
        for stage, task in zip(track.stages, track.track, strict=False)
    )
