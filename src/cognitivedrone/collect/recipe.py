"""Recipes of data sets: all flight conditions in one frozen dataclass, and the recipes by name.

Deliberate perturbations, drawn from the episode's own generator. Pure functions.

A perturbed flight records the expert's clean action as the label, and beside it the command that was sent.
Perturbations act only through the command or the start, so a record suffices to repeat the flight bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cognitivedrone.choices import AppearanceName
from cognitivedrone.data.episode import Encoding
from cognitivedrone.envs.track_runner import draw_start
from cognitivedrone.errors import DataError, did_you_mean
from cognitivedrone.sim.simulator import Start
from cognitivedrone.types import CONTROL_HZ, Action
from cognitivedrone.world import geometry


@dataclass(frozen=True, slots=True)
class Recipe:
    """The distribution of flight conditions. With suite, index and seed it determines an episode to the bit."""

    name: str
    episodes: int
    """Number of episodes."""
    speed_m_s: tuple[float, float] = (1.0, 2.5)
    """The expert's speed, drawn uniformly from this range for each flight."""
    look: AppearanceName = "plain"
    """`plain` as published, or `varied`: floor, walls, light, colours and camera noise."""
    places: float = 0.0
    """Share of flights in a photographed place instead; only in those that models are trained in."""
    off_track_share: float = 0.0
    """Share of flights that begin off the straight line to the gate instead of in the published box."""
    wind_m_s: float = 0.0
    """Maximum speed of a steady wind; speed and direction are drawn uniformly."""
    kicks_per_s: float = 0.0
    """Average frequency of short hard pushes."""
    kick_m_s: float = 3.0
    """Commanded velocity during a kick."""
    kick_steps: tuple[int, int] = (2, 4)
    """Shortest and longest kick, control steps."""
    wrongs_per_s: float = 0.0
    """Stretches of a wrong command, as a confused learner would give it: how often on average."""
    wrong_m_s: float = 1.2
    """Maximum velocity of a wrong command."""
    wrong_yaw_rate: float = 0.8
    """Maximum yaw rate of a wrong command, rad/s."""
    wrong_steps: tuple[int, int] = (4, 10)
    """Shortest and longest wrong command, control steps."""
    encoding: Encoding = "png"
    quality: int = 95
    """JPEG quality."""
    time_limit_s: float = 30.0
    down_camera: bool = False
    """Whether every step has the frame of the camera that looks down, too."""

    def facts(self) -> dict[str, Any]:
        """The recipe as plain JSON values; without `places` and `down_camera` where not set, as in sets of before."""
        facts = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
        return {name: value for name, value in facts.items() if value or name not in ("places", "down_camera")}


# PNG is lossless. For plain frames it is smaller than JPEG of quality 95 (5.9 against 9.8 KB a frame); for varied
# frames, whose cameras are noisy, it is several times larger.
RECIPES: dict[str, Recipe] = {
    "paper": Recipe("paper", episodes=8062),
    "robust": Recipe(
        "robust",
        episodes=8062,
        look="varied",
        places=0.5,
        off_track_share=0.3,
        wind_m_s=2.0,
        kicks_per_s=0.15,
        wrongs_per_s=0.15,
        encoding="jpeg",
    ),
    "debug": Recipe("debug", episodes=20, kicks_per_s=0.2, encoding="jpeg", quality=75),
}
"""`paper`: clean flights from the published starts, as many as in the published set. `robust`: perturbed by kicks,
wrong commands and wind, with varied appearance, half of them in photographed places. `debug`: a few small episodes."""


def find_recipe(name: str) -> Recipe:
    """The recipe of that name; raises `DataError` with similar names."""
    if name not in RECIPES:
        raise DataError(f"unknown recipe {name!r}; {did_you_mean(name, RECIPES)}")
    return RECIPES[name]


OFF_TRACK_X_M = (-2.0, 2.0)
"""Off-track starts: range in the stage's direction, m. Every gate's plane is at least 2.4 m further."""
OFF_TRACK_Y_M = 2.5
"""Off-track starts: maximum lateral offset, m."""
OFF_TRACK_Z_M = (0.4, 2.2)
OFF_TRACK_YAW = 0.6
"""Maximum yaw offset to either side, rad."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A command that is sent instead of the policy's."""

    first: int
    """First control step."""
    last: int
    """Last control step."""
    action: tuple[float, float, float, float]
    """Heading frame, m/s and rad/s."""


def draw_beginning(rng: np.random.Generator, recipe: Recipe, hull_radius: float) -> Start:
    """Initial conditions of a flight: as published, or off track for the recipe's share of flights; and the wind."""
    published = draw_start(rng, hull_radius, recipe.wind_m_s * float(rng.random()))
    if rng.random() >= recipe.off_track_share:
        return published
    x, y, z = (rng.uniform(*OFF_TRACK_X_M), rng.uniform(-OFF_TRACK_Y_M, OFF_TRACK_Y_M), rng.uniform(*OFF_TRACK_Z_M))
    lowest = max(geometry.START_MIN_HEIGHT, 2 * hull_radius)
    yaw = float(rng.uniform(-OFF_TRACK_YAW, OFF_TRACK_YAW))
    return Start((float(x), float(y), max(float(z), lowest)), yaw, published.wind)


def draw_disturbances(rng: np.random.Generator, recipe: Recipe) -> tuple[Disturbance, ...]:
    """The kicks and the wrong commands of one flight, up to its time limit, in order of their start."""
    drawn = [
        *_draw(rng, recipe, recipe.kicks_per_s, recipe.kick_steps, _kick),
        *_draw(rng, recipe, recipe.wrongs_per_s, recipe.wrong_steps, _wrong),
    ]
    return tuple(sorted(drawn, key=lambda disturbance: (disturbance.first, disturbance.last)))


def disturb(action: Action, step: int, disturbances: tuple[Disturbance, ...]) -> Action:
    """The command sent instead of `action` (4,) at a control step: the active disturbance, or the action itself."""
    for disturbance in disturbances:
        if disturbance.first <= step <= disturbance.last:
            return np.array(disturbance.action, dtype=np.float32)
    return action


_Command = tuple[float, float, float, float]


def _draw(
    rng: np.random.Generator,
    recipe: Recipe,
    per_s: float,
    lengths: tuple[int, int],
    command: Callable[[np.random.Generator, Recipe], _Command],
) -> list[Disturbance]:
    """One kind of disturbance, at random times that average to `per_s`."""
    drawn: list[Disturbance] = []
    if per_s <= 0:
        return drawn
    time = float(rng.exponential(1 / per_s))
    while time < recipe.time_limit_s:
        first = int(time * CONTROL_HZ)
        last = first + int(rng.integers(lengths[0], lengths[1] + 1)) - 1
        drawn.append(Disturbance(first, last, command(rng, recipe)))
        time = (last + 1) / CONTROL_HZ + float(rng.exponential(1 / per_s))
    return drawn


def _kick(rng: np.random.Generator, recipe: Recipe) -> _Command:
    """A hard push in a random horizontal direction, slightly up or down."""
    direction = rng.uniform(-np.pi, np.pi)
    x, y = recipe.kick_m_s * np.cos(direction), recipe.kick_m_s * np.sin(direction)
    return (float(x), float(y), float(rng.uniform(-0.5, 0.5)), 0.0)


def _wrong(rng: np.random.Generator, recipe: Recipe) -> _Command:
    """A random slow velocity and yaw rate."""
    x, y, z = rng.uniform(-1, 1, 3) * (recipe.wrong_m_s, recipe.wrong_m_s, recipe.wrong_m_s / 3)
    return (float(x), float(y), float(z), float(rng.uniform(-recipe.wrong_yaw_rate, recipe.wrong_yaw_rate)))
