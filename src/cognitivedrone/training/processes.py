"""Processes that train together on this machine: `python -m` this module starts them, as `torch.distributed.run` does.

PyTorch's launcher ends with a traceback and a table when a process fails, after what each process printed. Here a
process that meets a user's error writes its sentence into a file, and the command that started them all says it once.
"""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NoReturn

from cognitivedrone.errors import CognitiveDroneError, TrainingError
from cognitivedrone.locks import sole_writer
from cognitivedrone.printable import message
from cognitivedrone.processes import environment

ERROR_FILE = "COGNITIVEDRONE_TRAINING_ERROR"
"""The variable that names the file."""
USAGE = 2
"""Exit code of a process that met a user's error."""


@contextlib.contextmanager
def training_lock(out: Path) -> Iterator[int | None]:
    """The lock of the folder of a training, for as long as it writes there; yields the descriptor that holds it.

    Of several processes the first takes it, or the command that started them all. Raises `TrainingError` if another
    training has it.
    """
    if os.environ.get("RANK", "0") != "0" or ERROR_FILE in os.environ:
        yield None
        return
    with sole_writer(out, TrainingError, "training there") as descriptor:
        yield descriptor


def run_processes(command: Sequence[str], lock: int | None = None) -> None:
    """Run the command that starts the processes until they end; raises TrainingError if one failed.

    The processes hold the lock of this descriptor, too: it stays if this process is killed and they are not.
    """
    kept = () if lock is None else (lock,)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "error"
        variables = {"OMP_NUM_THREADS": "1", **environment(), ERROR_FILE: str(file)}
        done = subprocess.run(command, env=variables, pass_fds=kept, check=False)  # noqa: S603
        if file.is_file():
            raise TrainingError(file.read_text(encoding="utf-8"))
    if done.returncode:
        raise TrainingError(f"the training ended with exit code {done.returncode}; its messages are above")


def fail(error: CognitiveDroneError) -> NoReturn:
    """End this process because of a user's error, which the first process reports."""
    if file := os.environ.get(ERROR_FILE):
        written = Path(f"{file}.{os.getpid()}")
        written.write_text(str(error), encoding="utf-8")
        written.replace(file)  # whole, if this process is ended meanwhile because another has failed
    else:  # under another launcher
        print(message(f"cognitivedrone: {error}"), file=sys.stderr)  # noqa: T201
    sys.exit(USAGE)


def main() -> None:
    """PyTorch's launcher; of a process that met a user's error it says nothing more."""
    from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
    from torch.distributed.run import main as launch

    logging.disable(logging.ERROR)  # what it logs of a failed process stands in its last message too
    try:
        launch()
    except ChildFailedError as error:
        if error.get_first_failure()[1].exitcode != USAGE:
            raise
        sys.exit(USAGE)


if __name__ == "__main__":
    main()
