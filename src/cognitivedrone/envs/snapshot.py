"""Picture of one task: its instruction, the drone's view at the start, a top view and a chase view."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw

from cognitivedrone.envs.captions import font, readable, wrap
from cognitivedrone.envs.track_runner import TrackRunner, scenery_of
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import RunError
from cognitivedrone.files import replace_file, writing
from cognitivedrone.plan import Scenario
from cognitivedrone.sim.drawing.chase import ChaseView
from cognitivedrone.sim.drawing.views import View, first_person_view, top_view
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite, track_at
from cognitivedrone.types import IMAGE_SIZE, FloatArray, Image, Task
from cognitivedrone.world import geometry

SIDE: Final = 2 * IMAGE_SIZE
"""Side of the two square views, pixels."""
_GAP: Final = 24
_WIDTH: Final = 2 * SIDE + 3 * _GAP
_CHASE_SIZE: Final = (2 * SIDE + _GAP, 480)
_PAPER, _INK, _SOFT, _RIGHT = (255, 255, 255), (20, 23, 31), (91, 98, 115), (18, 134, 95)
_BADGE: Final = 20
"""Radius of a gate's number, pixels."""


def snapshot(suite: Suite, episode: int, out: Path, scenario: Scenario) -> Task:
    """Write the picture of a task in the conditions of `scenario` to `out`; returns the task."""
    track = track_at(suite, episode)
    if not out.parent.is_dir():
        raise RunError(f"cannot write {out}: there is no folder {out.parent}")
    form = PillowImage.registered_extensions().get(out.suffix.lower())
    if form not in PillowImage.SAVE:
        raise RunError(f"cannot write {out}: {out.suffix or 'no suffix'} is not an image format; end the name in .png")
    with Worlds.of(scenario) as worlds:
        (track_runner,) = worlds.runners
        worlds.begin(0, suite, episode, scenario.seed)
        where = f"{suite.name}, episode {episode}"
        if len(track) > 1:
            where += f", stage 1 of {len(track)}"
        picture = draw(worlds.simulator, track_runner, where)
    coded = BytesIO()
    PillowImage.fromarray(picture).save(coded, format=form)
    with writing(out, RunError):
        replace_file(out, coded.getvalue())
    return track_runner.task


def draw(simulator: Simulator, track_runner: TrackRunner, where: str) -> Image:
    """The current task in three views with labelled gates: (h, 1096, 3). `where` identifies the task."""
    if simulator.cameras is None:
        raise ValueError("this simulator was made without cameras")
    state, stage = track_runner.world.state(), track_runner.stage
    seen = track_runner.world.frame().repeat(2, axis=0).repeat(2, axis=1)
    top = simulator.cameras.top(0, state, (SIDE, SIDE))
    scenery = scenery_of(stage, track_runner.labels, track_runner.appearance)
    with ChaseView(stage, scenery, *_CHASE_SIZE, airframe=simulator.airframe) as behind:
        chase = behind.frame(state.position, state.quaternion)
    heading = _heading(track_runner.task, where)
    titles = 34
    rows = (heading.height, heading.height + titles + SIDE + _GAP)
    page = PillowImage.new("RGB", (_WIDTH, rows[1] + titles + _CHASE_SIZE[1] + _GAP), _PAPER)
    page.paste(heading)
    pen = ImageDraw.Draw(page)
    for title, picture, view, left, row in (
        (f"What the drone sees ({IMAGE_SIZE} x {IMAGE_SIZE})", seen, first_person_view(state), _GAP, rows[0]),
        ("From above", top, top_view(stage), 2 * _GAP + SIDE, rows[0]),
        ("From behind", chase, behind.view, _GAP, rows[1]),
    ):
        pen.text((left, row), title, _SOFT, font(24))
        marked = PillowImage.fromarray(picture)
        _mark_gates(marked, view, track_runner)
        page.paste(marked, (left, row + titles))
        box = (left - 1, row + titles - 1, left + marked.width, row + titles + marked.height)
        pen.rectangle(box, outline=(200, 204, 214))
    return np.asarray(page)


def _heading(task: Task, where: str) -> PillowImage.Image:
    """The instruction, the task's identification, and a line for each gate."""
    page = PillowImage.new("RGB", (_WIDTH, 1200), _PAPER)
    pen = ImageDraw.Draw(page)
    top = _GAP
    for line in wrap(task.instruction, _WIDTH - 2 * _GAP, font(42), 6):
        pen.text((_GAP, top), line, _INK, font(42))
        top += 52
    about = f"{where}: {task.family.replace('_', ' ')}, {task.category.replace('_', ' ')}"
    if task.board is not None:
        about += f"; the board shows {readable(task.board.partition('@')[0])}"
    for line in wrap(about, _WIDTH - 2 * _GAP, font(24), 2):
        pen.text((_GAP, top + 2), line, _SOFT, font(24))
        top += 32
    if task.target is None:
        pen.text((_GAP, top + 8), "No gate matches the instruction", _RIGHT, font(26))
        top += 40
    top += 14
    for index in geometry.choices(task):
        right = index == task.target
        _badge(pen, _GAP + _BADGE, top + _BADGE, index + 1, right=right)
        gate = task.gates[index]
        text = f"{gate.color} pad" if task.landing else f"{gate.size} {gate.color} {gate.shape} gate"
        if task.only is None and not task.landing:
            text += f": {readable(task.options[index], 200)}"
        lines = wrap(text + ("  (right)" if right else ""), _WIDTH - 3 * _GAP - 2 * _BADGE, font(26), 2)
        for number, line in enumerate(lines):
            pen.text((2 * _GAP + 2 * _BADGE, top + 4 + 32 * number), line, _RIGHT if right else _INK, font(26))
        top += 18 + 32 * len(lines)
    return page.crop((0, 0, _WIDTH, top + 14))


def _mark_gates(picture: PillowImage.Image, view: View, track_runner: TrackRunner) -> None:
    """Draw the gates' numbers under them, for gates within the picture.

    They never cover the drone: seen from behind, it is in front of floor that is nearer than any gate.
    """
    pen = ImageDraw.Draw(picture)
    for index in geometry.standing(track_runner.stage):
        x, y = view.project(_under(track_runner, index), picture.size)[0]
        if not (0 <= x <= picture.width and 0 <= y <= picture.height):
            continue
        x = min(max(x, _BADGE + 3), picture.width - _BADGE - 3)
        y = min(y + _BADGE, picture.height - _BADGE - 3)
        _badge(pen, x, y, index + 1, right=index == track_runner.task.target)


def _under(track_runner: TrackRunner, index: int) -> FloatArray:
    """(1, 3) world: the lowest point of a gate's frame, in its middle, m."""
    outline = geometry.opening_outline(track_runner.stage.gates[index], grow=geometry.BAR_WIDTH)
    centers = geometry.gate_centers(track_runner.stage, track_runner.world.time())
    lowest: FloatArray = centers[[index]] + [0.0, 0.0, outline[:, 1].min()]
    return lowest


def _badge(pen: ImageDraw.ImageDraw, x: float, y: float, number: int, *, right: bool) -> None:
    """A gate's number in a circle, green for the right gate."""
    edges = (x - _BADGE, y - _BADGE, x + _BADGE, y + _BADGE)
    pen.ellipse(edges, fill=_RIGHT if right else _PAPER, outline=_RIGHT if right else _INK, width=3)
    pen.text((x, y), str(number), _PAPER if right else _INK, font(28), anchor="mm")
