"""Draw a picture of every task family for docs/suites.md with `cognitivedrone view`, in half its size.

Run: python scripts/gallery.py [FAMILY ...]

Without arguments every family is drawn, and the README's row of what the drone sees. The pictures are the same for the
same version of the package and renderer.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from cognitivedrone.cli import main as cognitivedrone
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.plan import Scenario
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.format import write_tasks
from cognitivedrone.world.places import names

FROM_BEHIND_PX = 34 + 480 + 24
"""Height of the third view, with its title and margin: it shows little that the first does not."""
FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images" / "gallery"
TASKS = {
    "attributes": ("open-v1:test", 13),
    "people": ("open-v1:test", 0),
    "letters": ("open-v1:test", 14),
    "digits": ("open-v1:test", 20),
    "logos": ("open-v1:test", 82),
    "animals": ("open-v1:test", 12),
    "math": ("open-v1:test", 1),
    "math_board": ("open-v1:test", 11),
    "food": ("open-v1:test", 52),
    "association": ("open-v1:test", 41),
    "conjunction": ("open-v1:hard", 18),
    "exclusion": ("open-v1:hard", 3),
    "relations": ("open-v1:hard", 14),
    "negation": ("open-v1:hard", 2),
    "counting": ("open-v1:hard", 1),
    "distraction": ("open-v1:hard", 38),
    "comparison": ("open-v1:hard", 0),
    "two_step": ("open-v1:hard", 8),
    "memory": ("open-v1:hard", 130),
    "race": ("open-v1:race", 0),
    "absent": ("open-v2:absent", 2),
    "landing": ("open-v3:missions", 1),
}
"""Suite and episode of the task that stands for a family."""
PLACES = dict(zip(TASKS, itertools.cycle(names("training")), strict=False))
"""Where each is photographed."""
ROW = (("open-v1:test", 12, "lobby"), ("open-v1:test", 11, "park"), ("open-v1:test", 13, "workshop"))
ROW_PLAIN = ("open-v1:test", 1)
"""The README's row: three tasks in places and one as the benchmark shows it."""


def draw(family: str) -> Path:
    """Write the picture of a family, 548 px wide: the drone's view then has its own 256 x 256 pixels."""
    suite, episode = TASKS[family]
    out = FOLDER / f"{family}.webp"
    with tempfile.TemporaryDirectory() as folder:
        drawn, shown = Path(folder) / "view.png", ["--suite", suite, "--episode", str(episode)]
        track = load_suite(suite).tracks[episode]
        if family == "landing":  # not the first of its track
            write_tasks(Path(folder) / "landing.json", track[-1:])
            shown = ["--tasks", f"{folder}/landing.json"]
        cognitivedrone(["view", *shown, "--place", PLACES[family], "--out", str(drawn)])
        with Image.open(drawn) as picture:
            short = picture.crop((0, 0, picture.width, picture.height - FROM_BEHIND_PX))
            short.reduce(2).save(out, quality=72, method=6)
    return out


def draw_row() -> Path:
    """Write the README's row of what the drone sees: 256 x 256 pixels each."""
    seen = []
    for suite, episode, *place in (*ROW, ROW_PLAIN):
        with Worlds.of(Scenario(suite=suite, place="".join(place))) as worlds:
            worlds.begin(0, load_suite(suite), episode, 0)
            seen += [worlds.runners[0].world.frame(), np.full((256, 8, 3), 255, np.uint8)]
    out = FOLDER.parent / "first_person.webp"
    Image.fromarray(np.hstack(seen[:-1])).save(out, quality=80, method=6)
    return out


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    if not sys.argv[1:]:
        print(draw_row())
    for family in sys.argv[1:] or TASKS:
        print(draw(family))


if __name__ == "__main__":
    main()
