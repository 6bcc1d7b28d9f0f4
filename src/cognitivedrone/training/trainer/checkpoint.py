"""Checkpoints without pickle: tensors as safetensors, the rest as JSON in the same file's header."""

from __future__ import annotations

import json
import mmap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from cognitivedrone.errors import TrainingError
from cognitivedrone.files import check_regular, open_regular, reason_of, replacing
from cognitivedrone.files.schema import check_form
from cognitivedrone.models.checksum import BLANK, Finding, check, seal
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.text.printable import visible

CHECKPOINT = "checkpoint.safetensors"
"""Name of the file in the folder of a run."""
FORMAT = 1
_KEY = "cognitivedrone"
_ANEW = "take an earlier checkpoint, or train anew in another folder"
MOMENTS = {"step": True, "exp_avg": False, "exp_avg_sq": True}
"""What AdamW has of each weight, and whether it is never below 0."""


def save_checkpoint(
    path: Path, network: nn.Module, optimizer: torch.optim.Optimizer | None, facts: dict[str, Any]
) -> None:
    """Write the network, the optimiser's state if given, and `facts` (JSON values), atomically."""
    tensors = {f"network.{name}": tensor for name, tensor in network.state_dict().items()}
    if optimizer is not None:
        for number, state in optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{number}.{name}": value for name, value in state.items()}
    whole = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    with replacing(path) as beside:
        save_file(whole, beside, metadata={_KEY: json.dumps({"format": FORMAT, **facts}), "checksum": BLANK})
        seal(beside)


def read_checkpoint(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """All tensors by name, and the facts.

    Raises `TrainingError` for an incomplete file, one of another format, or one that does not match its checksum; older
    files have no checksum.
    """
    try:
        check_regular(path)
        finding = _finding(path)
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            if finding == "damaged" or (finding == "unknown" and "checksum" in metadata):
                raise TrainingError(
                    f"{path}: not a whole checkpoint (it does not match its checksum); delete it or take an earlier one"
                )
            facts = parse_json(metadata[_KEY])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a mapping)
    except FileNotFoundError:
        raise TrainingError(f"{path}: no such checkpoint") from None
    except OSError as error:
        reason = reason_of(error)
        raise TrainingError(f"{path}: not a whole checkpoint ({reason}); delete it or take an earlier one") from None
    except SafetensorError as error:
        raise TrainingError(f"{path}: not a whole checkpoint ({error}); delete it or take an earlier one") from None
    except (KeyError, TypeError, ValueError):
        raise TrainingError(f"{path}: a safetensors file, but not a checkpoint of this project") from None
    if not isinstance(facts, dict) or facts.get("format") != FORMAT or isinstance(facts["format"], bool):
        found = facts.get("format") if isinstance(facts, dict) else "unknown"
        raise TrainingError(f"{path}: checkpoint of format {found}; this version reads {FORMAT}")
    check_form(_Facts, facts, f"{path}: ", TrainingError)
    return tensors, facts


@dataclass(frozen=True, slots=True)
class _Facts:
    """What every checkpoint says."""

    step: int


def _finding(path: Path) -> Finding:
    if not path.stat().st_size:
        return "unknown"  # safetensors reports the error of an empty file
    with open_regular(path) as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return check(content)


def restore(tensors: dict[str, Tensor], network: nn.Module, optimizer: torch.optim.Optimizer | None) -> None:
    """Restore a network and an AdamW of the same shapes from the result of `read_checkpoint`.

    Raises `TrainingError` for another network, and for a state that such an optimiser cannot have.
    """
    own = {name.removeprefix("network."): value for name, value in tensors.items() if name.startswith("network.")}
    try:
        network.load_state_dict(own)
    except RuntimeError as error:
        raise TrainingError(f"the checkpoint is of another network: {str(error).splitlines()[-1].strip()}") from None
    if optimizer is None:
        return
    weights = [weight for group in optimizer.param_groups for weight in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, number, key = (*name.split(".", 2), "", "")[:3]
            if not (number.isdecimal() and number.isascii() and len(number) < 10 and int(number) < len(weights)):
                raise TrainingError(f"the checkpoint has {visible(name)!r}, which is of no weight; {_ANEW}")
            state.setdefault(int(number), {})[key] = value
    for index, moments in state.items():
        check_moments(f"optimizer.{index}", weights[index], moments)
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
    # Fused optimisers iterate over memory, so moments need the same layout as their weights: channels last, for some.
    for parameter, moments in optimizer.state.items():
        for key, value in moments.items():
            if value.shape == parameter.shape:
                moments[key] = torch.empty_like(parameter, requires_grad=False).copy_(value)


def check_moments(where: str, weight: Tensor, moments: dict[str, Tensor]) -> None:
    """Raise `TrainingError` for what AdamW cannot have of a weight: one step with it would spoil the network."""
    if moments.keys() != MOMENTS.keys():
        found = ", ".join(visible(key) or "a nameless tensor" for key in sorted(moments))
        raise TrainingError(f"the checkpoint's {where} has {found}, not {', '.join(MOMENTS)}; {_ANEW}")
    for key, value in moments.items():
        shape = () if key == "step" else weight.shape
        if value.shape != shape or not value.is_floating_point():
            raise TrainingError(
                f"the checkpoint's {where}.{key} is {tuple(value.shape)} of {value.dtype}, not {tuple(shape)} of"
                f" floats; {_ANEW}"
            )
        if not bool(torch.isfinite(value).all()) or (MOMENTS[key] and bool((value < 0).any())):
            raise TrainingError(f"the checkpoint's {where}.{key} has impossible numbers; {_ANEW}")


def step_of(facts: Mapping[str, Any], last: int) -> int:
    """The step that a checkpoint was written at, at most `last`; raises `TrainingError` if that cannot be."""
    step = facts.get("step")
    if not isinstance(step, int) or isinstance(step, bool) or not 0 <= step <= last:
        raise TrainingError(f"the checkpoint is of step {str(step)[:20]!r}, not one from 0 to {last}; {_ANEW}")
    return step


def origin_of(facts: dict[str, Any]) -> str:
    """A description of the origin of a training run that starts from a checkpoint with these facts."""
    return f"from {facts['recipe']['name']}, step {facts['step']}, seed {facts['seed']}"
