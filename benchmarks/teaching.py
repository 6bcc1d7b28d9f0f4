"""What a lesson is worth: a pilot before and after it, on tasks that the lesson lacked, and on the known suite.

Run: python benchmarks/teaching.py --labels FOLDER [--tasks FOLDER] --folder runs/taught [--start small]
    [--episodes 200] [--out results/teaching.json]

A seventh of the tasks (by a hash of their content) is kept from the lesson. Some of them, whose pictures are all there,
are flown afterwards, by the policy alone and with its reasoner, as is `open-v1:test`. Resumes. Never give it tasks that
are kept for an examination.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from cognitivedrone import evaluate
from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.labels.images import SUFFIXES
from cognitivedrone.tasks.format import task_to_json
from cognitivedrone.training.teach.lesson import read_lesson


@dataclass(frozen=True)
class Config:
    """What is taught and flown."""

    labels: Path
    folder: Path
    """Of the pilot and its flights."""
    tasks: Path | None = None
    """A task file, or a folder of them. Without any, nothing is flown, and the minutes alone are measured."""
    start: str = "small"
    """The pilot: "small", or the folder of a taught one."""
    episodes: int = 200
    """Kept tasks that are flown."""
    known: int = 300
    """Tasks of open-v1:test that are flown."""
    processes: int = 2
    seed: int = 0
    out: Path | None = None
    """File for the figures."""


def main(config: Config) -> None:
    """Split, teach, fly, print."""
    config.folder.mkdir(parents=True, exist_ok=True)
    lesson, kept = split(config.tasks, config.folder / "split") if config.tasks else (None, None)
    minutes = teach(config, lesson)
    pictures = sum(path.suffix.lower() in SUFFIXES for path in config.labels.rglob("*"))
    print(f"{pictures} pictures, taught in {minutes:.1f} min")
    rows: list[dict[str, Any]] = [{"pictures": pictures, "lesson_min": minutes}]
    if kept is not None:
        rows += list(flown(config, kept))
    keep(config.out, "A pilot before and after a lesson", rows, seed=config.seed)


def flown(config: Config, kept: Path) -> Iterator[dict[str, Any]]:
    """What the pilot passes before and after the lesson."""
    drawn = config.folder / "kept.json"
    drawn.write_text(json.dumps(draw(kept, config)), encoding="utf-8")
    before = ("small", "small") if config.start == "small" else pilot(Path(config.start))
    for name, (policy, reasoner) in {"before": before, "after": pilot(config.folder / "pilot")}.items():
        for with_reasoner in (None, reasoner):
            who = f"{name}, {'policy' if with_reasoner is None else 'R1'}"
            folder = config.folder / who.replace(", ", "-")
            for place, suite, labels, count in (
                ("held back", drawn, config.labels, config.episodes),
                ("known before", "open-v1:test", None, config.known),
            ):
                done = evaluate(
                    policy,
                    suite,
                    reasoner=with_reasoner,
                    labels=labels,
                    episodes=count,
                    out=folder / place.replace(" ", "-"),
                    resume=True,
                )
                rate = done.summary.overall
                low, high = rate.ci95 or (0.0, 1.0)
                families = {family: f"{each.rate:.0%}" for family, each in done.summary.families.items()}
                print(f"{who:16} {place:12} {rate.rate:6.1%} ({low:.1%} to {high:.1%})  {families}")
                yield {"who": who, "tasks": place, "passed": rate.passed, "n": rate.n}


def teach(config: Config, lesson: Path | None) -> float:
    """Train unless that was done; the minutes of all starts together."""
    taught = config.folder / "minutes"
    minutes = float(taught.read_text(encoding="utf-8")) if taught.exists() else 0.0
    if (config.folder / "pilot" / "model.onnx").exists():
        return minutes
    began = time.monotonic()
    command = [
        sys.executable, "-m", "cognitivedrone", "train", "--recipe", "teach", "--labels", config.labels,
        *(["--tasks", lesson] if lesson else []), "--start", config.start, "--out", config.folder / "pilot",
        "--processes", config.processes, "--seed", config.seed, "--resume",
    ]  # fmt: skip
    try:
        subprocess.run([str(part) for part in command], check=True)
    finally:
        minutes += (time.monotonic() - began) / 60
        taught.write_text(str(minutes), encoding="utf-8")
    return minutes


def pilot(folder: Path) -> tuple[str, str]:
    """The names of a taught policy and reasoner."""
    return f"small:{folder / 'model.onnx'}", f"small:{folder}"


def draw(kept: Path, config: Config) -> list[dict[str, Any]]:
    """Some of the kept tasks of all files, as they are written."""
    with warnings.catch_warnings(action="ignore"):  # the lesson names what is left out
        tasks = read_lesson(config.labels, kept).tasks
    order = np.random.default_rng(config.seed).permutation(len(tasks))[: config.episodes]
    return [task_to_json(tasks[index]) for index in order]


def split(tasks: Path, out: Path) -> tuple[Path, Path]:
    """Folders of the lesson's tasks and of the kept ones, one file for each file."""
    lesson, kept = out / "lesson", out / "kept"
    for folder in (lesson, kept):
        folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(tasks.glob("*.json")) if tasks.is_dir() else [tasks]:
        parts: dict[Path, list[object]] = {lesson: [], kept: []}
        for task in json.loads(path.read_text(encoding="utf-8")):
            digest = hashlib.sha256(json.dumps(task, sort_keys=True).encode()).digest()
            parts[kept if digest[0] % 7 == 0 else lesson].append(task)
        for folder, content in parts.items():
            if content:
                (folder / path.name).write_text(json.dumps(content), encoding="utf-8")
    return lesson, kept


if __name__ == "__main__":
    main(tyro.cli(Config))
