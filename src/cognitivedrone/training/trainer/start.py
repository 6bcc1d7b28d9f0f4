"""What a training run starts from: a checkpoint, a model file, or the packaged weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from cognitivedrone.errors import ModelError, TrainingError
from cognitivedrone.files import read_regular
from cognitivedrone.files.schema import check_form
from cognitivedrone.models.eyes.sight import EYES_FILE
from cognitivedrone.models.mind import LANGUAGE_FILE
from cognitivedrone.models.onnx_file import LARGEST_BYTES
from cognitivedrone.models.small_file import FORMER, KIND, MODEL_FILE
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of
from cognitivedrone.training.trainer.checkpoint import read_checkpoint

Part = Literal["policy", "language", "reader", "selector"]
_HAS: dict[Part, tuple[Part, ...]] = {"policy": ("language", "reader"), "language": ("reader",)}
SHIPPED = "small"
"""The name of the packaged weights, as in `--start small`."""


@dataclass(frozen=True)
class StartingPoint:
    """Trained weights and what is known of them. Small enough to be handed to other processes by its path."""

    path: Path
    part: Part
    origin: str
    """Where they come from, in words."""
    facts: dict[str, Any]

    def tensors(self) -> dict[str, Tensor]:
        """The weights by name."""
        if self.path.suffix == ".onnx":
            return _weights_of_model(self.path)
        tensors, _ = read_checkpoint(self.path)
        return {name.removeprefix("network."): value for name, value in tensors.items() if name.startswith("network.")}

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

    def encoder(self) -> TextEncoderModel:
        """The text encoder that its language was trained with. Raises `ModelError` if it is not there."""
        digest = self.facts.get("encoder")
        return TextEncoderModel.of_digest(digest, self.path) if digest else TextEncoderModel.load(encoder_of(self.path))

    def language_facts(self) -> dict[str, Any]:
        """Sizes of the language."""
        sizes: dict[str, Any] = self.facts["recipe"]["network"]["language"]
        return sizes


def _part_of(recipe: dict[str, Any]) -> Part:
    if "stream" in recipe:
        return "policy"
    if "language" in recipe.get("network", {}):
        return "language"
    return "selector" if "mix" in recipe else "reader"


@dataclass(frozen=True, slots=True)
class _Recipe:
    name: str
    network: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Facts:
    """What the checkpoint of a part of the networks says."""

    recipe: _Recipe
    step: int
    seed: int
    attributes: tuple[str, ...]
    pieces: tuple[str, ...] = ()


def read_start(path: Path | None, part: Part) -> StartingPoint:
    """A start from a checkpoint or a policy's model file; None, or "small", is the packaged policy.

    A policy has language and reader, and language has a reader. Raises `TrainingError`.
    """
    if path is None or str(path) == SHIPPED:
        path = Path(str(resources.files("cognitivedrone.models") / "weights" / SHIPPED / MODEL_FILE))
    if path.suffix == ".onnx":
        facts = _facts_of_model(path)
        return StartingPoint(path, "policy", f"from {path.name}, {facts['origin']}", facts)
    facts = read_checkpoint(path)[1]
    check_form(_Facts, facts, f"{path}: ", TrainingError)
    found = _part_of(facts["recipe"])
    if found != part and part not in _HAS.get(found, ()):
        raise TrainingError(f"{path}: this is the checkpoint of a {found}; expected that of a {part}")
    origin = f"from {facts['recipe']['name']}, step {facts['step']}, seed {facts['seed']}"
    return StartingPoint(path, found, origin, facts)


def restore_part(start: StartingPoint, part: str, network: nn.Module) -> None:
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


def _weights_of_model(path: Path) -> dict[str, Tensor]:
    """The weights in the ONNX files of a policy, in single precision."""
    import onnx

    from cognitivedrone.training.trainer.eight_bits import weights_in

    found: dict[str, Tensor] = {}
    for file in (path, path.with_name(EYES_FILE), path.with_name(LANGUAGE_FILE)):
        if file.is_file():
            weights = weights_in(onnx.load_model_from_string(read_regular(file, LARGEST_BYTES)))
            found |= {name: torch.from_numpy(values.copy()) for name, values in weights.items()}
    return {name: value.float() if value.is_floating_point() else value for name, value in found.items()}


def _facts_of_model(path: Path) -> dict[str, Any]:
    from cognitivedrone.models.onnx_file import open_model

    try:
        _, table = open_model(path, KIND, threads=1, optimise=False, former=FORMER)
    except ModelError as error:
        raise TrainingError(str(error)) from None
    origin = table["provenance"]
    return {
        "recipe": {"network": table["network"], "name": origin["recipe"]},
        "attributes": table["facets"],
        "encoder": table["encoder"],
        "action": table.get("action"),
        "step": origin["steps"],
        "origin": f"{origin['recipe']} of {origin['trained']}",
        "data": origin["data"],
    }
