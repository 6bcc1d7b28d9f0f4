"""What a lesson is practised with: panel crops of its pictures, and problems about them, beside those known before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageEnhance, ImageFilter

from cognitivedrone.labels import load_pack
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks.generate import Draw
from cognitivedrone.training.language.problems import ABSENT, Problem, Problems, draw_gates, problem_of
from cognitivedrone.training.language.wordings import TYPED
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.panel_crops import PanelCrops, WiderWorld, panel_image_of
from cognitivedrone.training.teach.lesson import Lesson, Statement, attribute_of
from cognitivedrone.types import Image, Task

_SIDE = 64  # pixels of a stored picture
_FROM_TASKS, _BY_NAME = 0.35, 0.35
"""Shares of problems about a lesson that are its tasks, if there are any, and that ask by name."""
_ABSENT = 0.1
_ALIKE = 0.7  # share of wrong panels of the right one's kind


class LessonCrops:
    """Panel crops of a lesson's pictures, and of everything that was known before."""

    def __init__(self, lesson: Lesson, index: AttributeIndex, crop_size: int) -> None:
        self._index, self._crop_size = index, crop_size
        pack = load_pack(str(lesson.folder))
        self._pictures = [
            (name, PillowImage.fromarray(pack.image(reference)).convert("RGB"))
            for name, references in lesson.pictures.items()
            for reference in references
        ]
        self._known = PanelCrops(crop_size, index.of, wider=WiderWorld())

    def draw(self, rng: np.random.Generator, count: int, share: float) -> tuple[Image, NDArray[np.int64]]:
        """Crops (count, g, g, 3) and their attribute values (count, groups), a share of them of the lesson."""
        taught = round(count * share)
        crops, rows = [], []
        if taught < count:
            images, attributes = self._known.draw(rng, count - taught)
            crops, rows = [images], [attributes]
        for _ in range(taught):
            # All pictures alike: "healthy food" may be twenty, which take more practice than one.
            name, picture = self._pictures[int(rng.integers(len(self._pictures)))]
            picture = varied(picture, rng, mirror=name.startswith("concept/thing:"))
            crops.append(panel_image_of(picture, self._crop_size, rng)[None])
            rows.append(self._index.named(name)[None])
        return np.concatenate(crops), np.concatenate(rows)


def varied(picture: PillowImage.Image, rng: np.random.Generator, *, mirror: bool) -> PillowImage.Image:
    """A picture (_SIDE, _SIDE) in other light, cut otherwise, out of focus or partly covered; one in six as it is."""
    if rng.random() < 1 / 6:
        return picture.resize((_SIDE, _SIDE), PillowImage.Resampling.BOX)
    wide, tall = picture.size
    kept = rng.uniform(0.8, 1.0, 2)
    left, top = (1 - kept) * rng.random(2)
    box = (left * wide, top * tall, (left + kept[0]) * wide, (top + kept[1]) * tall)
    picture = picture.resize((_SIDE, _SIDE), PillowImage.Resampling.BOX, box=box)
    if mirror and rng.random() < 0.4:
        picture = picture.transpose(PillowImage.Transpose.FLIP_LEFT_RIGHT)
    if rng.random() < 0.4:
        corner = picture.getpixel((0, 0))
        picture = picture.rotate(rng.normal(0, 7), PillowImage.Resampling.BILINEAR, fillcolor=corner)
    for enhance, spread in ((ImageEnhance.Brightness, 0.2), (ImageEnhance.Contrast, 0.2), (ImageEnhance.Color, 0.35)):
        if rng.random() < 0.5:
            picture = enhance(picture).enhance(float(np.clip(rng.normal(1, spread), 0.3, 1.7)))
    if rng.random() < 0.3:
        picture = picture.filter(ImageFilter.GaussianBlur(float(rng.uniform(0.3, 1.5))))
    if rng.random() < 0.2:
        x, y = (int(value) for value in rng.integers(0, _SIDE - 14, 2))
        patch = PillowImage.new("RGB", (14, 14), tuple(int(value) for value in rng.integers(0, 256, 3)))
        picture = picture.copy()
        picture.paste(patch, (x, y))
    return picture


class LessonProblems(Problems):
    """Problems about a lesson, and those known before."""

    def __init__(self, lesson: Lesson, known: Problems, share: float) -> None:
        super().__init__(known.mix)
        self._lesson, self._share = lesson, share
        self._named = [each for each in lesson.statements if each.by_name]
        self._other = [each for each in lesson.statements if not each.by_name]

    def draw(self, rng: np.random.Generator) -> list[Problem]:
        """One problem, or all problems of a memory track."""
        if rng.random() >= self._share:
            return super().draw(rng)
        chance = rng.random()
        tasks = self._lesson.tasks
        if tasks and chance < _FROM_TASKS:
            return [self._of_task(rng, tasks[int(rng.integers(len(tasks)))])]
        statements = self._named if not self._other or chance < _FROM_TASKS + _BY_NAME else self._other
        return [self._of_statement(rng, statements[int(rng.integers(len(statements)))])]

    def _of_task(self, rng: np.random.Generator, task: Task) -> Problem:
        """A task with its panels in any order."""
        problem = problem_of(task)
        if problem.target == ABSENT:
            return problem
        order = rng.permutation(3)
        first, second, third = (taught(task.labels[place]) for place in order)
        labels = first, second, third
        return Problem(
            problem.sentence, problem.family, labels, draw_gates(rng), task.board, int(np.argmax(order == task.target))
        )

    def _of_statement(self, rng: np.random.Generator, statement: Statement) -> Problem:
        target = int(rng.integers(3))
        wrong = [statement.false[int(i)] for i in rng.choice(len(statement.false), 3, replace=len(statement.false) < 3)]
        names = wrong[:3]
        absent = rng.random() < _ABSENT
        if not absent:
            names[target] = statement.true[int(rng.integers(len(statement.true)))]
        whole = len(statement.phrases) + len(statement.sentences)
        choice = int(rng.integers(whole))
        if choice < len(statement.phrases):
            sentence = Draw(rng, TYPED, target).frame(statement.phrases[choice])
        else:
            sentence = statement.sentences[choice - len(statement.phrases)]
        first, second, third = (f"taught/{name}" for name in names)
        labels = first, second, third
        return Problem(sentence, "taught", labels, draw_gates(rng), None, ABSENT if absent else target)


def taught(label: str) -> str:
    """The label of a user's picture by what it shows, for readings; labels of shipped kinds stay as they are."""
    return label if parse_reference(label).kind == "sum" else f"taught/{attribute_of(label)}"
