"""Greedy answers of Qwen2.5-VL (arXiv 2502.13923) in few passes, each one function that a GPU records as a CUDA graph.

The answers are those of `generate()` of Transformers. What differs is the work for them:

- Keys and values stay at fixed addresses. Those of the text before the image are kept from one question to the next.
- Where the answer's form leaves no choice, tokens are appended without a pass of their own: the next pass takes them
  all. `Forms` has the answers that are allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any, Final

import torch
from torch import Tensor

from cognitivedrone.models.openvla.compiled import compiled_layers
from cognitivedrone.models.openvla.config import LanguageSize
from cognitivedrone.models.openvla.memory import Graph, KeyValues

FAMILY: Final = "qwen2_5_vl"
"""The only `model_type` whose layers are run here."""
_ROOM: Final = 256  # the memory is a multiple of so many tokens, so that it rarely has to be made anew
_SPARE: Final = 64  # graphs of so many lengths are kept


class Forms:
    """The answers that are allowed, as a tree of their tokens."""

    def __init__(self, answers: Sequence[Sequence[int]]) -> None:
        self._next: dict[tuple[int, ...], list[int]] = {}
        for answer in answers:
            for count, token in enumerate(answer):
                after = self._next.setdefault(tuple(answer[:count]), [])
                if token not in after:
                    after.append(token)
        self.longest = max(map(len, answers))
        """Tokens of the longest answer."""

    def after(self, begun: Sequence[int]) -> list[int]:
        """The tokens that may follow what an answer began with; none where it is whole."""
        return self._next.get(tuple(begun), [])

    def forced(self, begun: Sequence[int]) -> list[int]:
        """The tokens that must follow what an answer began with, up to the next choice or the end."""
        run: list[int] = []
        while len(following := self.after([*begun, *run])) == 1:
            run += following
        return run


class QwenDecoder:
    """Answers of a model of the class `Qwen2_5_VLForConditionalGeneration`, one at a time.

    An answer ends with the token `end`, or after `most` tokens. With `forms`, it is the likeliest of these, token by
    token; otherwise anything. With a `compiler`, a backend of `torch.compile`, the layers are compiled for the passes
    after the first; questions are too different in length.
    """

    def __init__(
        self, model: Any, *, end: int, most: int, forms: Forms | None = None, compiler: str | None = None
    ) -> None:
        self._model, self._text = model, model.model.language_model
        self._end, self._most, self._forms = end, most, forms
        told = model.config.text_config
        self._layers = list(self._text.layers)
        self._next_layers = self._layers if compiler is None else compiled_layers(self._layers, compiler)
        self._size = LanguageSize(
            hidden_size=told.hidden_size,
            num_hidden_layers=told.num_hidden_layers,
            num_attention_heads=told.num_attention_heads,
            num_key_value_heads=told.num_key_value_heads,
        )
        self._like: Tensor = model.lm_head.weight
        self._kept: list[int] = []
        """The tokens of the last question before its image, whose keys and values are in the memory."""
        self.passes = 0
        """Passes of the network for the last answer."""
        self._place = torch.zeros(1, dtype=torch.int64, device=self._like.device)
        self._make_room(_ROOM)
        self._stream: Any = torch.cuda.Stream() if self._like.is_cuda else None  # type: ignore[no-untyped-call]
        if self._stream is not None:
            self._stream.wait_stream(torch.cuda.current_stream())  # the weights are made there

    def __call__(self, inputs: dict[str, Tensor]) -> list[int]:
        """The tokens of an answer, the end included.

        `inputs` are those of the model for one question with one image: `input_ids`, `mm_token_type_ids`,
        `pixel_values` and `image_grid_thw`.
        """
        with torch.inference_mode(), nullcontext() if self._stream is None else torch.cuda.stream(self._stream):
            return self._answer(inputs)

    def _answer(self, inputs: dict[str, Tensor]) -> list[int]:
        answer = self._forms.forced([]) if self._forms else []
        logits, position = self._question(inputs, answer)
        length = inputs["input_ids"].shape[1]
        self.passes = 1
        while True:
            run = [self._choose(logits, answer)]
            if self._forms:
                run += self._forms.forced([*answer, *run])
            done, answer = len(answer), [*answer, *run]
            if answer[-1] == self._end or len(answer) >= self._most:
                return answer[: self._most]
            self._place.fill_(length + done)
            logits = self._run(self._ids(run), self._positions(position + done, len(run)))
            self.passes += 1

    def _choose(self, logits: Tensor, answer: Sequence[int]) -> int:
        """The likeliest of the tokens that may come next."""
        if not self._forms:
            return int(logits.argmax())
        allowed = self._forms.after(answer)
        return allowed[int(logits[self._ids(allowed)[0]].argmax())]

    def _question(self, inputs: dict[str, Tensor], begun: Sequence[int]) -> tuple[Tensor, int]:
        """Take in a question and what its answer begins with: the next token's logits, the answer's first position."""
        asked, kinds, grid = inputs["input_ids"], inputs["mm_token_type_ids"], inputs["image_grid_thw"]
        ids = torch.cat([asked, self._ids(begun)], 1)
        positions, shift = self._model.model.get_rope_index(
            ids, torch.nn.functional.pad(kinds, (0, len(begun))), image_grid_thw=grid
        )
        if ids.shape[1] + self._most > self._places.shape[0]:
            self._make_room(ids.shape[1] + self._most)
        is_image = ids[0] == self._model.config.image_token_id
        before = ids[0, : int(is_image.int().argmax())].tolist()
        known = 0
        while known < min(len(before), len(self._kept)) and before[known] == self._kept[known]:
            known += 1
        self._kept = []  # an error in what follows leaves nothing behind
        patches = self._model.model.get_image_features(inputs["pixel_values"], grid).pooler_output[0]
        embedded = self._text.embed_tokens(ids[:, known:])
        embedded[0, is_image[known:]] = patches.to(embedded.dtype)
        self._place.fill_(known)
        logits = self._logits(self._layers, embedded, positions[:, :, known:])
        self._kept = before
        return logits, int(shift) + asked.shape[1]

    def _run(self, ids: Tensor, positions: Tensor) -> Tensor:
        if self._stream is None:
            return self._next(ids, positions)
        count = ids.shape[1]
        if count not in self._graphs:
            if len(self._graphs) >= _SPARE:
                self._graphs.clear()
            self._graphs[count] = Graph(self._next, (ids, positions))
        return self._graphs[count](ids, positions)

    def _next(self, ids: Tensor, positions: Tensor) -> Tensor:
        """The logits (W,) after tokens (1, n), which go to the memory's place; `positions` (3, 1, n)."""
        return self._logits(self._next_layers, self._text.embed_tokens(ids), positions)

    def _logits(self, layers: Sequence[Any], states: Tensor, positions: Tensor) -> Tensor:
        rotation = self._text.rotary_emb(states, positions)
        reached = self._place + torch.arange(states.shape[1], device=states.device)
        mask = (self._places <= reached[:, None])[None, None]
        self._memory.place = self._place
        for number, layer in enumerate(layers):
            # By place: the name of the last one differs between versions of transformers.
            states = layer(states, mask, None, self._memory.layer(number), use_cache=True, position_embeddings=rotation)
        logits: Tensor = self._model.lm_head(self._text.norm(states[:, -1]))[0]
        return logits

    def _make_room(self, tokens: int) -> None:
        """A new memory; what was recorded with the old one is of no use."""
        places = -(-tokens // _ROOM) * _ROOM
        self._memory = KeyValues(self._size, self._like, places)
        self._places = torch.arange(places, device=self._like.device)
        self._kept = []
        self._graphs: dict[int, Graph] = {}
        """By number of tokens."""

    def _ids(self, ids: Sequence[int]) -> Tensor:
        return torch.tensor([list(ids)], dtype=torch.int64, device=self._like.device)

    def _positions(self, first: int, count: int) -> Tensor:
        """Positions (3, 1, n) of successive words, the same on all three axes."""
        return torch.arange(first, first + count, device=self._like.device).expand(3, 1, count).contiguous()
