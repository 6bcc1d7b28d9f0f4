"""Two vision transformers whose patch features are concatenated. B images, N tokens, C a tower's width."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torch.utils.checkpoint import checkpoint

from cognitivedrone.models.openvla.config import PATCH, PATCHES, Config, TowerSize

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
