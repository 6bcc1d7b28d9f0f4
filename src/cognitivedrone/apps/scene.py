"""Chooses the scene of a simulated flight: the given one, or one that shows what the user asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

from cognitivedrone.apps.config import AUTO, FlyPlan
from cognitivedrone.reasoners.calculator import calculate
from cognitivedrone.tasks import Suite, load_suite, track_at
from cognitivedrone.tasks.matching import Match, best_scene, made_scene
from cognitivedrone.tasks.scenario import suite_of
from cognitivedrone.tasks.suites import TRAIN_NAME, suite_of_tasks
from cognitivedrone.types import Task, Track

DEFAULT = "open-v1:smoke"
DEFAULT_EPISODE = 27
"""Flown where nothing is asked for; unlike the first one, the packaged pilot is sure of it."""
SEARCHED = "open-v1:test"
"""The suite that is searched first."""
TRAINED = 2000
"""Number of tasks of the training suite that are searched next."""


@dataclass(frozen=True, slots=True)
class ChosenScene:
    """An episode of a suite."""

    suite: Suite
    episode: int
    told: str
    """Description and reason of the choice, one line for the user."""

    @property
    def track(self) -> Track:
        """Its tasks; raises `TaskError` if there is no such episode."""
        return track_at(self.suite, self.episode)


def choose_scene(plan: FlyPlan) -> ChosenScene:
    """The scene of a simulated flight.

    With --episode, that episode. Otherwise, for an instruction of the user's own, a scene that shows what it asks for:
    from the given suite or task file; else from `SEARCHED`; else made for it, if it names a thing; else from the
    training suite. Otherwise the first episode of the given suite or task file, or else `DEFAULT_EPISODE`. Raises
    `TaskError`.
    """
    scenario, seed = plan.scenario, plan.scenario.seed
    named = scenario.suite != AUTO or scenario.tasks is not None
    asked = plan.instruction.strip()
    first = 0 if named or asked else DEFAULT_EPISODE
    episode = first if plan.episode is None else plan.episode
    suite = suite_of(scenario if named else scenario.changed(suite=DEFAULT), episode + 1)
    if plan.episode is not None or not asked:
        return _named(suite, episode)
    calculated = calculate(asked)
    wanted = asked if calculated is None else f"the number {calculated}"
    best = _best(wanted, suite if named else load_suite(SEARCHED), seed)
    if not named and (best is None or not best[2].complete):
        made = made_scene(wanted, seed)
        if made is not None:
            scene = _named(suite_of_tasks("a suite made for this flight", [replace(made, instruction=asked)]), 0)
            return replace(scene, told=f"{scene.told}; made because no task of {SEARCHED} shows all of it")
        best = _better(best, _best(wanted, load_suite(TRAIN_NAME, size=TRAINED, seed=seed), seed))
    if best is None:
        scene = _named(suite, 0)
        return replace(scene, told=f"no scene was found that shows what {asked!r} asks for; {scene.told}")
    suite, episode, match = best
    scene = _named(suite, episode)
    return replace(scene, told=f"{scene.told}; chosen because {_why(match, scene.track[0])}")


_Found: TypeAlias = tuple[Suite, int, Match]


def _best(wanted: str, suite: Suite, seed: int) -> _Found | None:
    """The episode of a suite whose first task fits best; none if none fits."""
    found = best_scene(wanted, [track[0] for track in suite.tracks], seed)
    return None if found is None else (suite, *found)


def _better(a: _Found | None, b: _Found | None) -> _Found | None:
    if a is None or b is None:
        return a or b
    return b if b[2].better_than(a[2]) else a


def _why(match: Match, task: Task) -> str:
    """The reason for a choice, as text."""
    fit = f"{' and '.join(map(repr, match.words))} {'fits' if len(match.words) == 1 else 'fit'} gate {match.gate + 1}"
    if match.shown:
        fit = f"{fit}, {_shown(task.options[match.gate], task.labels[match.gate])}"
    if match.missing:
        fit = f"{fit}, though {' and '.join(map(repr, match.missing))} {'do' if len(match.missing) > 1 else 'does'} not"
    return fit


def _named(suite: Suite, episode: int) -> ChosenScene:
    track = track_at(suite, episode)
    shown = "; then ".join(map(_panels, track))
    return ChosenScene(suite, episode, f"scene: episode {episode} of {suite.name}, with {shown}")


def _panels(task: Task) -> str:
    """What the panels of a task show, left to right."""
    if task.only is not None:
        return "one gate"
    names = [_shown(option, label) for option, label in zip(task.options, task.labels, strict=True)]
    if len(set(names)) == 1:
        return f"{names[0]} at every gate"
    return f"{', '.join(names[:-1])} and {names[-1]} from left to right"


def _shown(option: str, label: str) -> str:
    if label.startswith("person/") and "=" in option:
        return "a person"
    return option.removesuffix(".dae").replace("_", " ")
