"""Run examples/tour.ipynb from top to bottom, and keep it with its outputs, which GitHub and the site show.

Run: python scripts/run_notebook.py
"""

from __future__ import annotations

from pathlib import Path

import nbclient
import nbformat

NOTEBOOK = Path(__file__).resolve().parents[1] / "examples" / "tour.ipynb"


def main() -> None:
    """Execute, leave out what shows nothing, write."""
    book = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(book, timeout=500, kernel_name="python3", record_timing=False).execute()
    for cell in book.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if shows(output)]
    nbformat.write(book, NOTEBOOK)


def shows(output: nbformat.NotebookNode) -> bool:
    """Whether there is anything to see: a progress bar that was cleared leaves an empty output."""
    data = output.get("data", {})
    return bool(output.get("text") or data.get("text/plain") or "image/png" in data)


if __name__ == "__main__":
    main()
