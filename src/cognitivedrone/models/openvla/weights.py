"""Tensors from a checkpoint's files to a network, and back; weight-only quantisation."""

from __future__ import annotations

import importlib
import importlib.util
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from transformers.models.llama.modeling_llama import apply_rotary_pos_emb

from cognitivedrone.errors import MissingExtra
from cognitivedrone.files import read_regular, replace_file
from cognitivedrone.models.openvla.actions import ActionStatistics
from cognitivedrone.models.openvla.checkpoint import (
    CONFIG,
    GROUP,
    HEAD,
    INDEX,
    LARGEST_HEADER,
    PREPARATION,
    TOKENIZER,
    WEIGHTS,
    Checkpoint,
    Quantisation,
)
from cognitivedrone.models.openvla.config import Config, write_config
from cognitivedrone.models.openvla.network import OpenVlaNetwork
from cognitivedrone.models.openvla.tensors import head_tensors, own_name, published_name, used_tensors

HEAD_PREFIX = "action_head."
SHARD_BYTES = 5_000_000_000
"""Maximum size of a file that `save` writes."""


def empty_network(config: Config) -> OpenVlaNetwork:
    """A network without memory for its weights, on the meta device."""
    with torch.device("meta"):
        return OpenVlaNetwork(config)


def random_network(
    config: Config, device: str | torch.device = "cpu", dtype: torch.dtype = torch.float32, seed: int = 0
) -> OpenVlaNetwork:
    """A network with small random weights, created on its device, for tests and benchmarks."""
    network = empty_network(config).to(dtype).to_empty(device=device)
    generator = torch.Generator(device).manual_seed(seed)
    with torch.no_grad():
        for name, values in network.named_parameters():
            if name.endswith(".bias"):
                values.zero_()
            elif values.ndim == 1:  # factors of norms and scales
                values.fill_(1.0)
            else:
                values.normal_(std=0.02, generator=generator)
    _give_rotation(network, device)
    return network.eval()


def load(
    checkpoint: Checkpoint,
    device: str | torch.device,
    dtype: torch.dtype,
    quantisation: Quantisation = "none",
    *,
    fused: bool = False,
) -> OpenVlaNetwork:
    """The network of a checkpoint, loaded directly to its device, with one copy of each tensor.

    Do not cast it afterwards: the rotary frequencies stay in float32. A network to be quantised is read on the host,
    and each layer moves once quantised. One that is `fused` is for flying alone: see `fuse`.
    Raises `MissingExtra` for quantisation without torchao.
    """
    reading = torch.device("cpu") if quantisation != "none" else torch.device(device)
    network = empty_network(checkpoint.config)
    wanted = used_tensors(checkpoint.config)
    state: dict[str, Tensor] = {}
    for path in sorted(set(checkpoint.files.values())):
        names = [name for name in wanted if checkpoint.files[name] == path]
        state |= {own_name(name): value for name, value in _read(path, names, reading, dtype).items()}
    if checkpoint.head is not None:
        head = _read(checkpoint.head, list(head_tensors(checkpoint.config)), reading, dtype)
        state |= {HEAD_PREFIX + name: value for name, value in head.items()}
    network.load_state_dict(state, strict=True, assign=True)
    state.clear()  # what is joined is not to be held twice
    network.eval()
    if fused:
        fuse(network.language_model.model.layers)
    quantise(network.language_model.model.layers, quantisation, device)
    _give_rotation(network, device)
    return network.to(device)


def save(network: OpenVlaNetwork, folder: Path, statistics: Mapping[str, ActionStatistics], base: Path) -> None:
    """Write a checkpoint that `checkpoint.inspect` accepts, with the published names.

    `base` is the folder whose tokenizer and image preparation it shares. Unused tensors are omitted.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in (TOKENIZER, PREPARATION):
        if (base / name).is_file() and base.resolve() != folder.resolve():
            replace_file(folder / name, read_regular(base / name, LARGEST_HEADER))
    everything = {name: value.detach().contiguous().cpu() for name, value in network.state_dict().items()}
    head = {
        name.removeprefix(HEAD_PREFIX): everything.pop(name)
        for name in list(everything)
        if name.startswith(HEAD_PREFIX)
    }
    if head:
        save_file(head, folder / HEAD)
    _save_sharded({published_name(name): value for name, value in everything.items()}, folder)
    table = write_config(network.config, {key: {"action": values.to_json()} for key, values in statistics.items()})
    replace_file(folder / CONFIG, f"{json.dumps(table, indent=2)}\n".encode())


def quantise(layers: nn.Module, quantisation: Quantisation, device: str | torch.device) -> None:
    """Quantise the weight matrices of a language model's layers, on `device`; activations stay unquantised.

    OpenVLA's towers, projector and embeddings keep their precision: they are a seventh of the weights.
    Raises `MissingExtra` if torchao is not installed (0.14 or newer, for 4 bits).
    """
    if quantisation == "none":
        return
    if importlib.util.find_spec("torchao") is None:
        raise MissingExtra("torchao", "openvla")
    library: Any = importlib.import_module("torchao.quantization")
    if quantisation == "int8":
        config = library.Int8WeightOnlyConfig()
    else:  # the packing whose multiplication comes with PyTorch; others need one more library
        config = library.Int4WeightOnlyConfig(group_size=GROUP, int4_packing_format="tile_packed_to_4d")
    library.quantize_(layers, config, device=device)


def _read(path: Path, names: list[str], device: torch.device, dtype: torch.dtype) -> dict[str, Tensor]:
    with safe_open(str(path), framework="pt", device=str(device)) as file:
        return {name: file.get_tensor(name).to(dtype) for name in names}


def _save_sharded(tensors: dict[str, Tensor], folder: Path) -> None:
    """One file, or several of at most `SHARD_BYTES` and their index."""
    shards: list[dict[str, Tensor]] = [{}]
    held = 0
    for name, value in tensors.items():
        if shards[-1] and held + value.nbytes > SHARD_BYTES:
            shards.append({})
            held = 0
        shards[-1][name] = value
        held += value.nbytes
    metadata = {"format": "pt"}
    if len(shards) == 1:
        save_file(tensors, folder / WEIGHTS, metadata)
        return
    placed: dict[str, str] = {}
    for number, shard in enumerate(shards, 1):
        file = f"model-{number:05d}-of-{len(shards):05d}.safetensors"
        save_file(shard, folder / file, metadata)
        placed |= dict.fromkeys(shard, file)
    index = {"metadata": {"total_size": sum(value.nbytes for value in tensors.values())}, "weight_map": placed}
    replace_file(folder / INDEX, f"{json.dumps(index, indent=2)}\n".encode())


def _give_rotation(network: OpenVlaNetwork, device: str | torch.device) -> None:
    """Set the rotary embedding's frequencies: no file has them, and they are not computed on the meta device."""
    llama: Any = network.language_model.model
    rotation: nn.Module = type(llama.rotary_emb)(config=llama.config)
    llama.rotary_emb = rotation.to(device)


def fuse(layers: Any) -> None:
    """Join the products of a Llama's layers, in place: queries, keys and values; the two halves of the perceptron.

    At batch 1 a decoder reads every weight for one row, and a card reads one large matrix faster than three small ones.
    Answers may differ in their last bits, by the kernels' choice. Such a network is neither saved nor trained: those
    have the published names.
    """
    for layer in layers:
        layer.self_attn = FusedAttention(layer.self_attn)
        layer.mlp = FusedPerceptron(layer.mlp)


class FusedAttention(nn.Module):
    """`LlamaAttention` of `transformers`, with one product for queries, keys and values."""

    def __init__(self, attention: Any) -> None:
        super().__init__()
        self.qkv_proj = _joined(attention.q_proj, attention.k_proj, attention.v_proj)
        self.o_proj: nn.Module = attention.o_proj
        self.layer_idx: int = attention.layer_idx
        self._sizes = [len(part.weight) for part in (attention.q_proj, attention.k_proj, attention.v_proj)]
        self._width: int = attention.head_dim

    def forward(
        self,
        hidden_states: Tensor,
        position_embeddings: tuple[Tensor, Tensor],
        attention_mask: Tensor | None = None,
        **others: Any,
    ) -> tuple[Tensor, None]:
        """(B, S, width) to the same. Versions of `transformers` give the memory different names."""
        rows, length, _ = hidden_states.shape
        parts = self.qkv_proj(hidden_states).split(self._sizes, dim=-1)
        queries, keys, values = (part.view(rows, length, -1, self._width).transpose(1, 2) for part in parts)
        turn: Any = apply_rotary_pos_emb
        queries, keys = turn(queries, keys, *position_embeddings)
        memory = others.get("cache", others.get("past_key_values"))
        if memory is not None:
            keys, values = memory.update(keys, values)
        if (shared := queries.shape[1] // keys.shape[1]) > 1:
            keys, values = keys.repeat_interleave(shared, 1), values.repeat_interleave(shared, 1)
        attended = F.scaled_dot_product_attention(
            queries, keys, values, attention_mask, is_causal=attention_mask is None and length > 1
        )
        return self.o_proj(attended.transpose(1, 2).reshape(rows, length, -1)), None


class FusedPerceptron(nn.Module):
    """`LlamaMLP` of `transformers`, with one product for the gate and what it lets through."""

    def __init__(self, perceptron: Any) -> None:
        super().__init__()
        self.gate_up_proj = _joined(perceptron.gate_proj, perceptron.up_proj)
        self.down_proj: nn.Module = perceptron.down_proj
        self.act_fn: nn.Module = perceptron.act_fn

    def forward(self, states: Tensor) -> Tensor:
        """(B, S, width) to the same."""
        gate, passed = self.gate_up_proj(states).chunk(2, dim=-1)
        result: Tensor = self.down_proj(self.act_fn(gate) * passed)
        return result


def _joined(*parts: nn.Linear) -> nn.Linear:
    """One layer that gives the outputs of several, in order; they have no bias, as in Llama."""
    with torch.no_grad():
        weight = torch.cat([part.weight for part in parts])
    joined = nn.Linear(weight.shape[1], weight.shape[0], bias=False, device="meta")
    joined.weight = nn.Parameter(weight, requires_grad=False)
    return joined
