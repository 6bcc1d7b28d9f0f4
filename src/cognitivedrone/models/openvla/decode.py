"""Decoders: one control step of the network, from image and prompt to normalised actions.

There are two: autoregressive, with a static cache of keys and values, as the published model was trained; or all
numbers of a chunk in parallel. Each is one function of tensors with fixed shapes and without host synchronisation, so
a GPU can capture it once as a CUDA graph and replay it. To keep the shapes fixed, prompts are padded on the right to
a few lengths; neither the padding nor the position of the patches changes an answer. On a GPU, steps run in their
own high-priority stream, ahead of a reasoner that runs on the same GPU in another thread. Images may come as squares
of uint8 (224, 224, 3), which are shifted and scaled where the network runs, to the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cognitivedrone.models.openvla.actions import from_tokens
from cognitivedrone.models.openvla.config import ACTION_SIZE, PADDING, PATCHES, LanguageSize
from cognitivedrone.models.openvla.network import IGNORED, OpenVlaNetwork
from cognitivedrone.models.openvla.prepare import ImagePreparation
from cognitivedrone.types import FloatArray

LENGTHS = (32, 64, 128, 256, 512, 1024)
"""Lengths to which prompts are padded, in tokens."""
FIRST = -1
"""Priority of the steps' stream; other streams have 0."""

Step: TypeAlias = Callable[[Tensor, Tensor, Tensor], Tensor]
"""`pixel_values` (B, 6, 224, 224), padded `input_ids` (B, T), their true numbers (B,) to answers, one per row."""
Images: TypeAlias = FloatArray | NDArray[np.uint8]
"""`pixel_values` (..., 6, 224, 224), or squares (..., 224, 224, 3) uint8."""


class Decoder(Protocol):
    """Interface of the decoders."""

    def __call__(self, pixel_values: Images, input_ids: Sequence[int]) -> FloatArray:
        """From an image and a prompt's ids to actions (k, 4), k >= 1, normalised to [-1, 1]."""
        ...

    def together(self, pixel_values: Images, input_ids: Sequence[Sequence[int]]) -> FloatArray:
        """The same for several images and prompts in one pass: (B, k, 4), but for rounding."""
        ...


class Autoregressive:
    """One action of `size` numbers, token by token, by greedy decoding."""

    def __init__(
        self, network: OpenVlaNetwork, preparation: ImagePreparation | None = None, size: int = ACTION_SIZE
    ) -> None:
        self._network = network
        self._runner = Runner(
            lambda images, ids, count: greedy_tokens(network, images, ids, count, size), network, preparation, size
        )

    def __call__(self, pixel_values: Images, input_ids: Sequence[int]) -> FloatArray:
        """See `Decoder`."""
        return from_tokens(self.tokens(pixel_values, input_ids))[None]

    def tokens(self, pixel_values: Images, input_ids: Sequence[int]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Ids (4,) of the generated tokens."""
        answer: np.ndarray[tuple[int], np.dtype[np.int64]] = self._runner(pixel_values[None], [input_ids])[0].numpy()
        return answer

    def log_probabilities(self, pixel_values: Images, input_ids: Sequence[int], tokens: Sequence[int]) -> FloatArray:
        """(4, vocabulary) of the tokens (4,) of a known answer, each given those before it."""
        with torch.inference_mode():
            images = self._runner.prepared(torch.as_tensor(pixel_values[None]))
            ids = torch.tensor([[*input_ids, *tokens]], device=images.device)
            labels = torch.tensor([[*[IGNORED] * len(input_ids), *tokens]], device=images.device)
            found = self._network(ids, images, labels=labels).logits.float().log_softmax(-1)
        answer: FloatArray = found.cpu().numpy()
        return answer

    def together(self, pixel_values: Images, input_ids: Sequence[Sequence[int]]) -> FloatArray:
        """See `Decoder`."""
        rows = self._runner(pixel_values, input_ids).numpy()
        return np.stack([from_tokens(row)[None] for row in rows])


class Parallel:
    """A chunk of actions in one pass, by the network's action head; raises `ValueError` for a network without one."""

    def __init__(self, network: OpenVlaNetwork, preparation: ImagePreparation | None = None) -> None:
        if network.action_head is None:
            raise ValueError("this network has no action head")
        self._runner = Runner(lambda *inputs: chunk_actions(network, *inputs), network, preparation)

    def __call__(self, pixel_values: Images, input_ids: Sequence[int]) -> FloatArray:
        """See `Decoder`."""
        answer: FloatArray = self.together(pixel_values[None], [input_ids])[0]
        return answer

    def together(self, pixel_values: Images, input_ids: Sequence[Sequence[int]]) -> FloatArray:
        """See `Decoder`."""
        answer: FloatArray = self._runner(pixel_values, input_ids).float().clamp(-1.0, 1.0).numpy()
        return answer


def greedy_tokens(
    network: OpenVlaNetwork, pixel_values: Tensor, input_ids: Tensor, count: Tensor, size: int = ACTION_SIZE
) -> Tensor:
    """A `Step`: the ids (B, size) of the most probable tokens, one after the other."""
    embedded = network.embed(input_ids, pixel_values)
    rows, length, width = embedded.shape
    memory = KeyValues(network.config.language, embedded, length + size - 1, rows)
    places = torch.arange(length + size - 1, device=embedded.device)
    states = network.states(embedded, None, memory=memory)
    following = count + PATCHES  # position of the next token; in the cache it overwrites padding
    last = states.gather(1, (following - 1)[:, None, None].expand(-1, 1, width))
    token = network.language_model.lm_head(last).argmax(-1)
    tokens = [token]
    for _ in range(size - 1):
        memory.place = following
        embedded = network.language_model.model.embed_tokens(token)
        seen = (places <= following[:, None])[:, None, None]
        states = network.states(embedded, seen, following[:, None], memory)
        token = network.language_model.lm_head(states).argmax(-1)
        tokens.append(token)
        following = following + 1
    return torch.cat(tokens, dim=1)


def chunk_actions(network: OpenVlaNetwork, pixel_values: Tensor, input_ids: Tensor, count: Tensor) -> Tensor:
    """A `Step`: normalised actions (B, k, 4) of the action head."""
    known = torch.arange(input_ids.shape[1], device=input_ids.device) < count[:, None]
    return network.chunk_actions(input_ids, pixel_values, known.long())


class Runner:
    """Runs a `Step` on the network's device: on a GPU as a CUDA graph, captured once per prompt length and batch."""

    def __init__(
        self,
        step: Step,
        network: OpenVlaNetwork,
        preparation: ImagePreparation | None = None,
        size: int = ACTION_SIZE,
    ) -> None:
        self._weight = network.projector.fc1.bias
        self._longest = network.config.language.max_position_embeddings - PATCHES - size * (network.config.chunk or 1)
        self._network_step = step
        preparation = preparation or ImagePreparation()
        means, deviations = np.array([preparation.means, preparation.deviations], np.float32).reshape(2, 6, 1, 1)
        self._means = torch.from_numpy(means).to(self._weight.device)
        self._deviations = torch.from_numpy(deviations).to(self._weight.device)
        # A tensor: PyTorch divides by a number by multiplying with its inverse on a GPU, which rounds otherwise.
        self._brightest = torch.full_like(self._means, 255.0)
        self._graphs: dict[tuple[int, int, torch.dtype], Graph] = {}
        """By prompt length, number of rows, and what images come as."""
        self._stream: torch.cuda.Stream | None = None
        if self._weight.device.type == "cuda":
            self._stream = torch.cuda.Stream(self._weight.device, priority=FIRST)  # type: ignore[no-untyped-call]

    def __call__(self, pixel_values: Images, input_ids: Sequence[Sequence[int]]) -> Tensor:
        """The step's answers, on the host; raises `ValueError` for a prompt that is too long.

        `pixel_values` are images, `input_ids` a prompt for each.
        """
        longest = max(len(ids) for ids in input_ids)
        if longest > self._longest:
            raise ValueError(f"the prompt has {longest} tokens; there is room for {self._longest}")
        padded = min(next(length for length in (*LENGTHS, longest) if length >= longest), self._longest)
        inputs = (
            torch.as_tensor(pixel_values),
            torch.tensor([[*ids, *[PADDING] * (padded - len(ids))] for ids in input_ids]),
            torch.tensor([len(ids) for ids in input_ids]),
        )
        with torch.inference_mode():
            if self._stream is None:
                return self.step(*inputs)
            return self._replay(inputs, padded, self._stream)

    def step(self, images: Tensor, ids: Tensor, count: Tensor) -> Tensor:
        """From images (B, 6, 224, 224), or squares (B, 224, 224, 3) uint8, to answers."""
        return self._network_step(self.prepared(images), ids, count)

    def prepared(self, images: Tensor) -> Tensor:
        """(B, 6, 224, 224) as the network wants them, on its device, of such images or of squares."""
        images = images.to(self._weight.device)
        if images.dtype == torch.uint8:
            pixels = images.permute(0, 3, 1, 2).float().repeat(1, 2, 1, 1) / self._brightest
            images = (pixels - self._means) / self._deviations
        return images.to(self._weight.dtype)

    def _replay(self, inputs: tuple[Tensor, Tensor, Tensor], padded: int, stream: torch.cuda.Stream) -> Tensor:
        rows = len(inputs[0])
        full = 1 << (rows - 1).bit_length()  # few numbers of rows, because each has a graph of its own
        if full > rows:
            inputs = tuple(torch.cat([value, value[:1].expand(full - rows, *value.shape[1:])]) for value in inputs)  # type: ignore[assignment]
        pixels, ids, count = inputs
        key = padded, full, pixels.dtype
        if key not in self._graphs:  # the weights may still be in transfer, in the loader's stream
            stream.wait_stream(torch.cuda.current_stream(self._weight.device))
        with torch.cuda.stream(stream):
            there = (
                pixels.to(self._weight.device, pixels.dtype if pixels.dtype == torch.uint8 else self._weight.dtype),
                ids.to(self._weight.device),
                count.to(self._weight.device),
            )
            if key not in self._graphs:
                self._graphs[key] = Graph(self.step, there)
            return self._graphs[key](*there).cpu()[:rows]


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
