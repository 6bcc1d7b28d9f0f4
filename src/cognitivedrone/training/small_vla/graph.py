"""Networks as ONNX graphs with small weights; files of the text encoder that policies share, and of the parts of a
policy: its eyes, its language, and the head that flies.
"""

from __future__ import annotations

import hashlib
import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cognitivedrone.files import replacing
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import LOOKS, SLOTS
from cognitivedrone.models.eyes.sight import EYES, EYES_FILE, EyesModel
from cognitivedrone.models.mind import LANGUAGE, LANGUAGE_FILE, Mind
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.small_vla import Eyes, SmallVLA
from cognitivedrone.models.words.gate_selector import GateSelector
from cognitivedrone.models.words.language import PARTS, Language, TextEncoder
from cognitivedrone.models.words.scene_tokens import INPUTS, LENGTHS
from cognitivedrone.models.words.text_encoder import FILE, TEXT_ENCODER, TextEncoderModel
from cognitivedrone.models.words.word_pieces import EMBEDDED, PIECES_FILE, WORD_PIECES, WordPieces, pieces_of
from cognitivedrone.training.trainer.eight_bits import (
    computing_in_eight_bits,
    in_eight_bits,
    in_half_precision,
    rounded_rows,
)


def write_onnx(
    network: nn.Module,
    example: Mapping[str, Tensor],
    outputs: Sequence[str],
    path: Path,
    *,
    second: Mapping[str, Any] | None = None,
    smaller: Callable[[Any], None] | None = None,
) -> None:
    """Write a network as an ONNX graph with a dynamic batch; `second` has the inputs whose second dimension is dynamic,
    too, with that dimension. Large weights are made `smaller`, by default of half precision.
    """
    network = network.to("cpu").eval()
    batch = torch.export.Dim("batch", min=1, max=1024)
    shapes = tuple({0: batch} | ({1: second[name]} if second and name in second else {}) for name in example)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about the exporter's internals
        torch.onnx.export(
            network,
            tuple(example.values()),
            str(path),
            dynamo=True,
            dynamic_shapes=shapes,
            external_data=False,
            input_names=list(example),
            output_names=list(outputs),
            verbose=False,
            optimize=False,  # keeps every weight under its own name, so that a training run can start from the file
        )
    model = onnx.load(str(path))
    read = {name for node in model.graph.node for name in node.input}
    for tensor in [tensor for tensor in model.graph.initializer if tensor.name not in read]:
        model.graph.initializer.remove(tensor)
    cast_to_known_types(model)
    (smaller or in_half_precision)(model)
    _forget_the_making(model)
    onnx.save(model, str(path))


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


def _forget_the_making(model: Any) -> None:
    """Remove the source locations of the traced parts: they are useless in flight, and contain names of folders."""
    graph = model.graph
    for part in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    # Shapes inside the graph are inferred again on loading.
    graph.ClearField("value_info")


def write_encoder(encoder: TextEncoder, pieces: Sequence[str], provenance: Provenance, folder: Path) -> str:
    """Write a text encoder, weights of eight bits, to `folder`; returns its digest."""
    digest = hashlib.sha256()
    for name, tensor in encoder.state_dict().items():
        digest.update(name.encode() + tensor.cpu().numpy().tobytes())
    words = write_pieces(encoder.words, pieces, provenance, folder)
    table = {"words": words, "digest": digest.hexdigest()}
    length = torch.export.Dim("length", min=1, max=sum(LENGTHS[:PARTS]))
    write_reader(encoder, ("words",), folder / FILE, TEXT_ENCODER, table, provenance, TextEncoderModel.load, length)
    return digest.hexdigest()


def write_pieces(words: nn.Embedding, pieces: Sequence[str], provenance: Provenance, folder: Path) -> str:
    """Write word pieces, in eight bits, to `folder`, unless they are the packaged ones; returns a digest."""
    eight, scale = rounded_rows(words.weight.detach().cpu().numpy())
    digest = hashlib.sha256(eight.tobytes() + scale.tobytes()).hexdigest()
    path = folder / PIECES_FILE
    if path.is_file() or WordPieces.load(pieces_of(path)).digest != digest:
        table = _Table(torch.from_numpy(eight), torch.from_numpy(scale))
        facts = {"pieces": list(pieces), "digest": digest, "size": eight.shape[1]}
        length = torch.export.Dim("length", min=1, max=sum(LENGTHS))
        write_model(table, {"tokens": torch.ones(2, 20, dtype=torch.int64)}, (EMBEDDED,), path, WORD_PIECES, facts,
                    provenance, WordPieces.load, second={"tokens": length}, smaller=lambda _: None)  # fmt: skip
    return digest


class _Table(nn.Module):
    """From tokens (B, L) to rows (B, L, W) of a table of eight bits."""

    def __init__(self, eight: Tensor, scale: Tensor) -> None:
        super().__init__()
        self.eight: Tensor
        self.scale: Tensor
        self.register_buffer("eight", eight)
        self.register_buffer("scale", scale)

    def forward(self, tokens: Tensor) -> Tensor:
        return self.eight[tokens].float() * self.scale[tokens]


def write_reader(
    network: TextEncoder | GateSelector,
    outputs: tuple[str, ...],
    path: Path,
    kind: str,
    table: Mapping[str, Any],
    provenance: Provenance,
    load: Callable[[Path], object],
    length: Any,
    smaller: Callable[[Any], None] = in_eight_bits,
) -> None:
    """Write a network that is given tokens of this `length` and their embeddings, weights of eight bits."""
    # Three tensors: one that is given three times would be taken for one input.
    example = {name: torch.ones(2, 20, dtype=torch.int64) for name in INPUTS}
    example[EMBEDDED] = torch.zeros(2, 20, network.words.embedding_dim)
    write_model(network, example, outputs, path, kind, table, provenance, load,
                second=dict.fromkeys(example, length), smaller=smaller)  # fmt: skip


def write_eyes(
    network: SmallVLA, provenance: Provenance, folder: Path, images: NDArray[Any], *, classifier: bool
) -> None:
    """Write the eyes of a policy to `folder`, rounded by what they make of `images` (n, 256, 256, 3); `classifier` says
    whether the picture classifier shall be asked, too.
    """
    reads = network.reader is not None
    outputs = ("gates", "slots", "whole", *(("readings", "boxes") if reads else ()))
    table: dict[str, Any] = {"facets": list(network.schema.names) if reads else [], "width": network.config.backbone[2]}
    example = {"image": torch.zeros(2, 256, 256, 3, dtype=torch.uint8)}
    table["classifier"] = classifier and reads
    write_model(Eyes(network), example, outputs, folder / EYES_FILE, EYES, table, provenance, EyesModel.load,
                smaller=partial(computing_in_eight_bits, images=images))  # fmt: skip


def write_language(
    language: Language, schema: AttributeSchema, encoder: str, provenance: Provenance, folder: Path
) -> None:
    """Write a language that was trained with the text encoder of a digest to `folder`."""
    size = len(schema.names)
    example = {
        "words": torch.ones(2, 20, language.prototypes.shape[1]),
        "panels": torch.zeros(2, SLOTS, size),
        "looks": torch.zeros(2, SLOTS, LOOKS),
        "board": torch.zeros(2, size),
        "seen": torch.zeros(2),
    }
    length = torch.export.Dim("length", min=1, max=sum(LENGTHS[:PARTS]))
    table = {"facets": list(schema.names), "encoder": encoder}
    write_model(_Answers(language), example, ("match", "choice"), folder / LANGUAGE_FILE, LANGUAGE, table, provenance,
                Mind.load, second={"words": length})  # fmt: skip


class _Answers(nn.Module):
    """`Language.match` with none (B, 4), and `choice` (B, 3), from words (B, L, W) and a scene's readings."""

    def __init__(self, language: Language) -> None:
        super().__init__()
        self.language = language

    def forward(
        self, words: Tensor, panels: Tensor, looks: Tensor, board: Tensor, seen: Tensor
    ) -> tuple[Tensor, Tensor]:
        query, absent = self.language(words, board, seen)
        match = self.language.match(query[:, None], panels, looks)[:, 0]
        return torch.cat([match, absent[:, None]], dim=1), self.language.choice(query[:, None], panels, looks)[:, 0]


def write_model(
    network: nn.Module,
    example: Mapping[str, Tensor],
    outputs: tuple[str, ...],
    path: Path,
    kind: str,
    table: Mapping[str, Any],
    provenance: Provenance,
    load: Callable[[Path], object],
    *,
    second: Mapping[str, Any] | None = None,
    smaller: Callable[[Any], None] | None = None,
) -> None:
    """`write_onnx` with a table of its `kind`; a file that cannot be loaded never replaces the old one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as beside:
        write_onnx(network, example, outputs, beside, second=second, smaller=smaller)
        write_table(beside, kind, {**table, "provenance": asdict(provenance)})
        load(beside)
