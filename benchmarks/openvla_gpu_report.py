"""The tables of `openvla_gpu.py`, printed row by row and kept as Markdown, and the machine that they are of."""

from __future__ import annotations

import gc
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import torch
import transformers

from cognitivedrone.models.openvla.checkpoint import Quantisation
from cognitivedrone.models.openvla.config import Config, tiny_config
from cognitivedrone.models.openvla.network import OpenVlaNetwork
from cognitivedrone.models.openvla.weights import quantise, random_network

FIRST_COLUMN = 44
OTHER_COLUMNS = 14


@dataclass(frozen=True)
class Machine:
    """What is measured on: the 7B in bfloat16 on a GPU, or the tiny network in float32 without one."""

    device: str
    dtype: torch.dtype
    name: str

    @property
    def large(self) -> bool:
        """Whether the sizes are those of the 7B."""
        return self.device == "cuda"

    def network(self, chunk: int | None = None, quantisation: Quantisation = "none") -> OpenVlaNetwork:
        """An OpenVLA with random weights."""
        config = Config(chunk=chunk) if self.large else tiny_config(chunk)
        made = random_network(config, self.device, self.dtype)
        quantise(made.language_model.model.layers, quantisation, self.device)
        return made

    def wait(self) -> None:
        """Wait until the GPU has finished all its work."""
        if self.large:
            torch.cuda.synchronize()

    def forget(self) -> None:
        """Free what is not in use, compiled functions as well, and measure the peak anew."""
        torch.compiler.reset()  # they hold on to the networks that they were compiled for
        gc.collect()
        if self.large:
            torch.cuda.empty_cache()
            torch.cuda.reset_peak_memory_stats()

    def peak(self) -> str:
        """Most memory of the GPU that PyTorch held since `forget`, with what recorded graphs keep for themselves."""
        return f"{torch.cuda.max_memory_reserved() / 1e9:.1f} GB" if self.large else "-"


def find_machine() -> Machine:
    """This machine."""
    if torch.cuda.is_available():
        return Machine("cuda", torch.bfloat16, torch.cuda.get_device_name())
    return Machine("cpu", torch.float32, f"no GPU here ({platform.machine()})")


@dataclass
class Report:
    """Tables, printed as they grow and, where `out` is given, in a Markdown file that is whole after every row."""

    machine: Machine
    out: Path | None = None
    _lines: list[str] = field(default_factory=list)

    def begin(self, command: str) -> None:
        """Say where, when and by what is measured."""
        versions = f"PyTorch {torch.__version__}, Transformers {transformers.__version__}"
        if self.machine.large:
            versions += f", CUDA {torch.version.cuda}"
        self._say(f"{self.machine.name}, {versions}, {datetime.now(UTC):%Y-%m-%d}: `{command}`")
        if not self.machine.large:
            self._say("**The tiny network on the host: that each path runs, and nothing about the 7B.**")

    def table(self, title: str, *columns: str) -> None:
        """Begin a table; its first column names the rows."""
        self._say(f"{title}:")
        print(_aligned(("", *columns)))
        self._lines += ["", f"| | {' | '.join(columns)} |", "|---|" + "---:|" * len(columns)]

    def row(self, *cells: str) -> None:
        """Add a row to the newest table."""
        print(_aligned(cells), flush=True)
        self._lines.append(f"| {' | '.join(cells)} |")
        self._write()

    @contextmanager
    def measuring(self, name: str) -> Iterator[None]:
        """Report a failure in the block as a row: the others must still be measured, often on a rented GPU."""
        self.machine.forget()
        failed = None
        try:
            yield
        except torch.OutOfMemoryError:
            failed = "does not fit"
        except Exception as error:
            failed = f"not measured: {type(error).__name__} {' '.join(str(error).split())[:160]}"
        if failed is not None:
            self.row(name, failed)

    def _say(self, text: str) -> None:
        print(text, flush=True)
        self._lines += ["", text]
        self._write()

    def _write(self) -> None:
        if self.out is not None:
            self.out.write_text("\n".join(self._lines).lstrip() + "\n", encoding="utf-8")


def _aligned(cells: tuple[str, ...]) -> str:
    name, *others = cells
    return f"{name:{FIRST_COLUMN}}" + "".join(f" {cell:>{OTHER_COLUMNS}}" for cell in others)
