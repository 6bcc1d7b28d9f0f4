"""The replay reasoner: gives recorded answers from a file, such as those of another machine.

The answers of the published reasoner (arXiv 2503.01378), from the files of its evaluation: the paper's R1.

`published:PATH` takes `after_reasoning`, a folder around it such as the checkout, or one of its files. Each task there
has the key `prompt_after_reasoning`, what the paper's policy was told; tasks are matched by prompt, options and gates,
since their order differs.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, get_args

from cognitivedrone.errors import PluginError, ReasonerError, ReasonerFault, TaskError, did_you_mean
from cognitivedrone.files import check_regular, own_files, read_regular, reason_of
from cognitivedrone.files.texts import decoded
from cognitivedrone.reasoners.oracle import TaskReasoner
from cognitivedrone.tasks.directives import fitting_gate
from cognitivedrone.tasks.format import read_json, task_from_json
from cognitivedrone.tasks.published import type_of
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import EpisodeContext, Gate, Guidance, Image, Task

MAX_FILE_BYTES: Final = 64 * 2**20
FAULTS: Final[tuple[ReasonerFault, ...]] = get_args(ReasonerFault)

Entry = Guidance | ReasonerFault
"""One answer of the file: guidance, or the fault that prevented it."""


def read_answers(path: Path) -> dict[str, tuple[Entry, ...]]:
    """The answers of a JSON Lines file by task id, in the file's order.

    A line is `{"task": id, "directive": text, "gate": 0 to 2 or null, "confidence": 0 to 1, "fault": kind or null}`.
    `gate`, `confidence` (default 1) and `fault` are optional; a line with a fault needs no directive. Other keys and
    empty lines are ignored. Raises `PluginError` with file and line.
    """
    answers: dict[str, list[Entry]] = {}
    for number, line in enumerate(_content(path).split("\n"), start=1):
        if not line.strip():
            continue
        where = f"{path} line {number}"
        try:
            obj = parse_json(line, non_finite=True)
        except ValueError:
            raise PluginError(f"{where} is not JSON; every line must be one object") from None
        if not isinstance(obj, dict) or not isinstance(obj.get("task"), str):
            raise PluginError(
                f'{where} must be an object with a task\'s id, as in {{"task": "open-v1:test/0007", ...}}'
            )
        answers.setdefault(obj["task"], []).append(_entry(obj, where))
    if not answers:
        raise PluginError(f"{path} holds no answer; every line of it must be an object with task and directive")
    return {task: tuple(entries) for task, entries in answers.items()}


def _content(path: Path) -> str:
    try:
        return decoded(read_regular(path, MAX_FILE_BYTES))
    except OSError as error:
        raise _refusal(path, error) from None
    except ValueError as error:
        raise PluginError(f"replay: {path} cannot be read: {error}") from None


def _refusal(path: Path, error: OSError) -> PluginError:
    if isinstance(error, FileNotFoundError) or path.is_dir():
        return PluginError(f"replay: there is no file {path}; give one as replay:FILE, such as a run's reason.jsonl")
    way_out = "keep only the tasks that are flown" if error.errno == errno.EFBIG else "give a file of answers"
    return PluginError(f"replay: {path} cannot be read: {reason_of(error)}; {way_out}")


def _entry(obj: Mapping[str, Any], where: str) -> Entry:
    fault = obj.get("fault")
    if fault is not None:
        if fault not in FAULTS:
            raise PluginError(f"{where}: unknown fault {fault!r}; {did_you_mean(str(fault), FAULTS)}")
        known: ReasonerFault = fault
        return known
    directive, gate, confidence = obj.get("directive"), obj.get("gate"), obj.get("confidence", 1.0)
    if not isinstance(directive, str):
        raise PluginError(
            f"{where}: directive must be a sentence, not {directive!r:.40}, or fault say why there is none"
        )
    if gate is not None and (type(gate) is not int or not 0 <= gate <= 2):
        raise PluginError(f"{where}: gate is {gate!r:.40}; it must be 0, 1 or 2 from left to right, or null")
    if isinstance(confidence, bool) or not isinstance(confidence, (int, float)) or not 0 <= confidence <= 1:
        raise PluginError(f"{where}: confidence is {confidence!r:.40}; it must be a number from 0 to 1")
    return Guidance(directive, gate, float(confidence))


class Replay(TaskReasoner):
    """Gives the answers of a file and ignores the image. Several answers to a task follow in order; the last repeats.

    The simulator supplies the id of the current task. A recorded fault is raised as that fault; a task that is not in
    the file, as `unsure`.
    """

    name = "replay"

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.answers = read_answers(self.path)
        self._given = 0

    @classmethod
    def file_of(cls, path: Path | str) -> Path:
        """The file of answers, which is part of a run's identity; raises `PluginError` if it cannot be read."""
        try:
            check_regular(Path(path), MAX_FILE_BYTES)  # a run hashes it before it is read
        except OSError as error:
            raise _refusal(Path(path), error) from None
        return Path(path)

    def reset(self, context: EpisodeContext) -> None:
        """Take the current task, and start with its first answer."""
        super().reset(context)
        self._given = 0

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The next answer to the current task; raises `ReasonerError` if it is a fault, or there is none."""
        entries = self.answers.get(self.task.id)
        if entries is None:
            raise ReasonerError("unsure", f"{self.path} has no answer for task {self.task.id!r}")
        entry = entries[min(self._given, len(entries) - 1)]
        self._given += 1
        if isinstance(entry, Guidance):
            return entry
        raise ReasonerError(entry, f"{self.path} answers task {self.task.id!r} with the fault {entry!r}")


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


class Published(TaskReasoner):
    """Gives the published answer to the current task; one to a task that is not in the files is the fault `unsure`."""

    name = "published"
    reads_folder = True
    """Its file may be a folder of files."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.answers: dict[_Key, str] = {}
        for file in answer_files(self.path):
            for key, answer in _answers(file):
                self.answers.setdefault(key, answer)

    @classmethod
    def file_of(cls, path: Path | str) -> Path:
        """The file or folder of answers, which is part of a run's identity; raises `PluginError` as `answer_files`."""
        answer_files(Path(path))
        return Path(path)

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The answer to the current task; raises `ReasonerError` if there is none."""
        answer = self.answers.get(_key(self.task))
        if answer is None:
            raise ReasonerError("unsure", f"{self.path} has no answer for task {self.task.id!r}")
        return Guidance(answer, fitting_gate(answer, self.task.gates), 1.0)


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
