"""Everything about a graphics card in seven minutes, in the order of worth: make bench-card.

Run: python benchmarks/card.py [--seconds 480] [--results results]

Every part is a benchmark of its own, with a time limit; what it measured until then is kept. The figures are in files
of results; the tables of docs/ are written from them at the end. Without a card it says so, and measures nothing.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 480.0
LEAST_S = 15.0
"""A part is not begun with less time than this."""
NO_CARD = (
    "There is no graphics card that PyTorch can use here (torch.cuda.is_available()), so nothing is measured: install"
    " the card's driver and PyTorch with CUDA, or run the parts of benchmarks/ without one."
)


@dataclass(frozen=True)
class Part:
    """One benchmark."""

    name: str
    limit_s: float
    arguments: tuple[str, ...]
    """Its script in benchmarks/, and its options; {results} is the folder."""


PARTS = (
    Part(
        "rendering by contexts and processes",
        55,
        (
            "rendering_contexts.py",
            *("--processes", "1", "2", "4", "8", "--out", "{results}/rendering_contexts.json"),
        ),
    ),
    Part("the card's pictures", 30, ("rendering_difference.py", "--out", "{results}/rendering_difference.json")),
    Part("environments", 40, ("environment.py", "--many", "--out", "{results}/environment_card.json")),
    Part(
        "flight by threads",
        20,
        ("dynamics.py", "--threads", "1", "2", "4", "8", "16", "--out", "{results}/dynamics_card.json"),
    ),
    Part("control step, bfloat16", 80, ("openvla_gpu.py", "--quant", "none", "--steps", "100", "--add")),
    Part(
        "fine-tuning",
        75,
        ("openvla_gpu.py", "--quant", "none", "--steps", "0", "--lora", "--batches", "8", "16", "32", "--add"),
    ),
    Part(
        "training of the small models",
        70,
        ("training_speed.py", "--seconds", "6", "--out", "{results}/training_card.json"),
    ),
    Part("control step, int8", 70, ("openvla_gpu.py", "--quant", "int8", "--steps", "100", "--add")),
)
OPENVLA_OUT = ("--out", "{results}/openvla_gpu.json")


def command_of(part: Part, results: Path) -> list[str]:
    """What a shell runs."""
    script, *options = part.arguments
    if script == "openvla_gpu.py":
        options += OPENVLA_OUT
    return [sys.executable, str(ROOT / "benchmarks" / script), *(each.format(results=results) for each in options)]


def measure(
    parts: Sequence[Part],
    results: Path,
    seconds: float,
    run: Callable[..., object] = subprocess.run,
    now: Callable[[], float] = time.monotonic,
) -> list[str]:
    """Run the parts, one after the other, within so many seconds; returns what became of each, as sentences."""
    end, said = now() + seconds, []
    for part in parts:
        limit_s = min(part.limit_s, end - now())
        if limit_s < LEAST_S:
            said.append(f"{part.name}: left out, no time was left")
            continue
        print(f"\n{part.name}, at most {limit_s:.0f} s", flush=True)
        begin = now()
        try:
            run(command_of(part, results), cwd=ROOT, timeout=limit_s, check=True)
        except subprocess.TimeoutExpired:
            said.append(f"{part.name}: ended after {limit_s:.0f} s; what it measured until then is kept")
        except subprocess.CalledProcessError as error:
            said.append(f"{part.name}: failed with exit code {error.returncode}")
        else:
            said.append(f"{part.name}: {now() - begin:.0f} s")
    return said


def has_card() -> bool:
    """Whether PyTorch can use a graphics card."""
    try:
        import torch
    except ImportError:
        return False
    return torch.cuda.is_available()


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure everything."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--results", type=Path, default=ROOT / "results")
    options = parser.parse_args(arguments)
    if not has_card():
        print(NO_CARD)
        return
    said = measure(PARTS, options.results.resolve(), options.seconds)
    print("\n" + "\n".join(said))
    if options.results.resolve() == ROOT / "results":
        subprocess.run([sys.executable, str(ROOT / "scripts" / "render_tables.py")], cwd=ROOT, check=False)


if __name__ == "__main__":
    main()
