"""The README's moving picture, docs/images/flight.webp: the film of a recorded or a new flight of the packaged pilot.

Run: python scripts/flight_film.py [--suite open-v1:track] [--episode 0] [--policy small] [--reasoner small]
         [--place lobby]

The pictures are those of `cognitivedrone film`. The same version of package and renderer gives the same picture.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import tyro
from PIL import Image

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.film.frame import Film, scenes_of, verdict_of
from cognitivedrone.film.movie import FPS, pictures

OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "flight.webp"


@dataclass(frozen=True)
class Config:
    """What is filmed."""

    suite: str = "open-v1:track"
    episode: int = 0
    policy: str = "small"
    reasoner: str = "small"
    place: str = "lobby"
    stages: int = 3
    """Stages of a track that are shown."""
    width: int = 800
    every: int = 4
    """Pictures of the film from one to the next, 20 a second."""
    quality: int = 42
    out: Path = OUT


def main(config: Config) -> None:
    """Fly, film, write."""
    job = resolve(Plan.of(suite=config.suite, policy=config.policy, reasoner=config.reasoner, place=config.place))
    runner = PilotRunner(job)
    flown, scenes = runner.fly(config.episode, film=True), scenes_of(runner.track_runner)
    runner.close()
    shown = [frame for frame in flown.film or () if frame.stage < config.stages]
    results = flown.result.stages[: config.stages]
    film = Film(f"{config.policy} + {config.reasoner}", shown, scenes[: config.stages], verdict_of(results))
    height = round(config.width * 9 / 16)
    small = [
        Image.fromarray(picture).resize((config.width, height), Image.Resampling.LANCZOS)
        for picture in itertools.islice(pictures(film), 0, None, config.every)
    ]
    first, *others = small
    first.save(
        config.out,
        save_all=True,
        append_images=others,
        duration=round(1000 * config.every / FPS),
        loop=0,
        quality=config.quality,
        method=6,
        minimize_size=True,
    )
    print(f"{config.out}: {len(small)} frames, {config.out.stat().st_size / 1e6:.2f} MB")
    for result in results:
        print(f"{result.task_id}: {result.outcome}")


if __name__ == "__main__":
    main(tyro.cli(Config))
