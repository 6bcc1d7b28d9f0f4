"""Recipes of data sets: all flight conditions in one frozen dataclass, and the recipes by name."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from cognitivedrone.choices import AppearanceName
from cognitivedrone.data.episode import Encoding
from cognitivedrone.errors import DataError, did_you_mean


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
