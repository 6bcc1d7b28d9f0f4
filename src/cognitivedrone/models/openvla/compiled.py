"""Compiling the repeated parts of a network once, instead of a whole step: seconds instead of minutes.

All blocks of a kind share one compiled code, if nothing in it tells them apart. In a layer of `transformers` that is
its number, which only its cache asks for: `LayerMemory` does not.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import torch
from torch import nn

from cognitivedrone.models.openvla.network import OpenVlaNetwork

_VARIANTS: Final = 64
"""Compiled codes that a kind of block may have: one for each prompt length, number of rows and kind of pass."""


def compile_blocks(network: OpenVlaNetwork, backend: Any = "inductor") -> None:
    """Compile the towers' blocks and the language model's layers, each kind once for each shape of its inputs.

    They are compiled when they are first run. The network is for the decoders from now on, whose memory tells the
    layers apart.
    """
    compile_each(network.vision.dino.blocks, backend)
    compile_each(network.vision.siglip.blocks, backend)
    layers = network.language_model.model.layers
    for layer in layers:
        layer.self_attn.layer_idx = 0
    compile_each(layers, backend)


def compile_each(blocks: Iterable[nn.Module], backend: Any) -> None:
    """Compile blocks of one kind in place."""
    config: Any = torch._dynamo.config
    config.cache_size_limit = max(config.cache_size_limit, _VARIANTS)
    for block in blocks:
        block.compile(dynamic=False, fullgraph=True, backend=backend)


def uncompile(network: nn.Module) -> None:
    """Run every module as it is again."""
    for module in network.modules():
        module._compiled_call_impl = None
