"""The network: towers, projector and Llama. B images, T text tokens, P = 256 patches, S = T + P, W vocabulary size."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torch.utils.checkpoint import checkpoint
from transformers import LlamaConfig, LlamaForCausalLM

from cognitivedrone.models.openvla.config import ACTION_SIZE, PADDING, PATCH, PATCHES, Config, TowerSize
from cognitivedrone.models.openvla.tensors import HEAD_BLOCKS

NORM_EPSILON = 1e-6


class Vision(nn.Module):
    """DINOv2 and SigLIP, concatenated."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.dino = Tower(config.dino)
        self.siglip = Tower(config.siglip)

    def forward(self, pixel_values: Tensor) -> Tensor:
        """Features (B, 256, both widths) of images (B, 6, 224, 224), with three channels per tower."""
        return torch.cat([self.dino(pixel_values[:, :3]), self.siglip(pixel_values[:, 3:])], dim=2)


class Tower(nn.Module):
    """A vision transformer up to its second-to-last block, without the final norm (Dosovitskiy et al. 2020)."""

    def __init__(self, size: TowerSize) -> None:
        super().__init__()
        self.prefix = 0 if size.registers is None else 1 + size.registers
        if size.registers is not None:
            self.cls_token = nn.Parameter(torch.zeros(1, 1, size.width))
            self.reg_token = nn.Parameter(torch.zeros(1, size.registers, size.width))
        self.pos_embed = nn.Parameter(torch.empty(1, PATCHES, size.width).normal_(std=0.02))
        self.patch_embed = PatchEmbedding(size.width)
        self.blocks = nn.ModuleList(Block(size) for _ in range(size.depth - 1))
        self.checkpointing = False
        """Whether training recomputes each block's activations instead of keeping them."""

    def forward(self, images: Tensor) -> Tensor:
        """Features (B, 256, C) of images (B, 3, 224, 224), row by row from the upper left."""
        tokens: Tensor = self.patch_embed(images) + self.pos_embed
        if self.prefix:
            count = len(tokens)
            tokens = torch.cat([self.cls_token.expand(count, -1, -1), self.reg_token.expand(count, -1, -1), tokens], 1)
        for block in self.blocks:
            if self.checkpointing and self.training and torch.is_grad_enabled():
                tokens = checkpoint(block, tokens, use_reentrant=False)
            else:
                tokens = block(tokens)
        return tokens[:, self.prefix :]


class PatchEmbedding(nn.Module):
    """Embedding of each patch of 14 x 14 pixels as one token."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, PATCH, stride=PATCH)

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, 224, 224) to (B, 256, C)."""
        patches: Tensor = self.proj(images)
        return patches.flatten(2).transpose(1, 2)


class Block(nn.Module):
    """Attention and a perceptron, each with a preceding norm and a residual connection, scaled in DINOv2."""

    def __init__(self, size: TowerSize) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(size.width, eps=NORM_EPSILON)
        self.attn = Attention(size)
        self.norm2 = nn.LayerNorm(size.width, eps=NORM_EPSILON)
        self.mlp = Perceptron(size)
        self.ls1: nn.Module = LayerScale(size.width) if size.layer_scale else nn.Identity()
        self.ls2: nn.Module = LayerScale(size.width) if size.layer_scale else nn.Identity()

    def forward(self, tokens: Tensor) -> Tensor:
        """(B, N, C) to the same."""
        tokens = tokens + self.ls1(self.attn(self.norm1(tokens)))
        result: Tensor = tokens + self.ls2(self.mlp(self.norm2(tokens)))
        return result


class Attention(nn.Module):
    """Full self-attention."""

    def __init__(self, size: TowerSize) -> None:
        super().__init__()
        self.heads = size.heads
        self.qkv = nn.Linear(size.width, 3 * size.width)
        self.proj = nn.Linear(size.width, size.width)

    def forward(self, tokens: Tensor) -> Tensor:
        """(B, N, C) to the same."""
        batch, count, width = tokens.shape
        parts = self.qkv(tokens).view(batch, count, 3, self.heads, width // self.heads)
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(query, key, value)
        result: Tensor = self.proj(mixed.transpose(1, 2).reshape(batch, count, width))
        return result


class Perceptron(nn.Module):
    """Two layers with a GELU between."""

    def __init__(self, size: TowerSize) -> None:
        super().__init__()
        self.fc1 = nn.Linear(size.width, size.hidden)
        self.fc2 = nn.Linear(size.hidden, size.width)

    def forward(self, tokens: Tensor) -> Tensor:
        """(B, N, C) to the same."""
        result: Tensor = self.fc2(F.gelu(self.fc1(tokens)))
        return result


class LayerScale(nn.Module):
    """One learnt factor per channel (Touvron et al. 2021, arXiv 2103.17239)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.scale_factor = nn.Parameter(torch.full((width,), 1e-5))

    def forward(self, tokens: Tensor) -> Tensor:
        """(B, N, C) to the same."""
        return tokens * self.scale_factor


IGNORED = -100
"""Label of a token without a target."""


class Prediction(NamedTuple):
    """The network's prediction of the next tokens."""

    logits: Tensor
    """(B, S, W) or, with labels, (N, W) for the N labelled tokens alone, in order."""
    loss: Tensor | None
    """Mean cross-entropy over the labelled tokens, ()."""
    targets: Tensor | None
    """(N,) labels, in the order of the logits."""


class OpenVlaNetwork(nn.Module):
    """The network. A new one has random weights."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.vision = Vision(config)
        self.projector = Projector(config.vision_width, config.language.hidden_size)
        self.language_model: Any = LlamaForCausalLM(_llama_config(config))
        self.checkpointing = False
        """Whether training recomputes each layer's activations instead of keeping them."""
        self.action_head = None if config.chunk is None else ActionHead(config.language.hidden_size)

    def forward(
        self,
        input_ids: Tensor,
        pixel_values: Tensor,
        attention_mask: Tensor | None = None,
        labels: Tensor | None = None,
    ) -> Prediction:
        """Logits and, with labels, the loss.

        `input_ids` (B, T) int64 with padding on the right, if any; `pixel_values` (B, 6, 224, 224);
        `attention_mask` (B, T), 0 for padding; `labels` (B, T), `IGNORED` for tokens without a target. With
        labels, only labelled tokens get logits: the vocabulary is large, and an action has few tokens.
        """
        states = self.states(self.embed(input_ids, pixel_values), _causal(attention_mask))
        if labels is None:
            return Prediction(self.language_model.lm_head(states), None, None)
        following = F.pad(_with_patches(labels, IGNORED)[:, 1:], (0, 1), value=IGNORED)
        asked = following != IGNORED
        logits, targets = self.language_model.lm_head(states[asked]), following[asked]
        return Prediction(logits, F.cross_entropy(logits.float(), targets), targets)

    def chunk_actions(self, input_ids: Tensor, pixel_values: Tensor, attention_mask: Tensor | None = None) -> Tensor:
        """All actions of a chunk at once, (B, k, 4), normalised; for networks with an `action_head`.

        Follows OpenVLA-OFT (Kim et al. 2025, arXiv 2502.19645): placeholder tokens represent the requested numbers,
        every token attends to every other, and the head regresses; trained with the L1 distance.
        """
        chunk, head = self.config.chunk, self.action_head
        if chunk is None or head is None:
            raise ValueError("this network has no action head; make it from a configuration with a chunk")
        known = self.embed(input_ids, pixel_values)
        batch, length, width = known.shape
        asked = chunk * ACTION_SIZE
        mask = torch.ones_like(input_ids) if attention_mask is None else attention_mask
        seen = F.pad(_with_patches(mask, 1), (0, asked), value=1)
        # The numbers follow the last token, regardless of padding in between.
        last = length - (mask == 0).sum(1, keepdim=True)
        positions = torch.arange(length, device=known.device).expand(batch, -1)
        positions = torch.cat([positions, last + torch.arange(asked, device=known.device)], dim=1)
        states = self.states(
            torch.cat([known, known.new_zeros(batch, asked, width)], dim=1), seen.bool()[:, None, None], positions
        )
        answers: Tensor = head(states[:, length:].reshape(batch, chunk, ACTION_SIZE * width))
        return answers

    def embed(self, input_ids: Tensor, pixel_values: Tensor) -> Tensor:
        """Tokens (B, T) and images (B, 6, 224, 224) to (B, S, width): the patches follow the first token."""
        words = self.language_model.model.embed_tokens(input_ids)
        patches = self.projector(self.vision(pixel_values.to(words.dtype)))
        return torch.cat([words[:, :1], patches, words[:, 1:]], dim=1)

    def states(
        self, embedded: Tensor, mask: Tensor | None, positions: Tensor | None = None, memory: Any = None
    ) -> Tensor:
        """Llama's layers and its last norm: (B, S, width) to the same.

        `mask` (B, 1, S or 1, keys) bool selects what is attended to; without one, attention is causal. `positions`
        (B, S) int64 default to 0 to S - 1. `memory` stores keys and values: its `layer(number)` is the memory of a
        layer, whose `update(keys, values)` returns those to attend to.
        """
        llama = self.language_model.model
        if positions is None:
            positions = torch.arange(embedded.shape[1], device=embedded.device)[None]
        rotation = llama.rotary_emb(embedded, position_ids=positions)
        for number, layer in enumerate(llama.layers):
            run = partial(layer, position_embeddings=rotation)
            # By place: the name of the last one differs between versions of transformers.
            inputs = (embedded, mask, None, None if memory is None else memory.layer(number))
            if self.checkpointing and self.training and torch.is_grad_enabled():
                embedded = checkpoint(run, *inputs, use_reentrant=False)
            else:
                embedded = run(*inputs)
        result: Tensor = llama.norm(embedded)
        return result

    def enable_checkpointing(self, on: bool = True) -> None:
        """Recompute each block and layer in the backward pass from now on: less memory, a third more time."""
        self.checkpointing = self.vision.dino.checkpointing = self.vision.siglip.checkpointing = on


class Projector(nn.Module):
    """Three layers from the towers' features to Llama's embedding space."""

    def __init__(self, vision: int, words: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(vision, 4 * vision)
        self.fc2 = nn.Linear(4 * vision, words)
        self.fc3 = nn.Linear(words, words)

    def forward(self, features: Tensor) -> Tensor:
        """(B, P, both towers' widths) to (B, P, Llama's width)."""
        result: Tensor = self.fc3(F.gelu(self.fc2(F.gelu(self.fc1(features)))))
        return result


class ActionHead(nn.Module):
    """From the states of an action's four tokens to its four numbers: a perceptron with residual blocks."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(ACTION_SIZE * width)
        self.enter = nn.Linear(ACTION_SIZE * width, width)
        self.blocks = nn.ModuleList(HeadBlock(width) for _ in range(HEAD_BLOCKS))
        self.leave_norm = nn.LayerNorm(width)
        self.leave = nn.Linear(width, ACTION_SIZE)

    def forward(self, states: Tensor) -> Tensor:
        """(B, k, 4 x Llama's width) to (B, k, 4)."""
        inner = F.relu(self.enter(self.norm(states)))
        for block in self.blocks:
            inner = block(inner)
        result: Tensor = self.leave(self.leave_norm(inner))
        return result


class HeadBlock(nn.Module):
    """One layer with a residual connection."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.linear = nn.Linear(width, width)

    def forward(self, inner: Tensor) -> Tensor:
        """(B, k, width) to the same."""
        result: Tensor = inner + F.relu(self.linear(self.norm(inner)))
        return result


def _llama_config(config: Config) -> Any:
    sizes = asdict(config.language)
    theta = sizes.pop("rope_theta")
    make: Any = LlamaConfig  # its signature lacks the base class's arguments
    return make(
        **sizes,
        rope_parameters={"rope_type": "default", "rope_theta": theta},
        pad_token_id=PADDING if config.language.vocab_size > PADDING else None,
        use_cache=False,
        tie_word_embeddings=False,
        attn_implementation="sdpa",
    )


def _with_patches(per_token: Tensor, value: int) -> Tensor:
    """(B, T) to (B, S): `value` for the patches, which follow the first token."""
    patches = per_token.new_full((len(per_token), PATCHES), value)
    return torch.cat([per_token[:, :1], patches, per_token[:, 1:]], dim=1)


def _causal(attention_mask: Tensor | None) -> Tensor | None:
    """Attention mask, (B, 1, S, S), if some rows have padding; None, which means causal, otherwise."""
    if attention_mask is None:
        return None
    seen = _with_patches(attention_mask, 1).bool()
    length = seen.shape[1]
    causal = torch.ones(length, length, dtype=torch.bool, device=seen.device).tril()
    return causal & seen[:, None, None]
