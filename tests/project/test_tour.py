"""The notebook runs from top to bottom."""

import json
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "tour.ipynb"


def test_it_is_kept_with_the_outputs_of_a_whole_run():
    """`python scripts/run_notebook.py` makes them."""
    cells = [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert not any(output["output_type"] == "error" for output in outputs)
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 3
    assert NOTEBOOK.stat().st_size < 1_000_000


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # Jupyter's own, about its sockets and folders
def test_it_runs_from_top_to_bottom(tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat", reason="nbclient is in the extra docs")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is in the extra docs")
    pytest.importorskip("ipykernel", reason="ipykernel is in the extra docs")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    book = nbformat.read(NOTEBOOK, as_version=4)
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(book, timeout=500, kernel_name="python3", resources=where).execute()
    shown = [output for cell in book.cells for output in cell.get("outputs", [])]
    text = "".join(output.get("text", "") for output in shown)
    assert text.count("overall") == 2  # two tables of scores
    assert "4 episodes" in text
    pictures = [output for output in shown if "image/png" in output.get("data", {})]
    assert len(pictures) == 3
    assert "(32, 256, 256, 3)" in shown[-1]["data"]["text/plain"]
