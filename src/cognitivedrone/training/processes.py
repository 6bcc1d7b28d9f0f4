"""Processes that train together on this machine: `python -m` this module starts them, as `torch.distributed.run` does.

PyTorch's launcher ends with a traceback and a table when a process fails, after what each process printed. Here a
process that meets a user's error writes its sentence into a file, and the command that started them all says it once.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from cognitivedrone.errors import CognitiveDroneError, TrainingError
from cognitivedrone.printable import message
from cognitivedrone.processes import environment

ERROR_FILE = "COGNITIVEDRONE_TRAINING_ERROR"
"""The variable that names the file."""
USAGE = 2
"""Exit code of a process that met a user's error."""


def run_processes(command: Sequence[str]) -> None:
    """Run the command that starts the processes until they end; raises TrainingError if one failed."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "error"
        variables = {"OMP_NUM_THREADS": "1", **environment(), ERROR_FILE: str(file)}
        done = subprocess.run(command, env=variables, check=False)  # noqa: S603
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
