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
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from cognitivedrone import system
from cognitivedrone.errors import CognitiveDroneError, TrainingError
from cognitivedrone.files.locks import sole_writer
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.system.processes import end_with_starter, environment, starter, starting
from cognitivedrone.text.printable import message

ERROR_FILE = "COGNITIVEDRONE_TRAINING_ERROR"
"""The variable that names the file."""
END_S = 40.0
"""For PyTorch's launcher to end the processes: it kills after 30 s what SIGTERM has not ended."""
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

    They end with this call, with an exception in it, and with this process, however that ends; until then they hold the
    lock of this descriptor, too.
    """
    kept = system.inheriting(() if lock is None else (lock,))
    with TemporaryFolder("training") as folder:
        file = folder / "error"
        variables = {"OMP_NUM_THREADS": "1", **environment(), **starter(), ERROR_FILE: str(file)}
        with starting():  # without ctrl-C: this process shuts them down in order
            process = subprocess.Popen(command, env=variables, **kept)  # noqa: S603
        try:
            code = process.wait()
        except BaseException:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            raise
        finally:
            process.kill()
            process.wait()
        if file.is_file():
            raise TrainingError(file.read_text(encoding="utf-8"))
    if code:
        raise TrainingError(f"the training ended with exit code {code}; its messages are above")


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
    from torch.distributed.elastic.multiprocessing.api import SignalException
    from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
    from torch.distributed.run import main as launch

    end_with_starter()
    os.environ.update(starter())  # of the processes that it starts
    logging.disable(logging.ERROR)  # what it logs of a failed process stands in its last message too
    # Without a folder, it makes one among the temporary files and leaves it there.
    folder = ["--log-dir", str(Path(os.environ[ERROR_FILE]).parent)] if ERROR_FILE in os.environ else []
    try:
        launch([*folder, *sys.argv[1:]])
    except SignalException as stop:
        sys.exit(128 + stop.sigval)
    except ChildFailedError as error:
        if error.get_first_failure()[1].exitcode != USAGE:
            raise
        sys.exit(USAGE)


if __name__ == "__main__":
    main()
