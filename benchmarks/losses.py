"""Where a reasoner loses its points: by its eyes, by its words, or between them.

Run: python benchmarks/losses.py [--suites open-v3:photos open-v3:wild] [--tasks 300] [--out results/losses.json]

Of the first frame of every task that shows three gates: how often the packaged reasoner names the right one; its eyes
alone, where the thing that is right is known and the panel that shows it best is taken (of tasks whose right panel is
in the vocabulary); and its words alone, where every panel is read perfectly (of tasks whose panels all are).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.benchmark.reasoning.reason import views
from cognitivedrone.envs.track_runner import TrackConfig, episode_rng
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.labels import load_pack
from cognitivedrone.plan import Scenario
from cognitivedrone.reasoners.scene_text import ReadScene
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.tasks.suites import CONDITIONS, suite_of
from cognitivedrone.terminal.progress import counted
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.types import COLORS, SHAPES, SIZES, EpisodeContext, Gate, Task

SUITES = ("open-v3:photos", "open-v3:wild", "open-v3:words", "open-v2:pictures", "open-v1:unseen")


@dataclass(frozen=True)
class Config:
    """What is asked."""

    suites: tuple[str, ...] = SUITES
    tasks: int = 300
    """Of every suite, from the first."""
    out: Path | None = None
    """File for the figures."""


@dataclass(frozen=True)
class Point:
    """One task; none where a part cannot be asked."""

    joint: bool
    eyes: bool | None
    words: bool | None


def main(config: Config) -> None:
    """Print the table, and keep it."""
    rows = []
    print(f"{'suite':18} {'tasks':>5} {'joint':>7} {'eyes alone':>16} {'words alone':>16}")
    for name in config.suites:
        row = _row(name, list(_points(name, config.tasks)))
        rows.append(row)
        eyes, words = (f"{row[part]:.1%} of {row[f'of_{part}']}" for part in ("eyes", "words"))
        print(f"{name:18} {row['tasks']:5} {row['joint']:7.1%} {eyes:>16} {words:>16}")
    keep(config.out, "The first frame's choice by eyes, by words, and by both", rows, seed=0)


def _row(name: str, points: list[Point]) -> dict[str, Any]:
    row: dict[str, Any] = {"suite": name, "tasks": len(points), "joint": np.mean([p.joint for p in points]).item()}
    for part in ("eyes", "words"):
        known = [value for point in points if (value := getattr(point, part)) is not None]
        row |= {part: np.mean(known).item() if known else 0.0, f"of_{part}": len(known)}
    return row


def _points(name: str, count: int) -> Iterator[Point]:
    scenario = Scenario.of(suite=name, **CONDITIONS.get(name, {}))
    suite, reasoner = suite_of(scenario, count), SmallReasoner()
    index = AttributeIndex(reasoner.attributes.names)
    airframe = find_airframe(scenario.airframe)
    episodes = range(len(suite.tracks))[:count]
    with closing(reasoner), Worlds(1, load_pack(), TrackConfig.of(scenario), airframe=airframe) as worlds:
        for episode in counted(episodes, name, len(episodes)):
            for view in views(worlds.runners[0], suite, episode, episode_rng(suite.digest, episode, 0)):
                task = view.truth.task
                if view.index or task.target is None or len({gate.color for gate in task.gates}) < 3:
                    continue
                reasoner.reset(EpisodeContext(task.instruction))
                reasoner.look(view.look())
                point = _point(reasoner, index, task)
                if point is not None:
                    yield point


def _point(reasoner: SmallReasoner, index: AttributeIndex, task: Task) -> Point | None:
    colors, scene, classes = reasoner.read()
    if len(colors) < 3:
        return None
    order = [colors.index(COLORS.index(gate.color)) for gate in task.gates]
    place = order[task.target or 0]
    joint = int(reasoner.decide(task.instruction, scene, classes)[:3].argmax()) == place
    shown = [_perfect(index, label, scene.panels.shape[1]) for label in task.labels]
    right = shown[task.target or 0]
    eyes = None if right is None else int(_fit(scene.panels, right).argmax()) == place
    board = _perfect(index, task.board, len(scene.board)) if task.board else np.zeros_like(scene.board)
    if any(each is None for each in shown) or board is None:
        return Point(joint, eyes, None)
    perfect = ReadScene(
        np.stack([each for each in shown if each is not None]), np.stack([_looks(gate) for gate in task.gates]), board
    )
    return Point(joint, eyes, int(reasoner.decide(task.instruction, perfect)[:3].argmax()) == task.target)


def _fit(panels: NDArray[np.float32], wanted: NDArray[np.float32]) -> NDArray[np.float32]:
    """(3,) log-likelihood that each panel shows the wanted values."""
    fit: NDArray[np.float32] = np.log(panels[:, wanted > 0] + 1e-4).sum(axis=1)
    return fit


def _perfect(index: AttributeIndex, label: str, size: int) -> NDArray[np.float32] | None:
    """(F,) the values that a label shows; none for what is not in the vocabulary."""
    if not index.known(label):
        return None
    values = index.of(label)
    found = np.zeros(size, np.float32)
    found[values[values >= 0]] = 1.0
    return found


def _looks(gate: Gate) -> NDArray[np.float32]:
    words = [*COLORS, *SHAPES, *SIZES]
    found = np.zeros(len(words), np.float32)
    found[[words.index(word) for word in (gate.color, gate.shape, gate.size)]] = 1.0
    return found


if __name__ == "__main__":
    main(tyro.cli(Config))
