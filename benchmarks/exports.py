"""Time and size of the exports of a data set, and whether they are read back whole.

Run: python benchmarks/exports.py STORE FOLDER [--to rlds lerobot published] [--out results/exports.json]

Exports STORE to FOLDER/FORMAT, which stays, and reads each export to its end by this package's own reader.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.data.formats import export, import_
from cognitivedrone.data.store import Store

FORMATS = ("rlds", "lerobot", "published")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--to", nargs="+", default=FORMATS, choices=FORMATS)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    store, rows = Store.open(options.store), []
    for name in options.to:
        folder = options.folder / name
        began = time.perf_counter()
        export(store.labelled(), name, folder)
        row = {
            "command": f"cognitivedrone data export STORE --to {name} --out OUT",
            "time_s": time.perf_counter() - began,
            "size_gb": sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e9,
        }
        lengths = [len(episode) for _, episode in import_(folder, name)]
        rows.append({**row, "read_episodes": len(lengths), "read_steps": sum(lengths)})
        print(rows[-1], flush=True)
        if sum(lengths) != store.n_steps:
            sys.exit(f"{name} lost steps: {sum(lengths)} of {store.n_steps} were read back")
    keep(options.out, f"Exports of the {len(store):,} episodes ({store.n_steps:,} steps) of the recipe paper", rows)


if __name__ == "__main__":
    main()
