"""A lesson that the page starts: `cognitivedrone train --recipe teach` in a process of its own, and how far it is.

A user's own pictures on the panels of a scene.
"""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from cognitivedrone.apps.understanding.scene import MADE, ChosenScene
from cognitivedrone.errors import LabelError, TrainingError
from cognitivedrone.files import read_regular, replacing
from cognitivedrone.files.texts import folded
from cognitivedrone.labels.images import SIDE, SUFFIXES
from cognitivedrone.pictures import OTHER_SUFFIXES, decode_picture
from cognitivedrone.plan import PilotSpec
from cognitivedrone.system.processes import environment
from cognitivedrone.tasks.suites import drawn_task, suite_of_tasks
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import Task

_RECIPE_BYTES: Final = 2**20
_STEP: Final = re.compile(r"step (\d+)")
_END_S: Final = 5.0


class Lesson:
    """Teaches the pictures in a folder; `changed` is called at every line of the training, and at its end."""

    def __init__(self, labels: Path, out: Path, changed: Callable[[], None]) -> None:
        self.out = out
        self.words = ["train", "--recipe", "teach", "--labels", str(labels), "--out", str(out)]
        self.text, self.share, self.done = "the lesson begins", 0.0, False
        self.failed = False
        self._lines: deque[str] = deque(maxlen=3)
        self._changed = changed
        self._process = subprocess.Popen(  # noqa: S603  (our own command, no shell)
            [sys.executable, "-m", "cognitivedrone", *self.words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=environment(),
        )
        threading.Thread(target=self._follow, name="lesson", daemon=True).start()

    @property
    def pilot(self) -> PilotSpec:
        """The taught pilot. Raises `TrainingError` if there is none."""
        if not self.done or self.failed:
            raise TrainingError(f"this lesson has not ended: {self.text}")
        return PilotSpec(f"small:{self.out / 'model.onnx'}", f"small:{self.out}")

    def stop(self) -> None:
        """End it."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()

    def _follow(self) -> None:
        assert self._process.stdout is not None  # noqa: S101  (a pipe)
        for line in self._process.stdout:
            if not (text := " ".join(line.split())):
                continue
            self._lines.append(text)
            self.text = text[:160]
            if found := _STEP.search(text):
                with suppress(OSError, ValueError, KeyError):  # then the bar stands still
                    self.share = min(1.0, int(found[1]) / self._steps())
            self._changed()
        self.failed = self._process.wait() != 0
        self.text = f"the lesson failed: {' '.join(self._lines)[:400]}" if self.failed else "taught; it flies now"
        self.share, self.done = 1.0, True
        self._changed()

    def _steps(self) -> int:
        """Steps of the lesson, as the training wrote down."""
        recipe = parse_json(read_regular(self.out / "recipe.json", _RECIPE_BYTES))
        return int(recipe["recipe"]["steps"])


KIND: Final = "mine"
"""Kind of the labels, and folder of the pictures."""
PANELS: Final = 3
_LONGEST: Final = 40


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture on a panel."""

    name: str
    """What it shows, as the user says it."""
    reference: str
    """Its label."""


def spoken_name(spoken: str) -> str:
    """A name for a picture from what a user typed, or a file's name: letters, digits and blanks; may be empty."""
    stem = folded(spoken)
    for suffix in (*SUFFIXES, *OTHER_SUFFIXES, ".bmp"):
        stem = stem[: -len(suffix)] if stem.endswith(suffix) else stem
    words = re.sub(r"[\W_]+", " ", stem).split()
    return " ".join(words)[:_LONGEST].strip()


def keep_picture(folder: Path, name: str, content: bytes, slot: int, taken: Collection[str] = ()) -> Picture:
    """Write a picture into a folder of labels; a name that another panel has `taken` gets a number.

    Raises `LabelError` if it is no PNG, JPEG or WebP, or too large.
    """
    image = decode_picture(content, repr(name[:60] or "this file"), LabelError, SIDE)
    first = called = spoken_name(name) or f"picture {slot + 1}"
    number = 2
    while called in taken:  # telephones call every photograph "image"
        called, number = f"{first} {number}", number + 1
    place = _file(folder, called)
    place.parent.mkdir(parents=True, exist_ok=True)
    with replacing(place) as part:
        image.save(part, "PNG")
    return Picture(called, f"{KIND}/{place.stem}")


def renamed(folder: Path, picture: Picture, name: str, taken: Collection[str] = ()) -> Picture:
    """Give a picture another name. Raises `LabelError` for one without letters or digits, or of another panel."""
    called = spoken_name(name)
    if not called:
        raise LabelError(f"{name[:60]!r} is no name; say in a word or two what the picture shows")
    if called in taken:
        raise LabelError(f"another panel shows {called!r} already; give this picture another name")
    place = _file(folder, called)
    _file(folder, picture.name).replace(place)
    return Picture(called, f"{KIND}/{place.stem}")


def _file(folder: Path, called: str) -> Path:
    return folder / KIND / f"{called.replace(' ', '_')}.png"


def own_scene(pictures: tuple[Picture | None, ...], instruction: str, seed: int) -> tuple[ChosenScene, int | None]:
    """A scene with a user's pictures, drawings of animals on the other panels; and the gate that the words name.

    Nobody knows which gate is right: where the instruction names none of the pictures, the first one is taken.
    """
    task = drawn_task("animals", np.random.default_rng([seed, 7]), f"mine/{seed}")
    labels, options = list(task.labels), list(task.options)
    for slot, picture in enumerate(pictures):
        if picture is not None:
            labels[slot], options[slot] = picture.reference, picture.name
    words = set(re.sub(r"[\W_]+", " ", folded(instruction)).split())
    named = [slot for slot, name in enumerate(options) if set(re.sub(r"[\W_]+", " ", folded(name)).split()) <= words]
    target = named[0] if len(named) == 1 else None
    asked = instruction or f"Fly through the gate with the {options[0]}"
    made: Task = replace(
        task, labels=(labels[0], labels[1], labels[2]), options=(options[0], options[1], options[2]),
        target=target or 0, instruction=asked,
    )  # fmt: skip
    return ChosenScene(suite_of_tasks(MADE, [made]), 0, f"scene: {', '.join(options)}"), target
