"""The paper's figure and table from the runs of `runs/reproduce.sh`, and a manifest of the trained weights.

Run: python scripts/paper_table.py OUT

Three systems by three categories, with 95 % intervals, beside the published scores (arXiv 2503.01378), which are of
other tasks in another simulator. Writes OUT/paper.md, OUT/paper.svg and OUT/manifest.json.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from paper_figure import figure
from score_tables import PAPER_SYSTEMS, paper_table

from cognitivedrone import checkout
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.files import digest_of_file

WEIGHTS = (
    "reader/reader.safetensors", "selector/gate_selector.onnx", "selector/picture_classifier.onnx",
    "language/text_encoder.onnx", "small/model.onnx", "flight/model.onnx", "flight/eyes.onnx",
    "flight/language.onnx", "places/model.onnx", "places/eyes.onnx", "places/language.onnx", "race/model.onnx",
    "obstacles/obstacles.onnx",
)  # fmt: skip
SUITE = "open-v1:test"


def main(out: Path) -> None:
    """Write table, figure and manifest."""
    results = {name: read_results(out / "scores" / pilot / "open-v1-test") for name, pilot in PAPER_SYSTEMS.items()}
    summaries = {name: each.summary("through") for name, each in results.items()}
    table = paper_table({name: {SUITE: summary} for name, summary in summaries.items()})
    (out / "paper.md").write_text(str(table), encoding="utf-8")
    (out / "paper.svg").write_text(figure({SUITE: summaries}), encoding="utf-8")
    (out / "manifest.json").write_text(json.dumps(manifest(out), indent=1) + "\n", encoding="utf-8")
    print(table)
    print(out / "paper.svg", out / "manifest.json")


def manifest(out: Path) -> dict[str, object]:
    """Recipe, seed, commit and hash of every weight file that is there."""
    files = {}
    for name in WEIGHTS:
        path = out / name
        if path.is_file():
            recipe = json.loads((path.parent / "recipe.json").read_text(encoding="utf-8"))
            files[name] = {"sha256": digest_of_file(path), "recipe": recipe["recipe"]["name"], "seed": recipe["seed"]}
    return {"commit": checkout.commit() or "none", "files": files}


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
