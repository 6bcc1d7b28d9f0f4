"""A policy with more attribute values than it was trained with; what it answered before stays."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of
from cognitivedrone.training.small_vla.language import spoken
from cognitivedrone.training.small_vla.trained import trained
from cognitivedrone.training.trainer.start import Start

_UNSEEN_BIAS = -4.0  # a new concept begins as an unlikely one


def with_names(known: tuple[str, ...], new: tuple[str, ...]) -> tuple[str, ...]:
    """A list of attribute values with new ones at the end of the concepts, because groups are contiguous."""
    end = AttributeSchema(known).groups["concept"].stop
    return (*known[:end], *new, *known[end:])


def grown_policy(start: Start, names: tuple[str, ...]) -> SmallVLA:
    """A policy for more attribute values. A new one begins as what its name means, so it is understood by name."""
    before = trained(start)
    assert before.reader is not None and before.language is not None  # noqa: S101, PT018  (for the type checker)
    network = SmallVLA(before.config, AttributeSchema(names))
    rows = _rows(before.schema.names, names)
    moved = ("reader.attributes.weight", "reader.attributes.bias", "reader.temperature", "language.prototypes")
    _move(before, network, moved, rows)
    new = [row for row in range(len(names)) if row not in set(rows.tolist())]
    if new:
        concepts = [name for name in before.schema.names if name.startswith("concept/")]
        encoder = TextEncoderModel.load(encoder_of(start.path))
        texts = [spoken(name) for name in (*concepts, *(names[row] for row in new))]
        meanings = torch.from_numpy(encoder.meanings(texts))
        known, taught = meanings[: len(concepts)], meanings[len(concepts) :]
        with torch.no_grad():
            assert network.reader is not None and network.language is not None  # noqa: S101, PT018
            network.reader.attributes.bias[new] = _UNSEEN_BIAS
            length = before.language.prototypes.norm(dim=-1).mean()
            network.language.prototypes[new] = length * F.normalize(taught - known.mean(0), dim=-1)
    return network


def _rows(before: tuple[str, ...], after: tuple[str, ...]) -> Tensor:
    """For each name of before, its index in after."""
    places = {name: index for index, name in enumerate(after)}
    return torch.tensor([places[name] for name in before])


def _move(before: nn.Module, after: nn.Module, moved: Sequence[str], rows: Tensor) -> None:
    """Copy all weights; those in `moved` to other rows."""
    state = after.state_dict()
    for name, value in before.state_dict().items():
        state[name] = state[name].index_copy(0, rows, value) if name in moved else value
    after.load_state_dict(state)
