"""What a training run starts from: a checkpoint, a model file, or the packaged weights."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from cognitivedrone.errors import ModelError, TrainingError
from cognitivedrone.models.reasoner_file import SELECTOR, SELECTOR_FILE
from cognitivedrone.models.small_file import KIND
from cognitivedrone.training.common.checkpoint import origin_of, read_checkpoint

Part = Literal["policy", "reader", "selector"]
SHIPPED = "small"
"""The name of the packaged weights, as in `--start small`."""
_FILES = {"policy": "small.onnx", "reader": "small.onnx", "selector": f"reasoner/{SELECTOR_FILE}"}
_KINDS = {"policy": KIND, "reader": KIND, "selector": SELECTOR}


@dataclass(frozen=True)
class Start:
    """Trained weights and what is known of them. Small enough to be handed to other processes by its path."""

    path: Path
    part: Part
    origin: str
    """Where they come from, in words."""
    facts: dict[str, Any]

    def tensors(self) -> dict[str, Tensor]:
        """The weights by name."""
        return _weights(self.path)

    def reader_facts(self) -> dict[str, Any]:
        """Sizes of the panel reader. Raises `TrainingError` if there is none."""
        network: dict[str, Any] = self.facts["recipe"]["network"]
        sizes: dict[str, Any] | None = network if self.part == "reader" else network["reader"]
        if sizes is None:
            raise TrainingError(f"{self.path}: this policy has no panel reader; start from one that reads panels")
        return sizes

    def restore(self, network: nn.Module) -> None:
        """Load all weights. Raises `TrainingError` where the network is another one."""
        _load(self.path, network, self.tensors())


def read_start(path: Path | None, part: Part) -> Start:
    """A start from a checkpoint or a model file; None, or "small", is the packaged file of that part.

    A policy has a reader as well. Raises `TrainingError`.
    """
    if path is None or str(path) == SHIPPED:
        path = Path(str(resources.files("cognitivedrone.models") / "weights" / _FILES[part]))
    if path.suffix == ".onnx":
        facts = _facts_of_model(path, part)
        return Start(
            path, "selector" if part == "selector" else "policy", f"from {path.name}, {facts['origin']}", facts
        )
    facts = read_checkpoint(path)[1]
    if "attributes" not in facts:
        raise TrainingError(f"{path}: the checkpoint is of an earlier version of the networks; train it again")
    found: Part = "policy" if "stream" in facts["recipe"] else "selector" if "mix" in facts["recipe"] else "reader"
    if found != part and (found, part) != ("policy", "reader"):
        raise TrainingError(f"{path}: this is the checkpoint of a {found}; expected that of a {part}")
    return Start(path, found, origin_of(facts), facts)


def restore_part(start: Start, part: str, network: nn.Module) -> None:
    """Load a part of another network, such as the reader of a policy. Raises `TrainingError`."""
    tensors = start.tensors()
    prefix = f"{part}."
    own = {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
    _load(start.path, network, own or tensors)


def _load(path: Path, network: nn.Module, tensors: dict[str, Tensor]) -> None:
    # Model files hold what flying needs: not how often batch statistics were updated.
    kept = {name: value for name, value in network.state_dict().items() if not name.endswith("num_batches_tracked")}
    try:
        network.load_state_dict({name: tensors[name].to(value.dtype) for name, value in kept.items()}, strict=False)
    except (KeyError, RuntimeError) as error:
        reason = str(error).splitlines()[-1].strip()
        raise TrainingError(f"{path}: its weights are those of another network ({reason})") from None


def _weights(path: Path) -> dict[str, Tensor]:
    if path.suffix == ".onnx":
        return _weights_of_model(path)
    tensors, _ = read_checkpoint(path)
    return {name.removeprefix("network."): value for name, value in tensors.items() if name.startswith("network.")}


def _weights_of_model(path: Path) -> dict[str, Tensor]:
    """The weights in an ONNX file, in single precision."""
    import onnx

    model = onnx.load(str(path))
    found = {}
    for tensor in model.graph.initializer:
        value = torch.from_numpy(onnx.numpy_helper.to_array(tensor).copy())
        name = tensor.name.removesuffix(".half")
        found[name] = value.float() if value.is_floating_point() else value
    return found


def _facts_of_model(path: Path, part: Part) -> dict[str, Any]:
    from cognitivedrone.models.onnx_file import open_model

    try:
        _, table = open_model(path, _KINDS[part], threads=1, optimise=False)
    except ModelError as error:
        raise TrainingError(str(error)) from None
    if "network" not in table:
        raise TrainingError(f"{path} was written by an earlier version and cannot be trained further; train it again")
    origin = table["provenance"]
    return {
        "recipe": {"network": table["network"], "name": origin["recipe"]},
        "attributes": table["facets"],
        "vocabulary": table.get("vocabulary"),
        "trained_words": table.get("trained_words"),
        "action": table.get("action"),
        "step": origin["steps"],
        "origin": f"{origin['recipe']} of {origin['trained']}",
        "data": origin["data"],
    }
