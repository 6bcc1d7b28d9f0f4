"""What cannot be trained on, or written to, is refused before PyTorch is loaded; how processes are started and end."""

import os
import signal
import subprocess
import sys

import pytest
from signals import LIMIT_S, press, runs
from waiting import soon

from cognitivedrone.errors import DataError, TrainingError
from cognitivedrone.training import launch


@pytest.fixture(autouse=True)
def nothing_is_trained(monkeypatch):
    """The trainer cannot be imported."""
    monkeypatch.setitem(sys.modules, "cognitivedrone.training.trainer.trainer", None)


@pytest.mark.parametrize("processes", [1, 2])
def test_data_that_are_no_data_set_are_refused_at_once(tmp_path, processes):
    with pytest.raises(DataError, match=r"manifest\.json"):
        launch.run(launch.TrainPlan(tmp_path / "out", "debug", data=tmp_path, processes=processes))


def test_a_file_in_place_of_the_folder_is_refused_at_once(tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(TrainingError, match="out is a file; give a folder as --out"):
        launch.run(launch.TrainPlan(tmp_path / "out", "debug"))
    assert (tmp_path / "out").read_text() == "mine"


TRAINER = """
import os, time
from pathlib import Path
from cognitivedrone.system.processes import end_with_starter
end_with_starter()
Path(f"begun-{os.environ['RANK']}").write_text(str(os.getpid()))
while True:
    time.sleep(60)
"""
COMMAND = """
import sys
from cognitivedrone.system.interrupts import ending_in_order
from cognitivedrone.training.launch import LAUNCHER
from cognitivedrone.training.processes import run_processes
with ending_in_order():
    run_processes([sys.executable, "-m", LAUNCHER, "--standalone", "--nproc-per-node", "2", "trainer.py"])
"""


def test_pytorchs_launcher_ends_with_its_command_and_leaves_nothing(tmp_path):
    """The real one; how the others end is in tests/system/test_processes.py."""
    pytest.importorskip("torch")
    (tmp_path / "tmp").mkdir()
    (tmp_path / "trainer.py").write_text(TRAINER)
    command = subprocess.Popen(
        [sys.executable, "-c", COMMAND], cwd=tmp_path, env=os.environ | {"TMPDIR": str(tmp_path / "tmp")},
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    begun = [tmp_path / "begun-0", tmp_path / "begun-1"]
    try:
        soon(lambda: all(path.exists() and path.read_text() for path in begun), LIMIT_S)
        press(command.pid, signal.SIGTERM)
        assert command.wait(LIMIT_S) != 0
        soon(lambda: not any(runs(int(path.read_text())) for path in begun), LIMIT_S)
    finally:
        command.kill()
        _, said = command.communicate()
    assert said.count("Traceback") == 1, said  # of the command here, which has no main
    assert not [*(tmp_path / "tmp").iterdir()]
