"""The answers of the published reasoner (arXiv 2503.01378), from the files of its evaluation: the paper's R1.

`published:PATH` takes `after_reasoning`, a folder around it such as the checkout, or one of its files. Each task there
has the key `prompt_after_reasoning`, what the paper's policy was told; tasks are matched by prompt, options and gates,
since their order differs.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cognitivedrone.errors import GroundTruthError, PluginError, ReasonerError, TaskError
from cognitivedrone.files import own_files
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.tasks.directives import fitting_gate
from cognitivedrone.tasks.format import read_json, task_from_json
from cognitivedrone.tasks.published import type_of
from cognitivedrone.types import EpisodeContext, Gate, Guidance, Image, Task

ANSWER = "prompt_after_reasoning"
_Key = tuple[str, tuple[str, ...], tuple[Gate, ...]]


def answer_files(path: Path) -> list[Path]:
    """The files with answers: the one given, or those below a folder; raises `PluginError` where there is none."""
    files = [path] if path.is_file() else own_files(path, "**/*_updated.json") if path.is_dir() else []
    if not files:
        raise PluginError(
            f"published: {path} holds no <Type>_updated.json; give the published eval_after_reasoning/after_reasoning,"
            " or the checkout"
        )
    return files


class Published(Reasoner):
    """Gives the published answer to the current task; one to a task that is not in the files is the fault `unsure`."""

    needs_ground_truth = True
    reads_folder = True
    """Its file may be a folder of files."""
    reads_english_only = True

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.answers: dict[_Key, str] = {}
        for file in answer_files(self.path):
            for key, answer in _answers(file):
                self.answers.setdefault(key, answer)
        self._task: Task | None = None

    @classmethod
    def file_of(cls, path: Path | str) -> Path:
        """The file or folder of answers, which is part of a run's identity; raises `PluginError` as `answer_files`."""
        answer_files(Path(path))
        return Path(path)

    def reset(self, context: EpisodeContext) -> None:
        """Take the current task."""
        self._task = context.ground_truth.task if context.ground_truth else None

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The answer to the current task; raises `ReasonerError` if there is none."""
        if self._task is None:
            raise GroundTruthError("the published reasoner needs the current task, which only a simulator knows")
        answer = self.answers.get(_key(self._task))
        if answer is None:
            raise ReasonerError("unsure", f"{self.path} has no answer for task {self._task.id!r}")
        return Guidance(answer, fitting_gate(answer, self._task.gates), 1.0)


def _key(task: Task) -> _Key:
    return task.instruction, task.options, task.gates


def _answers(file: Path) -> Iterator[tuple[_Key, str]]:
    try:
        content: Any = read_json(file)
        name, known = type_of(file)
        for index, obj in enumerate(content if isinstance(content, list) else [content]):
            task = task_from_json(obj, where=f"{file}[{index}]", kind=known or name)
            answer = obj.get(ANSWER)
            if not isinstance(answer, str) or not answer.strip():
                raise PluginError(f"{file}[{index}]: key {ANSWER!r} is missing; it must be what the policy was told")
            yield _key(task), answer
    except TaskError as error:
        raise PluginError(f"published: {error}") from None
