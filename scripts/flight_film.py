"""Film a flight of policy and reasoner for the README: docs/images/flight.webp.

Run: python scripts/flight_film.py [--suite open-v1:track] [--episode 0] [--policy small] [--reasoner small]

The frames are those of the report's clips: instruction and directive over the drone's view. The same version of package
and renderer gives the same film.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from PIL import Image, ImageDraw, ImageOps

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.episode import PilotRunner
from cognitivedrone.benchmark.film import WIDTH, compose
from cognitivedrone.benchmark.job import prepare
from cognitivedrone.envs.captions import font

OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "flight.webp"
BORDER = (200, 204, 214)
ASKED_PX = 40
"""Height of the line with the instruction."""


@dataclass(frozen=True)
class Config:
    """What is filmed."""

    suite: str = "open-v1:track"
    episode: int = 0
    policy: str = "small"
    reasoner: str = "small"
    stages: int = 3
    """Stages of a track that are shown."""
    width: int = 384
    every: int = 2
    """Control steps from frame to frame."""
    out: Path = OUT


def main(config: Config) -> None:
    """Fly, film, write."""
    job = prepare(Plan.of(suite=config.suite, policy=config.policy, reasoner=config.reasoner))
    runner = PilotRunner(job)
    flown = runner.fly(config.episode, film=True)
    runner.close()
    track = job.suite.tracks[config.episode]
    shown = [frame for frame in flown.film or () if frame.stage < config.stages][:: config.every]
    pictures = [under(track[frame.stage].instruction, compose(frame, len(track))) for frame in shown]
    height = round(pictures[0].height * config.width / pictures[0].width)
    small = [picture.resize((config.width, height), Image.Resampling.LANCZOS) for picture in pictures]
    # The floor is white, as pages are.
    first, *others = [ImageOps.expand(picture, border=1, fill=BORDER) for picture in small]
    first.save(
        config.out,
        save_all=True,
        append_images=others,
        duration=round(100 * config.every),
        loop=0,
        quality=55,
        method=6,
        minimize_size=True,
    )
    print(f"{config.out}: {len(pictures)} frames, {config.out.stat().st_size / 1e6:.2f} MB")
    for task, stage in zip(track, flown.result.stages, strict=True):
        print(f"{task.instruction}: {stage.outcome}")


def under(instruction: str, frame: np.ndarray) -> Image.Image:
    """A frame of the film with what was asked for above it."""
    picture = Image.new("RGB", (WIDTH, frame.shape[0] + ASKED_PX), "white")
    picture.paste(Image.fromarray(frame), (0, ASKED_PX))
    ImageDraw.Draw(picture).text((14, ASKED_PX / 2), instruction, (18, 21, 32), font(17), anchor="lm")
    return picture


if __name__ == "__main__":
    main(tyro.cli(Config))
