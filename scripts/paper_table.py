"""The paper's figure and table from the runs of `runs/reproduce.sh`, and a manifest of the trained weights.

Run: python scripts/paper_table.py OUT

Three systems by three categories, with 95 % intervals, beside the published scores (arXiv 2503.01378), which are of
other tasks in another simulator. Writes OUT/paper.md, OUT/paper.svg and OUT/manifest.json.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from score_tables import PAPER_SYSTEMS, paper_table

from cognitivedrone import checkout
from cognitivedrone.benchmark.published import PUBLISHED
from cognitivedrone.benchmark.results import Results, read_results
from cognitivedrone.benchmark.scoring import Interval, Summary
from cognitivedrone.files import digest_of_file
from cognitivedrone.types import CATEGORIES

WEIGHTS = (
    "reader/reader.safetensors", "small/model.onnx", "language/model.onnx", "flight/model.onnx",
    "selector/panel_reader.onnx", "selector/gate_selector.onnx", "race/model.onnx",
)  # fmt: skip
WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 720, 330, 50, 40, 60
COLORS = {"CognitiveDrone-R1": "#3b5bdb", "CognitiveDrone": "#7f96ec", "RaceVLA": "#b9bfcd"}

Bars = dict[str, list[tuple[float, Interval]]]
"""By system: the categories and their mean, per unit."""


def main(out: Path) -> None:
    """Write table, figure and manifest."""
    results = {name: read_results(out / "scores" / pilot / "open-v1-test") for name, pilot in PAPER_SYSTEMS.items()}
    bars = {name: bars_of(each) for name, each in results.items()}
    table = paper_table({name: {"open-v1:test": each.summary("through")} for name, each in results.items()})
    (out / "paper.md").write_text(str(table), encoding="utf-8")
    (out / "paper.svg").write_text(figure(bars), encoding="utf-8")
    (out / "manifest.json").write_text(json.dumps(manifest(out), indent=1) + "\n", encoding="utf-8")
    print(table)
    print(out / "paper.svg", out / "manifest.json")


def bars_of(results: Results) -> list[tuple[float, Interval]]:
    """Rates of the categories, and their mean; 0 for a category that was not flown."""
    summary: Summary = results.summary("through")
    scores = [summary.categories.get(category) for category in CATEGORIES]
    every = [(score.rate or 0.0, score.ci95 or (0.0, 1.0)) if score else (0.0, (0.0, 1.0)) for score in scores]
    mean = summary.mean_of_categories
    return [*every, (mean.rate or 0.0, mean.ci95 or (0.0, 1.0))]


def figure(bars: Bars) -> str:
    """SVG: bars with intervals; a line across each bar is the published score."""
    names = [*(category.replace("_", " ") for category in CATEGORIES), "mean"]
    group = (WIDTH - LEFT) / len(names)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif"'
        f' font-size="12"><rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>'
    ]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH}" y1="{y_of(share):.1f}" y2="{y_of(share):.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y_of(share) + 4:.1f}" text-anchor="end">{share:.0%}</text>')
    for place, name in enumerate(names):
        left = LEFT + place * group
        parts.append(f'<text x="{left + group / 2:.1f}" y="{HEIGHT - 38}" text-anchor="middle">{name}</text>')
        for number, published in enumerate(reversed(PUBLISHED)):
            rate, (low, high) = bars[published.name][place]
            theirs = published.overall if place == len(CATEGORIES) else published.categories[CATEGORIES[place]]
            x, wide = left + group * (0.12 + 0.26 * number), group * 0.22
            middle = x + wide / 2
            parts += [
                f'<rect x="{x:.1f}" width="{wide:.1f}" y="{y_of(rate):.1f}" height="{y_of(0) - y_of(rate):.1f}"'
                f' fill="{COLORS[published.name]}"/>',
                f'<line x1="{middle:.1f}" x2="{middle:.1f}" y1="{y_of(low):.1f}" y2="{y_of(high):.1f}" stroke="#222"/>',
                f'<line x1="{x:.1f}" x2="{x + wide:.1f}" y1="{y_of(theirs):.1f}" y2="{y_of(theirs):.1f}"'
                ' stroke="#c2306f" stroke-width="2"/>',
            ]
    for number, published in enumerate(reversed(PUBLISHED)):
        x = LEFT + 170 * number
        parts.append(f'<rect x="{x}" y="{HEIGHT - 22}" width="12" height="12" fill="{COLORS[published.name]}"/>')
        parts.append(f'<text x="{x + 18}" y="{HEIGHT - 12}">{published.name}</text>')
    parts.append(f'<text x="{WIDTH - 4}" y="{HEIGHT - 12}" text-anchor="end" fill="#c2306f">line: published</text>')
    return "\n".join([*parts, "</svg>\n"])


def y_of(share: float) -> float:
    """Height of a rate in the figure."""
    return HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)


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
