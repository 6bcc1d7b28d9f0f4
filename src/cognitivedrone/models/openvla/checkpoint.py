"""A checkpoint's folder, fully checked before anything heavy is loaded.

config.json                    published, or written by `weights.save`
model.safetensors              or several with model.safetensors.index.json
tokenizer.json                 Llama's
preprocessor_config.json       optional: without it, images are prepared as published
dataset_statistics.json        optional: statistics of fine-tuning, beside those in config.json
action_head.safetensors        of the parallel decoder, if config.json has a chunk
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cognitivedrone.errors import ModelError, import_extra
from cognitivedrone.files import open_regular, read_regular
from cognitivedrone.files.schema import check_form
from cognitivedrone.models.openvla.actions import ActionStatistics, Flying, choose_statistics
from cognitivedrone.models.openvla.config import Config, read_config
from cognitivedrone.models.openvla.prepare import ImagePreparation, check_tokenizer, read_preparation
from cognitivedrone.models.openvla.tensors import Shapes, check_tensors, head_tensors, unused_tensors, used_tensors
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import Commands, FloatArray

Quantisation = Literal["none", "int8", "int4"]
DecoderName = Literal["ar", "parallel"]

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
INDEX = "model.safetensors.index.json"
TOKENIZER = "tokenizer.json"
PREPARATION = "preprocessor_config.json"
STATISTICS = "dataset_statistics.json"
HEAD = "action_head.safetensors"
LARGEST_HEADER = 100_000_000
"""Maximum header size that the format allows for the description of a file's tensors, bytes."""
GROUP = 128
"""Number of 4-bit weights that share a scale and a zero."""
BYTES_PER_WEIGHT: dict[Quantisation, float] = {"none": 2.0, "int8": 1.0, "int4": 0.5 + 4 / GROUP}
"""Bytes per weight of a matrix in Llama's layers; scale and zero have 2 bytes each."""
_WORK = 0.04
"""Memory for activations, keys, values and workspaces, as a fraction of the weights."""


class _NotTensors(ModelError):
    """A header of another form."""


@dataclass(frozen=True, slots=True)
class _Tensor:
    """A tensor in the header of a safetensors file."""

    dtype: str
    shape: tuple[int, ...]
    data_offsets: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A checked checkpoint folder."""

    folder: Path
    config: Config
    files: Mapping[str, Path]
    """The file of each tensor of the network, by its published name."""
    head: Path | None
    """The file of the parallel decoder's head."""
    stored_bytes: int
    """Bytes of each number in the files: 2 or 4."""
    statistics_key: str
    statistics: ActionStatistics
    preparation: ImagePreparation
    tokenizer: Path
    flying: Flying = field(default_factory=Flying)
    """Which numbers of an action fly."""

    def flown(self, normalised: FloatArray) -> Commands:
        """The network's outputs (..., width) in [-1, 1] as commands (..., 4), m/s and rad/s."""
        return self.flying.of(self.statistics.flown(normalised))


def inspect(
    folder: Path,
    unnorm_key: str | None = None,
    *,
    given: tuple[str, ActionStatistics] | None = None,
    flying: Flying | None = None,
    tokenizer: Path | None = None,
) -> Checkpoint:
    """A folder's checkpoint, read but for the weights themselves.

    `flying` says which numbers fly where an action has more than four. `tokenizer` is the file, or its folder, where it
    is not beside the weights.
    Statistics are the folder's own, by `unnorm_key`, or `given` with their key: then its own are not looked at.
    Raises `ModelError` for a missing, unreadable or wrong file, a missing, extra or misshapen tensor, statistics that
    are missing, ambiguous or another robot's, and a tokenizer that is not Llama's.
    """
    if not folder.is_dir():
        raise ModelError(f"there is no folder {folder}; give that of an OpenVLA checkpoint, with {CONFIG} in it")
    table = _read_json(folder / CONFIG)
    try:
        config = read_config(table)
        dims = None if flying is None else flying.dims
        key, statistics = given or choose_statistics(_own_statistics(folder, table), unnorm_key, dims)
        words = tokenizer or folder
        words = words / TOKENIZER if words.is_dir() else words
        check_tokenizer(_read_json(words), TOKENIZER)
        beside = words.parent / PREPARATION
        prepared = beside if tokenizer and beside.is_file() else folder / PREPARATION
        preparation = read_preparation(_read_json(prepared)) if prepared.is_file() else ImagePreparation()
    except ModelError as error:
        raise ModelError(f"{folder}: {error}") from None
    shapes, files, stored = _tensors(folder)
    check_tensors(shapes, used_tensors(config), unused_tensors(config), str(folder))
    return Checkpoint(
        folder, config, files, _head(folder, config), stored, key, statistics, preparation, words, flying or Flying()
    )


def needed_bytes(config: Config, quantisation: Quantisation, stored: int = 2) -> int:
    """Memory for inference; `stored` is the number of bytes of each weight that is not quantised."""
    total = 0.0
    for name, shape in (used_tensors(config) | head_tensors(config)).items():
        matrix = len(shape) == 2 and "embed" not in name and name.startswith("language_model.model")
        each = BYTES_PER_WEIGHT[quantisation] if matrix and quantisation != "none" else stored
        total += math.prod(shape) * each
    return round(total * (1 + _WORK))


def check_memory(needed: int, free: int, device: str) -> None:
    """Raises `ModelError` where a network does not fit."""
    if needed <= free:
        return
    way_out = (
        "quantise it (quant=int8 or quant=int4), or close what else runs on the GPU"
        if device == "cuda"
        else "fly it on a machine with a GPU (device=cuda), or fly the small model (--policy small)"
    )
    where = "GPU memory" if device == "cuda" else "memory"
    raise ModelError(f"the network needs {needed / 1e9:.1f} GB of {where}, has {free / 1e9:.1f} GB free; {way_out}")


def check_reading(whole: int, free: int, quantisation: Quantisation) -> None:
    """Raise `ModelError` if the host's memory cannot hold the whole network, which is read before it is quantised."""
    if whole > free:
        raise ModelError(
            f"quant={quantisation}: the whole network is read before it is quantised, and that needs"
            f" {whole / 1e9:.1f} GB of the host's memory, has {free / 1e9:.1f} GB free; close what else runs, or take a"
            " machine with more"
        )


def free_memory() -> int:
    """Bytes of the host's memory available to a new process."""
    return int(import_extra("psutil", "openvla").virtual_memory().available)


def read_header(path: Path) -> dict[str, Any]:
    """The header of a safetensors file, which describes its tensors; raises `ModelError` for an invalid file.

    The format: eight bytes of length (little endian), then JSON with `dtype`, `shape` and `data_offsets` by name.
    """
    try:
        with open_regular(path) as file:
            size = int.from_bytes(file.read(8), "little")
            text = file.read(size) if 2 <= size <= LARGEST_HEADER else b""
            held = os.fstat(file.fileno()).st_size - 8 - size
        header: dict[str, Any] = parse_json(text)
        header.pop("__metadata__", None)
        check_form(dict[str, _Tensor], header, "", _NotTensors)
        end = max((entry["data_offsets"][1] for entry in header.values()), default=0)
    except OSError as error:
        raise ModelError(f"{path}: {error.strerror}") from None
    except (ValueError, TypeError, AttributeError, _NotTensors):
        raise ModelError(f"{path} is not a safetensors file; if it is a pointer of Git LFS, fetch the file") from None
    if held != end:
        raise ModelError(f"{path} is truncated: it holds {held} bytes of tensors, not {end}; copy it again")
    return header


def _own_statistics(folder: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    """Action statistics from the configuration `table`, and from fine-tuning."""
    fine_tuned = _read_json(folder / STATISTICS) if (folder / STATISTICS).is_file() else {}
    published = table.get("norm_stats", {})
    if not isinstance(published, dict):
        raise ModelError(f"{CONFIG}: norm_stats is {type(published).__name__}; it must be an object, by data set")
    return {**published, **fine_tuned}


def _tensors(folder: Path) -> tuple[Shapes, dict[str, Path], int]:
    """Shapes and files of all tensors by published name, and the bytes of each number."""
    index = folder / INDEX
    if index.is_file():
        placed = _read_json(index).get("weight_map")
        if not isinstance(placed, dict) or not placed:
            raise ModelError(f"{index} has no weight_map; copy it again")
        names = sorted({str(name) for name in placed.values()})
    elif (folder / WEIGHTS).is_file():
        names = [WEIGHTS]
    else:
        raise ModelError(f"{folder} has neither {WEIGHTS} nor {INDEX}; download the checkpoint's *.safetensors too")
    if any(Path(name).name != name for name in names):
        raise ModelError(f"{index} names a file outside of its folder; copy it again")
    absent = [name for name in names if not (folder / name).is_file()]
    if absent:
        raise ModelError(f"{folder} lacks {', '.join(absent[:4])}, which its index names; download them too")
    shapes: Shapes = {}
    files: dict[str, Path] = {}
    sizes = {"BF16": 2, "F16": 2, "F32": 4}
    stored = 2
    for name in names:
        for tensor, entry in read_header(folder / name).items():
            if tensor in shapes:
                raise ModelError(f"{folder}: {tensor} is in both {files[tensor].name} and {name}")
            if entry.get("dtype") not in sizes:
                raise ModelError(
                    f"{folder / name}: {tensor} is {entry.get('dtype')}; it should be one of {list(sizes)}"
                )
            stored = max(stored, sizes[entry["dtype"]])
            shapes[tensor] = tuple(entry["shape"])
            files[tensor] = folder / name
    return shapes, files, stored


def _head(folder: Path, config: Config) -> Path | None:
    """The checked file of the parallel decoder's head, if there should be one."""
    if config.chunk is None:
        return None
    path = folder / HEAD
    if not path.is_file():
        raise ModelError(f"{folder} lacks {HEAD}, and its {CONFIG} has chunks of {config.chunk} actions")
    shapes = {name: tuple(entry["shape"]) for name, entry in read_header(path).items()}
    check_tensors(shapes, head_tensors(config), {}, str(path))
    return path


def _read_json(path: Path) -> dict[str, Any]:
    try:
        table = parse_json(read_regular(path, LARGEST_HEADER).decode())
    except OSError as error:
        raise ModelError(f"{path}: {error.strerror}; the folder of a whole OpenVLA checkpoint has it") from None
    except ValueError:
        raise ModelError(f"{path} is not JSON; if it is a pointer of Git LFS, fetch the file") from None
    if not isinstance(table, dict):
        raise ModelError(f"{path} is not a JSON object")
    return table
