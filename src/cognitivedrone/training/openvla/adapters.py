"""Low-rank adapters (Hu et al. 2021, arXiv 2106.09685) on an OpenVLA: put in, kept, restored, merged."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from peft import LoraConfig, inject_adapter_in_model
from peft.tuners.lora import LoraLayer
from torch import Tensor, nn
from torch.distributed.tensor import DTensor, distribute_tensor

from cognitivedrone.models.openvla.network import OpenVlaNetwork
from cognitivedrone.training.openvla.recipes import LoraRecipe


def add_adapters(network: OpenVlaNetwork, recipe: LoraRecipe, seed: int = 0) -> dict[str, nn.Parameter]:
    """Put adapters on every linear layer, and freeze all else; returns the trained weights (float32) by name.

    As in the published fine-tuning, the layer that scores words and the convolutions that read patches count as linear,
    and an adapter begins with normal numbers on its way in and zeros on its way out.
    """
    names = [name for name, module in network.named_modules() if isinstance(module, nn.Linear | nn.Conv2d)]
    torch.manual_seed(seed)
    inject_adapter_in_model(
        LoraConfig(r=recipe.rank, lora_alpha=recipe.alpha, target_modules=names, init_lora_weights="gaussian"), network
    )
    trained = {name: value for name, value in network.named_parameters() if value.requires_grad}
    for value in trained.values():
        value.data = value.data.float()
    return trained


def merge_adapters(network: OpenVlaNetwork) -> None:
    """Add the adapters to the layers that they stand on, which become plain layers again."""
    for name, module in list(network.named_modules()):
        if isinstance(module, LoraLayer):
            module.merge()
            parent, _, child = name.rpartition(".")
            setattr(network.get_submodule(parent), child, module.get_base_layer())


def state_of(optimizer: Any, names: list[str]) -> dict[str, Tensor]:
    """Adapters and moments by name, whole; every process calls this, for where weights are sharded each has a part."""
    state: dict[str, Tensor] = {}
    for name, value in zip(names, _trained(optimizer), strict=True):
        state[f"adapter.{name}"] = _whole(value)
        state |= {f"{moment}.{name}": _whole(held) for moment, held in optimizer.state[value].items()}
    return state


def as_module(state: dict[str, Tensor]) -> nn.Module:
    """What `state_of` gave, as something with a state: modules allow no dots in names."""
    return nn.ParameterDict({name.replace(".", "/"): value for name, value in state.items()})


def take_adapters(trained: dict[str, nn.Parameter], tensors: dict[str, Tensor]) -> None:
    """Put a checkpoint's adapters into what `add_adapters` gave, before anything is sharded."""
    for name, value in trained.items():
        value.data.copy_(tensors[_stored(f"adapter.{name}")])


def take_moments(optimizer: Any, names: list[str], tensors: dict[str, Tensor]) -> None:
    """Put a checkpoint's moments into an optimiser of the same adapters, after weights are sharded, if they are."""
    for name, value in zip(names, _trained(optimizer), strict=True):
        for moment in ("step", "exp_avg", "exp_avg_sq"):
            held = tensors[_stored(f"{moment}.{name}")].to(value.device)
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
    """Of a tensor in a checkpoint of `as_module`."""
    return "network." + name.replace(".", "/")
