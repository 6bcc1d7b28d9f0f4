"""Low-rank adapters (Hu et al. 2021, arXiv 2106.09685) for OpenVLA: insertion, saving, restoring, merging."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from peft import LoraConfig, inject_adapter_in_model
from peft.tuners.lora import LoraLayer
from torch import Tensor, nn
from torch.distributed.tensor import DTensor, distribute_tensor

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.openvla.network import OpenVlaNetwork
from cognitivedrone.training.openvla.recipes import LoraRecipe
from cognitivedrone.training.trainer.checkpoint import MOMENTS, check_moments


def add_adapters(network: OpenVlaNetwork, recipe: LoraRecipe, seed: int = 0) -> dict[str, nn.Parameter]:
    """Add adapters to every linear layer, and freeze everything else; returns the trained weights (float32) by name.

    As in the published fine-tuning, the output layer and the patch convolutions count as linear, and an adapter's
    input matrix is initialised normally, its output matrix with zeros. In bfloat16 the network is to be run under
    autocast, as it is trained.
    """
    names = [name for name, module in network.named_modules() if isinstance(module, nn.Linear | nn.Conv2d)]
    torch.manual_seed(seed)
    inject_adapter_in_model(
        LoraConfig(r=recipe.rank, lora_alpha=recipe.alpha, target_modules=names, init_lora_weights="gaussian"), network
    )
    trained = {name: value for name, value in network.named_parameters() if value.requires_grad}
    for value in trained.values():
        value.data = value.data.float()
    cast_inputs(network, enabled=False)
    return trained


def cast_inputs(network: nn.Module, *, enabled: bool) -> None:
    """Whether adapters make a float32 copy of their inputs, as PEFT does by default.

    Autocast makes bfloat16 of it at once: the same numbers, but a copy for each adapter, kept for the backward pass.
    """
    for module in network.modules():
        if isinstance(module, LoraLayer):
            module.cast_input_dtype_enabled = enabled


def merge_adapters(network: OpenVlaNetwork) -> None:
    """Merge the adapters into their layers, which become plain layers again."""
    for name, module in list(network.named_modules()):
        if isinstance(module, LoraLayer):
            module.merge()
            parent, _, child = name.rpartition(".")
            setattr(network.get_submodule(parent), child, module.get_base_layer())


def state_of(optimizer: Any, names: list[str]) -> dict[str, Tensor]:
    """Adapters and moments by name, unsharded; every process must call this, because each may hold a part."""
    state: dict[str, Tensor] = {}
    for name, value in zip(names, _trained(optimizer), strict=True):
        state[f"adapter.{name}"] = _whole(value)
        state |= {f"{moment}.{name}": _whole(held) for moment, held in optimizer.state[value].items()}
    return state


def as_module(state: dict[str, Tensor]) -> nn.Module:
    """The result of `state_of` as a module, whose names may not contain dots."""
    return nn.ParameterDict({name.replace(".", "/"): value for name, value in state.items()})


def take_adapters(trained: dict[str, nn.Parameter], tensors: dict[str, Tensor]) -> None:
    """Load a checkpoint's adapters into the result of `add_adapters`, before sharding.

    Raises `TrainingError` where one is missing, of another shape, or not finite.
    """
    for name, value in trained.items():
        held = tensors.get(_stored(f"adapter.{name}"))
        if held is None or held.shape != value.shape or not bool(torch.isfinite(held).all()):
            raise TrainingError(f"the checkpoint has no usable adapter {name}; train anew in another folder")
        value.data.copy_(held)


def take_moments(optimizer: Any, names: list[str], tensors: dict[str, Tensor]) -> None:
    """Load a checkpoint's moments into an optimiser of the same adapters, after sharding, if any.

    Raises `TrainingError` for moments that the optimiser cannot have.
    """
    for name, value in zip(names, _trained(optimizer), strict=True):
        stored = {moment: _stored(f"{moment}.{name}") for moment in MOMENTS}
        moments = {moment: tensors[place] for moment, place in stored.items() if place in tensors}
        check_moments(name, value, moments)
        for moment, whole in moments.items():
            held = whole.to(value.device)
            if isinstance(value, DTensor) and held.ndim:
                held = distribute_tensor(held, value.device_mesh, value.placements)
            optimizer.state[value][moment] = held


def _trained(optimizer: Any) -> Iterator[Tensor]:
    return (value for group in optimizer.param_groups for value in group["params"])


def _whole(value: Tensor) -> Tensor:
    if isinstance(value, DTensor):
        value = value.full_tensor()
    return value.detach()


def _stored(name: str) -> str:
    """Name of a tensor in a checkpoint of `as_module`."""
    return "network." + name.replace(".", "/")
