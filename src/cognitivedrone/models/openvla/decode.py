"""Decoders: one control step of the network, from image and prompt to normalised actions.

There are two: autoregressive, with a static cache of keys and values, as the published model was trained; or all
numbers of a chunk in parallel. Each is one function of tensors with fixed shapes and without host synchronisation, so
a GPU can capture it once as a CUDA graph and replay it. To keep the shapes fixed, prompts are padded on the right to
a few lengths; neither the padding nor the position of the patches changes an answer. On a GPU, steps run in their
own high-priority stream, ahead of a reasoner that runs on the same GPU in another thread.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeAlias

import numpy as np
import torch
from torch import Tensor

from cognitivedrone.models.openvla.actions import from_tokens
from cognitivedrone.models.openvla.config import ACTION_SIZE, PADDING, PATCHES, LanguageSize
from cognitivedrone.models.openvla.network import OpenVlaNetwork
from cognitivedrone.types import FloatArray

LENGTHS = (32, 64, 128, 256, 512, 1024)
"""Lengths to which prompts are padded, in tokens."""
FIRST = -1
"""Priority of the steps' stream; other streams have 0."""

Step: TypeAlias = Callable[[Tensor, Tensor, Tensor], Tensor]
"""`pixel_values` (1, 6, 224, 224), padded `input_ids` (1, T), their true number (1,) to the step's answer."""


class Decoder(Protocol):
    """Interface of the decoders."""

    def __call__(self, pixel_values: FloatArray, input_ids: Sequence[int]) -> FloatArray:
        """From an image (6, 224, 224) and a prompt's ids to actions (k, 4), k >= 1, normalised to [-1, 1]."""
        ...


class Autoregressive:
    """One action, token by token, by greedy decoding."""

    def __init__(self, network: OpenVlaNetwork, *, compiled: bool = False) -> None:
        self._runner = Runner(lambda *inputs: greedy_tokens(network, *inputs), network, compiled=compiled)

    def __call__(self, pixel_values: FloatArray, input_ids: Sequence[int]) -> FloatArray:
        """See `Decoder`."""
        return from_tokens(self.tokens(pixel_values, input_ids))[None]

    def tokens(self, pixel_values: FloatArray, input_ids: Sequence[int]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Ids (4,) of the generated tokens."""
        answer: np.ndarray[tuple[int], np.dtype[np.int64]] = self._runner(pixel_values, input_ids).numpy()
        return answer


class Parallel:
    """A chunk of actions in one pass, by the network's action head; raises `ValueError` for a network without one."""

    def __init__(self, network: OpenVlaNetwork, *, compiled: bool = False) -> None:
        if network.action_head is None:
            raise ValueError("this network has no action head")
        self._runner = Runner(lambda *inputs: chunk_actions(network, *inputs), network, compiled=compiled)

    def __call__(self, pixel_values: FloatArray, input_ids: Sequence[int]) -> FloatArray:
        """See `Decoder`."""
        answer: FloatArray = self._runner(pixel_values, input_ids).float().clamp(-1.0, 1.0).numpy()
        return answer


def greedy_tokens(network: OpenVlaNetwork, pixel_values: Tensor, input_ids: Tensor, count: Tensor) -> Tensor:
    """A `Step`: the ids (4,) of the most probable tokens, one after the other."""
    embedded = network.embed(input_ids, pixel_values)
    length = embedded.shape[1]
    memory = KeyValues(network.config.language, embedded, length + ACTION_SIZE - 1)
    places = torch.arange(length + ACTION_SIZE - 1, device=embedded.device)
    states = network.states(embedded, None, memory=memory)
    following = count + PATCHES  # position of the next token; in the cache it overwrites padding
    token = network.language_model.lm_head(states.index_select(1, following - 1)).argmax(-1)
    tokens = [token]
    for _ in range(ACTION_SIZE - 1):
        memory.place = following
        embedded = network.language_model.model.embed_tokens(token)
        states = network.states(embedded, (places <= following)[None, None, None], following[None], memory)
        token = network.language_model.lm_head(states).argmax(-1)
        tokens.append(token)
        following = following + 1
    return torch.cat(tokens, dim=1)[0]


def chunk_actions(network: OpenVlaNetwork, pixel_values: Tensor, input_ids: Tensor, count: Tensor) -> Tensor:
    """A `Step`: normalised actions (k, 4) of the action head."""
    known = torch.arange(input_ids.shape[1], device=input_ids.device) < count
    return network.chunk_actions(input_ids, pixel_values, known[None].long())[0]


class KeyValues:
    """Keys and values of every layer of one text, at fixed addresses; of the type and device of `like`."""

    def __init__(self, size: LanguageSize, like: Tensor, places: int) -> None:
        shape = (
            size.num_hidden_layers,
            1,
            size.num_key_value_heads,
            places,
            size.hidden_size // size.num_attention_heads,
        )
        # Zeros, because masked values are still multiplied by their weight of zero.
        self._keys, self._values = like.new_zeros(shape), like.new_zeros(shape)
        self.place: Tensor | None = None
        """Position of the next token, (1,); None for the initial ones, which go to the beginning."""

    def update(self, keys: Tensor, values: Tensor, layer: int) -> tuple[Tensor, Tensor]:
        """Store a layer's keys and values (1, heads, tokens, width); returns those to attend to."""
        if self.place is None:
            count = keys.shape[2]
            self._keys[layer, :, :, :count], self._values[layer, :, :, :count] = keys, values
            return keys, values
        self._keys[layer].index_copy_(2, self.place, keys)
        self._values[layer].index_copy_(2, self.place, values)
        return self._keys[layer], self._values[layer]


class Runner:
    """Runs a `Step` on the network's device: on a GPU as a CUDA graph, captured once per prompt length."""

    def __init__(self, step: Step, network: OpenVlaNetwork, *, compiled: bool = False) -> None:
        self._weight = network.projector.fc1.bias
        self._longest = (
            network.config.language.max_position_embeddings - PATCHES - ACTION_SIZE * (network.config.chunk or 1)
        )
        self._step: Step = torch.compile(step, dynamic=False, fullgraph=True) if compiled else step
        self._graphs: dict[int, Graph] = {}
        self._stream: torch.cuda.Stream | None = None
        if self._weight.device.type == "cuda":
            self._stream = torch.cuda.Stream(self._weight.device, priority=FIRST)  # type: ignore[no-untyped-call]

    def __call__(self, pixel_values: FloatArray, input_ids: Sequence[int]) -> Tensor:
        """The step's answer, on the host; raises `ValueError` for a prompt that is too long.

        `pixel_values` (6, 224, 224) are an image, `input_ids` a prompt.
        """
        if len(input_ids) > self._longest:
            raise ValueError(f"the prompt has {len(input_ids)} tokens; there is room for {self._longest}")
        padded = min(next(length for length in (*LENGTHS, len(input_ids)) if length >= len(input_ids)), self._longest)
        inputs = (
            torch.as_tensor(pixel_values)[None],
            torch.tensor([[*input_ids, *[PADDING] * (padded - len(input_ids))]]),
            torch.tensor([len(input_ids)]),
        )
        with torch.inference_mode():
            if self._stream is None:
                return self._step(inputs[0].to(self._weight.dtype), *inputs[1:])
            return self._replay(inputs, padded, self._stream)

    def _replay(self, inputs: tuple[Tensor, Tensor, Tensor], padded: int, stream: torch.cuda.Stream) -> Tensor:
        pixels, ids, count = inputs
        if padded not in self._graphs:  # the weights may still be in transfer, in the loader's stream
            stream.wait_stream(torch.cuda.current_stream(self._weight.device))
        with torch.cuda.stream(stream):
            there = (
                pixels.to(self._weight.device, self._weight.dtype),
                ids.to(self._weight.device),
                count.to(self._weight.device),
            )
            if padded not in self._graphs:
                self._graphs[padded] = Graph(self._step, there)
            return self._graphs[padded](*there).cpu()


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
