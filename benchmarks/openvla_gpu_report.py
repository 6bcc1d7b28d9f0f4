"""The tables of `openvla_gpu.py`, printed row by row and kept in a file of results, and the machine they are of."""

from __future__ import annotations

import gc
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch
import transformers

from cognitivedrone.benchmark.measurements import machine_of, measurement, read_measurement, write_measurement
from cognitivedrone.benchmark.runs.job import platform_facts
from cognitivedrone.models.openvla.checkpoint import Quantisation
from cognitivedrone.models.openvla.config import Config, tiny_config
from cognitivedrone.models.openvla.network import OpenVlaNetwork
from cognitivedrone.models.openvla.weights import fuse, quantise, random_network

FIRST_COLUMN = 44
OTHER_COLUMNS = 14
TINY = "The tiny network on the host: that each path runs, and nothing about the 7B"


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

    def network(
        self, chunk: int | None = None, quantisation: Quantisation = "none", *, fused: bool = False
    ) -> OpenVlaNetwork:
        """An OpenVLA with random weights, for flying with fused products."""
        config = Config(chunk=chunk) if self.large else tiny_config(chunk)
        made = random_network(config, self.device, self.dtype)
        if fused:
            fuse(made.language_model.model.layers)
        quantise(made.language_model.model.layers, quantisation, self.device)
        return made

    @property
    def compiler(self) -> str:
        """The compiler of blocks: on the host, one that runs what was traced."""
        return "inductor" if self.large else "eager"

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
    """Tables, printed as they grow and, where `out` is given, in a file of results that is whole after every row."""

    machine: Machine
    out: Path | None = None
    add: bool = False
    """Whether the rows of an earlier run on this machine stay in the file, but for those that are measured again."""
    _command: str = ""
    _title: str = ""
    _columns: tuple[str, ...] = ()
    _rows: list[dict[str, Any]] = field(default_factory=list)

    def begin(self, command: str) -> None:
        """Say where, when and by what is measured."""
        self._command = command
        if self.add and self.out is not None and self.out.is_file():
            before = read_measurement(self.out)
            if before.machine == self._where() and before.date == f"{datetime.now(UTC):%Y-%m-%d}":
                self._rows = [dict(row) for row in before.rows]
        versions = ", ".join(f"{name} {version}" for name, version in self._versions().items())
        print(f"{self.machine.name}, {versions}, {datetime.now(UTC):%Y-%m-%d}: {command}")
        if not self.machine.large:
            print(f"{TINY}.")

    def table(self, title: str, *columns: str) -> None:
        """Begin a table; its first column names the rows."""
        self._title, self._columns = title, columns
        print(f"{title}:")
        print(_aligned(("", *columns)))

    def row(self, name: str, *cells: str) -> None:
        """Add a row to the newest table."""
        print(_aligned((name, *cells)), flush=True)
        made = {"table": self._title, "row": name, **dict(zip(self._columns, cells, strict=False))}
        self._rows = [row for row in self._rows if (row["table"], row["row"]) != (self._title, name)] + [made]
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

    def _versions(self) -> dict[str, str]:
        cuda = {"cuda": str(torch.version.cuda)} if self.machine.large else {}
        return {"torch": torch.__version__, "transformers": transformers.__version__, **cuda}

    def _where(self) -> str:
        return f"{self.machine.name}, {machine_of(platform_facts(self._command))}"

    def _write(self) -> None:
        if self.out is not None:
            made = measurement("OpenVLA-7B with random weights on a GPU", self._command, self._rows, seed=0)
            note = "" if self.machine.large else TINY
            made = replace(made, machine=self._where(), versions={**made.versions, **self._versions()}, note=note)
            write_measurement(self.out, made)


def _aligned(cells: tuple[str, ...]) -> str:
    name, *others = cells
    return f"{name:{FIRST_COLUMN}}" + "".join(f" {cell:>{OTHER_COLUMNS}}" for cell in others)
