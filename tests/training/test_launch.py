"""What cannot be trained on, or written to, is refused before PyTorch is loaded."""

import sys

import pytest

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
