"""Fewer and larger products for flying: queries, keys and values in one, and both halves of the perceptron in one.

At batch 1 a decoder reads every weight for one row, and a card reads one large matrix faster than three small ones. The
weights are joined once, after loading: checkpoints, fine-tuning and merging have the published names. The same numbers
are added in the same order but for the kernels' choice, so the answers may differ in their last bits.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from transformers.models.llama.modeling_llama import apply_rotary_pos_emb


def fuse(layers: Any) -> None:
    """Join the products of a Llama's layers, in place. A network with them is neither saved nor trained."""
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
