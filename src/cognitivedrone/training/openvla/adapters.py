"""What a fine-tuning of OpenVLA starts from and adds: the base checkpoint, the check of the machine's memory before it
is loaded, and low-rank adapters (Hu et al. 2021, arXiv 2106.09685): insertion, saving, restoring, merging.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from peft import LoraConfig, inject_adapter_in_model
from peft.tuners.lora import LoraLayer
from torch import Tensor, nn
from torch.distributed.tensor import DTensor, distribute_tensor

from cognitivedrone.errors import TrainingError
from cognitivedrone.files import open_regular
from cognitivedrone.models.compiling import why_none
from cognitivedrone.models.openvla.actions import ActionStatistics
from cognitivedrone.models.openvla.checkpoint import Checkpoint, inspect
from cognitivedrone.models.openvla.config import IMAGE, PATCHES, Config
from cognitivedrone.models.openvla.network import OpenVlaNetwork
from cognitivedrone.models.openvla.tensors import elements, used_tensors
from cognitivedrone.training.openvla.recipes import LoraRecipe
from cognitivedrone.training.trainer.checkpoint import MOMENTS, check_moments

BYTES_PER_TRAINED = 16
"""Bytes per trained number: the adapter's number, its gradient and two moments, in float32."""
WORKSPACE = 1_500_000_000
"""Bytes of a GPU used by PyTorch and its libraries."""
SMALL = 2_000_000_000
"""Maximum bytes of a network that is fine-tuned without a GPU."""
USUAL_MICRO_BATCH = 8
"""Samples at once where nothing else is known, and on the host."""
KEPT_SHARE = 0.45
"""Activations that are really kept, as a share of the sum over all layers, and a fifth more: on an H100 every further
sample took 2.8 GB of 7.6 (`results/openvla_gpu.json`; sizes 1 to 16)."""
FASTEST = (
    *((size, False) for size in (64, 32, 16, 8)),
    *((size, True) for size in (32, 16)),
    (4, False),
    *((size, True) for size in (8, 4)),
    *((size, False) for size in (2, 1)),
    *((size, True) for size in (2, 1)),
)
"""Samples at once, and whether layers are recomputed: the fastest first, as measured in the same file."""
_TEXT = 64  # tokens of prompt and answer, somewhat more than an instruction has
_TAIL = 2**20  # bytes at the end of a file that distinguish it from another of the same shapes


def read_base(folder: Path, key: str, statistics: ActionStatistics) -> Checkpoint:
    """The checkpoint in `folder`, to be fine-tuned for `statistics`: its own, of arms as a rule, are not looked at.

    A head of the parallel decoder is left out, for it would not fit the fine-tuned network. Raises `ModelError` as
    `inspect` does.
    """
    found = inspect(folder, given=(key, statistics))
    return replace(found, config=replace(found.config, chunk=None), head=None)


def fingerprint(base: Checkpoint) -> str:
    """Identity of a base without reading all of it: from its sizes and the ends of its files."""
    digest = hashlib.sha256(repr(base.config).encode())
    for path in sorted(set(base.files.values())):
        size = path.stat().st_size
        digest.update(f"{path.name} {size}".encode())
        with open_regular(path) as file:
            file.seek(max(size - _TAIL, 0))
            digest.update(file.read())
    return digest.hexdigest()[:16]


def trained_weights(config: Config, rank: int) -> int:
    """Number of weights in adapters of that rank on every linear layer and on both towers' first convolution."""
    total = 0
    for name, shape in used_tensors(config).items():
        if len(shape) == 4 or (len(shape) == 2 and "embed_tokens" not in name):
            total += rank * (shape[0] + elements([shape[1:]]))
    return total


def needed_bytes(
    config: Config, recipe: LoraRecipe, processes: int = 1, *, stored: int = 2, sharded: bool = False
) -> int:
    """Memory that fine-tuning needs on each GPU: a conservative estimate from the shapes.

    Weights of `stored` bytes each; adapters with gradients and moments; activations of a micro-batch: the inputs of
    every layer, and the activations inside one (inside all, if `checkpointing` is False). For sharding, all weights
    must briefly be on one GPU.
    """
    language = config.language
    weights = elements(used_tensors(config).values()) * stored
    held = weights + trained_weights(config, recipe.rank) * BYTES_PER_TRAINED
    if sharded:  # a part of everything, and one complete layer
        held = held // processes + held // language.num_hidden_layers
    tokens = PATCHES + _TEXT
    stacks = [(tower.width, tower.hidden, tower.depth) for tower in (config.dino, config.siglip)]
    stacks.append((language.hidden_size, 2 * language.intermediate_size, language.num_hidden_layers))
    # Twice as much as a plain layer keeps: measured while adapters still made float32 copies of their inputs.
    inside = [tokens * (24 * width + 8 * hidden) * stored for width, hidden, _ in stacks]
    if recipe.checkpointing is not False:
        sample = sum(tokens * width * stored * depth for width, _, depth in stacks) + max(inside)
    else:
        sample = int(KEPT_SHARE * sum(one * depth for one, (_, _, depth) in zip(inside, stacks, strict=True)))
    micro = min(recipe.micro_batch or USUAL_MICRO_BATCH, max(recipe.batch // processes, 1))
    return max(weights, held + micro * (sample + 6 * IMAGE**2 * 4))


def fitted(
    base: Checkpoint, recipe: LoraRecipe, processes: int, free: int, device: str, *, sharded: bool
) -> LoraRecipe:
    """The recipe with the fastest way that fits: samples at once, and whether layers are recomputed.

    What the recipe says of them stays. `free` is the free memory of the fullest GPU, or of the host, in bytes. Raises
    `TrainingError` like `check_machine` if none fits.
    """
    spare, share = WORKSPACE if device == "cuda" else 0, max(recipe.batch // processes, 1)
    size = recipe.micro_batch or USUAL_MICRO_BATCH
    ways = FASTEST if recipe.micro_batch is None and device == "cuda" else ((size, False), (size, True))
    for size, recompute in ways:
        if recipe.checkpointing not in (None, recompute):
            continue
        made = replace(recipe, micro_batch=min(size, share), checkpointing=recompute)
        needed = needed_bytes(base.config, made, processes, stored=base.stored_bytes, sharded=sharded)
        if needed + spare <= free:
            break
    check_machine(needed, free, device, base.folder)
    return made


def check_machine(needed: int, free: int, device: str, folder: Path) -> None:
    """Raise `TrainingError` if a fine-tuning that needs this many bytes does not fit, or there is no GPU for it."""
    if device == "cuda":
        needed += WORKSPACE
    needs = f"fine-tuning {folder} needs {needed / 1e9:.1f} GB"
    if device == "cpu" and needed > SMALL:
        raise TrainingError(
            f"{needs} of GPU memory, and this machine has no GPU that PyTorch can use; train on one that has"
            f"{why_none(torch)}"
        )
    if needed > free:
        way_out = "take a smaller --micro-batch, or several GPUs and --shard" if device == "cuda" else "close what runs"
        raise TrainingError(f"{needs} of {'GPU ' * (device == 'cuda')}memory, has {free / 1e9:.1f} GB free; {way_out}")


def check_merging(needed: int, free: int, folder: Path) -> None:
    """Raise `TrainingError` if the host cannot hold the network for merging a run's adapters."""
    if needed > free:
        raise TrainingError(
            f"merging {folder} needs {needed / 1e9:.1f} GB of the host's memory, has {free / 1e9:.1f} GB free; nothing"
            " is lost: close what runs, or copy the folder to a machine with more and run it there with --merge"
        )


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
