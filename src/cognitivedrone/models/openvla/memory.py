"""What a decoder keeps at fixed addresses, so that a GPU can record its steps: keys and values, and the recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from cognitivedrone.models.openvla.config import LanguageSize


class KeyValues:
    """Keys and values of every layer of some texts, at fixed addresses; of the type and device of `like`."""

    def __init__(self, size: LanguageSize, like: Tensor, places: int, rows: int = 1) -> None:
        shape = (
            size.num_hidden_layers,
            rows,
            size.num_key_value_heads,
            places,
            size.hidden_size // size.num_attention_heads,
        )
        # Zeros, because masked values are still multiplied by their weight of zero.
        self._keys, self._values = like.new_zeros(shape), like.new_zeros(shape)
        self.place: Tensor | None = None
        """Position of each text's next token, (B,); None for the initial ones, which go to the beginning."""

    def layer(self, number: int) -> LayerMemory:
        """The memory of one layer."""
        return LayerMemory(self._keys[number], self._values[number], self.place)


class LayerMemory:
    """Keys and values of one layer, in the part of a cache that a layer of `transformers` knows.

    Each layer has an object of its own, without a number: so the code of all layers is the same, and is compiled once.
    """

    def __init__(self, keys: Tensor, values: Tensor, place: Tensor | None) -> None:
        self._keys, self._values, self._place = keys, values, place

    def update(self, keys: Tensor, values: Tensor, *_: Any, **__: Any) -> tuple[Tensor, Tensor]:
        """Store keys and values (B, heads, tokens, width) of successive tokens; returns those to attend to.

        What else versions of transformers say, each in its way, is for their own caches.
        """
        if self._place is None:
            count = keys.shape[2]
            self._keys[:, :, :count], self._values[:, :, :count] = keys, values
            return keys, values
        places = self._place[:, None, None, None].expand_as(keys)
        self._keys.scatter_(2, places, keys)
        self._values.scatter_(2, places, values)
        return self._keys, self._values


class Graph:
    """A function of tensors, captured as a CUDA graph: a replay costs the host one launch for all its kernels.

    It is captured in the current stream, which must not be the default one, and has its priority. Other threads may use
    the GPU meanwhile.
    """

    def __init__(self, step: Callable[..., Tensor], inputs: Sequence[Tensor]) -> None:
        self._inputs = tuple(value.clone() for value in inputs)
        # Libraries pick their kernels and allocate workspaces in the first runs, which must not be captured.
        for _ in range(2):
            step(*self._inputs)
        self._graph = torch.cuda.CUDAGraph()
        stream = torch.cuda.current_stream()
        with torch.cuda.graph(self._graph, stream=stream, capture_error_mode="thread_local"):
            self._answer = step(*self._inputs)

    def __call__(self, *inputs: Tensor) -> Tensor:
        """The function's answer, ready in the current stream's order; the next call overwrites it."""
        for kept, value in zip(self._inputs, inputs, strict=True):
            kept.copy_(value)
        self._graph.replay()
        return self._answer
