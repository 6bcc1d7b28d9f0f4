"""A lesson that the page starts: `cognitivedrone train --recipe teach` in a process of its own, and how far it is."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from cognitivedrone.errors import TrainingError
from cognitivedrone.files import read_regular
from cognitivedrone.plan import PilotSpec
from cognitivedrone.system.processes import environment
from cognitivedrone.text.json_text import parse_json

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
