"""Export of a checkpoint to the model file: a self-describing ONNX graph with half-precision weights."""

from __future__ import annotations

import hashlib
import json
import logging
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from cognitivedrone import checkout
from cognitivedrone.files import replacing
from cognitivedrone.models.onnx_file import Provenance
from cognitivedrone.models.small_file import ActionStatistics, Description, SmallModel, describe
from cognitivedrone.models.small_vla import STATE, SmallVLA
from cognitivedrone.models.text import TOKEN, Lexicon
from cognitivedrone.policies.expert import ExpertConfig
from cognitivedrone.training.common.sampling import SampleSource, StreamRecipe
from cognitivedrone.training.small_vla.recorded import training_batches
from cognitivedrone.training.small_vla.trained import load_trained

_STATISTICS_FRAMES = 2_000
_HALVED_FROM = 256  # elements; smaller tensors are biases, scales and shapes
_STATISTICS_SEED = (0, 10**6 + 1)


def export(
    checkpoint: Path, out: Path, *, data: Path | None = None, scores: Mapping[str, Any] | None = None
) -> Description:
    """Write the network of a checkpoint as a self-describing ONNX file; returns its description.

    `data` is the training data set, if there was one; `scores` go into the file as they are. Raises
    `TrainingError` for a bad checkpoint.
    """
    network, lexicon, start = load_trained(checkpoint)
    action = action_statistics(network, stream_of(start.facts), data)
    return write_policy(network, lexicon, action, provenance_of(start.facts, scores), out)


def write_policy(
    network: SmallVLA, lexicon: Lexicon, action: ActionStatistics, provenance: Provenance, out: Path
) -> Description:
    """Write a policy's file; returns its description."""
    out.parent.mkdir(parents=True, exist_ok=True)
    description = Description(
        name=provenance.recipe,
        vocabulary=lexicon,
        text_length=network.config.text_length,
        chunk=network.config.chunk,
        action=action,
        network=network.config.facts(),
        attributes=network.schema.names,
        provenance=provenance,
    )
    with replacing(out, out.with_suffix(".part.onnx")) as beside:
        write_graph(network, beside)
        describe(beside, description)
        SmallModel.load(beside)  # a file that cannot be loaded never replaces the old one
    return description


def provenance_of(facts: Mapping[str, Any], scores: Mapping[str, Any] | None = None) -> Provenance:
    """The provenance of a network, from the facts of its checkpoint."""
    recipe = facts["recipe"]
    made = "made while training, sha256:" + hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()
    return Provenance(
        recipe=recipe["name"],
        data=facts.get("data") or made,
        commit=checkout.commit() or "unknown",
        trained=datetime.now(UTC).isoformat(timespec="seconds"),
        steps=int(facts["step"]),
        scores=dict(scores or {}),
    )


def stream_of(facts: Mapping[str, Any]) -> StreamRecipe:
    """The rollout stream that a policy was trained from; the default one where that is not known."""
    told = facts["recipe"].get("stream")
    if told is None:  # a training run on language that started from a model file
        return StreamRecipe()
    return StreamRecipe(
        **{name: value for name, value in told.items() if name not in ("expert", "text_mix")},
        expert=ExpertConfig(**told["expert"]),
    )


def write_graph(network: SmallVLA, path: Path) -> None:
    """The policy's network as an ONNX graph."""
    example = {
        "image": torch.zeros(2, 256, 256, 3, dtype=torch.uint8),
        "state": torch.zeros(2, STATE),
        "tokens": torch.ones(2, network.config.text_length, TOKEN, dtype=torch.int64),
    }
    write_onnx(network, example, ("action", "choice", "gates", "present"), path)


def write_onnx(network: nn.Module, example: Mapping[str, Tensor], outputs: Sequence[str], path: Path) -> None:
    """Write a network as an ONNX graph with a dynamic batch, large weights in half precision."""
    network = network.to("cpu").eval()
    batch = torch.export.Dim("batch", min=1, max=1024)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about the exporter's internals
        torch.onnx.export(
            network,
            tuple(example.values()),
            str(path),
            dynamo=True,
            dynamic_shapes=tuple({0: batch} for _ in example),
            external_data=False,
            input_names=list(example),
            output_names=list(outputs),
            verbose=False,
            optimize=False,  # keeps every weight under its own name, so that a training run can start from the file
        )
    model = onnx.load(str(path))
    cast_to_known_types(model)
    _halve(model)
    _forget_the_making(model)
    onnx.save(model, str(path))


def action_statistics(network: SmallVLA, stream: StreamRecipe, data: Path | None = None) -> ActionStatistics:
    """The distribution of the actions in a stream or a data set, and the network's output range."""
    recipe = replace(stream, batch=100, texts=0, sentences=1, learner=0.0)
    source = SampleSource(Lexicon.of(()), network.config.text_length, network.schema.names)
    made = training_batches(recipe, source, data)(_STATISTICS_SEED)
    taken = list(islice(made, _STATISTICS_FRAMES // recipe.batch))
    actions = np.concatenate([batch["action"][batch["valid"]][:, 0] for batch in taken]).astype(np.float64)

    def four(values: Any) -> tuple[float, float, float, float]:
        a, b, c, d = (round(float(value), 5) for value in values)
        return a, b, c, d

    return ActionStatistics(
        low=four(network.flight.low),
        high=four(network.flight.high),
        mean=four(actions.mean(axis=0)),
        std=four(actions.std(axis=0)),
        q01=four(np.quantile(actions, 0.01, axis=0)),
        q99=four(np.quantile(actions, 0.99, axis=0)),
    )


def cast_to_known_types(model: Any) -> None:
    """Replace casts to the type of another tensor by casts to that type.

    The exporter makes the absent biases of convolutions as zeros of the input's type. As long as that depends on a
    frame, the runtime cannot fold them, and neither merges convolutions with normalisations nor uses its fast layout.
    """
    graph = model.graph
    values = [*onnx.shape_inference.infer_shapes(model).graph.value_info, *graph.input]
    types = {value.name: value.type.tensor_type.elem_type for value in values}
    types |= {tensor.name: tensor.data_type for tensor in graph.initializer}
    for node in graph.node:
        if node.op_type == "CastLike":
            node.op_type = "Cast"
            node.attribute.append(onnx.helper.make_attribute("to", types[node.input[1]]))
            del node.input[1:]


def _halve(model: Any) -> None:
    """Store large single-precision weights in half precision; the runtime converts them once, on loading."""
    graph = model.graph
    casts = []
    for tensor in graph.initializer:
        if tensor.data_type != onnx.TensorProto.FLOAT or np.prod(tensor.dims) < _HALVED_FROM:
            continue
        name = tensor.name
        half = onnx.numpy_helper.from_array(onnx.numpy_helper.to_array(tensor).astype(np.float16), f"{name}.half")
        tensor.CopyFrom(half)
        casts.append(onnx.helper.make_node("Cast", [f"{name}.half"], [name], to=onnx.TensorProto.FLOAT))
    for cast in reversed(casts):
        graph.node.insert(0, cast)


def _forget_the_making(model: Any) -> None:
    """Remove the source locations of the traced parts: they are useless in flight, and contain names of folders."""
    graph = model.graph
    for part in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    # Shapes inside the graph are inferred again on loading.
    graph.ClearField("value_info")
