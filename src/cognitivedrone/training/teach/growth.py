"""Networks with more words and attribute values than they were trained with; what they answered before stays."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.gate_selector import GateSelector
from cognitivedrone.models.sentence import WordConfig
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.text import Lexicon
from cognitivedrone.training.common.lexicon import with_vectors
from cognitivedrone.training.common.start import Start
from cognitivedrone.training.reasoner.trained import trained_selector
from cognitivedrone.training.small_vla.trained import trained

_UNSEEN_BIAS = -4.0  # a new concept begins as an unlikely one


def with_names(known: tuple[str, ...], new: tuple[str, ...]) -> tuple[str, ...]:
    """A list of attribute values with new ones at the end of the concepts, because groups are contiguous."""
    end = AttributeSchema(known).groups["concept"].stop
    return (*known[:end], *new, *known[end:])


def grown_policy(start: Start, names: tuple[str, ...], lexicon: Lexicon) -> SmallVLA:
    """A policy for more attribute values and words."""
    before, words = trained(start)
    config = replace(before.config, words=WordConfig(len(lexicon.words), lexicon.trained))
    network = SmallVLA(config, AttributeSchema(names))
    rows = _rows(before.schema.names, names)
    moved = {
        "reader.attributes.weight": (rows, 0), "reader.attributes.bias": (rows, 0), "reader.temperature": (rows, 0),
        "language.prototypes": (rows, 0), "language.words.own.weight": (_rows(_own(words), _own(lexicon)), 0),
    }  # fmt: skip
    _move(before, network, moved)
    with_vectors(network.language.words, lexicon)
    new = [row for row in range(len(names)) if row not in set(rows.tolist())]
    with torch.no_grad():
        assert network.reader is not None  # noqa: S101  (tells the type checker)
        network.reader.attributes.bias[new] = _UNSEEN_BIAS
    return network


def grown_selector(start: Start, names: tuple[str, ...], lexicon: Lexicon) -> GateSelector:
    """A gate selector for more attribute values and words."""
    before, words = trained_selector(start)
    config = replace(before.config, words=WordConfig(len(lexicon.words), lexicon.trained))
    network = GateSelector(config, len(names))
    rows = _rows(tuple(start.facts["attributes"]), names)
    _move(
        before,
        network,
        {"attributes.weight": (rows, 1), "words.own.weight": (_rows(_own(words), _own(lexicon)), 0)},
    )
    with_vectors(network.words, lexicon)
    return network


def _own(lexicon: Lexicon) -> tuple[str, ...]:
    return lexicon.words[: lexicon.trained]


def _rows(before: tuple[str, ...], after: tuple[str, ...]) -> Tensor:
    """For each name of before, its index in after."""
    places = {name: index for index, name in enumerate(after)}
    return torch.tensor([places[name] for name in before])


def _move(before: nn.Module, after: nn.Module, moved: dict[str, tuple[Tensor, int]]) -> None:
    """Copy all weights; those in `moved` to other rows along an axis. Word vectors are set by the caller."""
    state = after.state_dict()
    for name, value in before.state_dict().items():
        if name in moved:
            rows, axis = moved[name]
            state[name] = state[name].index_copy(axis, rows, value)
        elif not name.endswith("words.vectors"):
            state[name] = value
    after.load_state_dict(state)
