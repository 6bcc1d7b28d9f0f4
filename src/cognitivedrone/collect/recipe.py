"""How a data set is flown: every rate of it in one frozen recipe, and the recipes by name."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from cognitivedrone.choices import LookName
from cognitivedrone.data.episode import Encoding
from cognitivedrone.errors import DataError, did_you_mean


@dataclass(frozen=True, slots=True)
class Recipe:
    """The conditions that flights are drawn from. With suite, index and seed it fixes an episode to the bit."""

    name: str
    episodes: int
    """How many of them."""
    speed_m_s: tuple[float, float] = (1.0, 2.5)
    """The expert's speed, drawn evenly from this range for each flight."""
    look: LookName = "plain"
    """`plain` as published, or `varied`: floor, walls, light, colours and camera noise."""
    off_track_share: float = 0.0
    """Share of flights that begin on the way, off the straight line to the gate, instead of in the published box."""
    wind_m_s: float = 0.0
    """Steady wind of up to this speed, evenly, from any side."""
    kicks_per_s: float = 0.0
    """Short hard pushes: how often on average."""
    kick_m_s: float = 3.0
    """Velocity commanded during a kick."""
    kick_steps: tuple[int, int] = (2, 4)
    """Shortest and longest kick, control steps."""
    wrongs_per_s: float = 0.0
    """Stretches of a wrong command, as a confused learner would give it: how often on average."""
    wrong_m_s: float = 1.2
    """Largest velocity of a wrong command."""
    wrong_yaw_rate: float = 0.8
    """Largest yaw rate of a wrong command, rad/s."""
    wrong_steps: tuple[int, int] = (4, 10)
    """Shortest and longest wrong stretch, control steps."""
    encoding: Encoding = "png"
    quality: int = 95
    """Of JPEG."""
    time_limit_s: float = 30.0

    def facts(self) -> dict[str, Any]:
        """The recipe as plain JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


# PNG is lossless and, of the plain look, smaller than JPEG of quality 95 (5.9 against 9.8 KB a frame); of the varied
# look, whose cameras are noisy, it is several times larger.
RECIPES: dict[str, Recipe] = {
    "paper": Recipe("paper", episodes=8062),
    "robust": Recipe(
        "robust",
        episodes=8062,
        look="varied",
        off_track_share=0.3,
        wind_m_s=2.0,
        kicks_per_s=0.15,
        wrongs_per_s=0.15,
        encoding="jpeg",
    ),
    "debug": Recipe("debug", episodes=20, kicks_per_s=0.2, encoding="jpeg", quality=75),
}
"""`paper`: clean flights from the published starts, as many as the published set has. `robust`: pushed, misled, blown
and shown in many looks. `debug`: a few, small."""


def find_recipe(name: str) -> Recipe:
    """The recipe of that name; raises `DataError` with near names."""
    if name not in RECIPES:
        raise DataError(f"unknown recipe {name!r}; {did_you_mean(name, RECIPES)}")
    return RECIPES[name]
