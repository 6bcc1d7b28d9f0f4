"""Memory that OpenVLA-7B needs, computed from the shapes of its tensors: for inference, and for fine-tuning by LoRA.

Run: python benchmarks/openvla_memory.py [--out results/openvla_memory.json]

The same on every machine; for LoRA with what PyTorch itself takes of a GPU. `fly`, `serve` and `train-openvla` compare
these figures with what is free before they load a weight.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.models.openvla import checkpoint
from cognitivedrone.models.openvla.config import Config
from cognitivedrone.training.openvla.adapters import WORKSPACE, needed_bytes
from cognitivedrone.training.openvla.recipes import PAPER

MICRO_BATCHES = (1, 4, 8, 16, 32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    out = parser.parse_args().out
    rows: list[dict[str, Any]] = [
        {"quant": quantisation, "memory_gb": checkpoint.needed_bytes(Config(), quantisation) / 1e9}
        for quantisation in checkpoint.BYTES_PER_WEIGHT
    ]
    for micro_batch in MICRO_BATCHES:
        recipe = replace(PAPER, micro_batch=micro_batch)
        kept, recomputed = (
            (needed_bytes(Config(), replace(recipe, checkpointing=each)) + WORKSPACE) / 1e9 for each in (False, True)
        )
        rows.append({"micro_batch": micro_batch, "kept_gb": kept, "recomputed_gb": recomputed})
    for row in rows:
        print(*(f"{key} {value:.1f}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()))
    keep(out, "Memory of OpenVLA-7B, computed from the shapes of its tensors", rows)


if __name__ == "__main__":
    main()
