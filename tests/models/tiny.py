"""Whole model files of a few hundred bytes: every contract of the real ones, and answers that tests can foresee."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.reasoner_file import (
    LANGUAGE,
    LANGUAGE_FILE,
    LOOKS,
    READER_FILE,
    READER_KIND,
    SELECTOR,
    SELECTOR_FILE,
)
from cognitivedrone.models.small_file import ActionStatistics, Description, describe
from cognitivedrone.models.words.text_encoder import FILE, TEXT_ENCODER

CHUNK = 2
WIDTH = 3
"""Of the tiny text encoder."""
DIGEST = "d" * 64
"""Of the tiny text encoder."""
PIECES = (
    *("[PAD]", "[UNK]", "[CLS]", "left", "gate", "letter", "a", "b", "c"),
    *("fly", "through", "the", "red", "small", "round", "with"),
)
"""The word pieces of tiny text encoder and gate selector."""
DESCRIPTION = Description(
    name="tiny",
    encoder="",
    chunk=CHUNK,
    action=ActionStatistics(
        low=(-2.0, -2.0, -1.5, -1.0),
        high=(2.0, 2.0, 1.5, 1.0),
        mean=(1.0, 0.0, 0.0, 0.0),
        std=(0.5, 0.5, 0.1, 0.2),
        q01=(-0.1, -1.0, -0.5, -0.9),
        q99=(1.9, 1.0, 0.5, 0.9),
    ),
    network={"width": 8},
    provenance=Provenance("debug", "0" * 64, "0123abc", "2025-11-21T00:00:00+00:00", 10, {"smoke": 0.5}),
)
OPEN_DESCRIPTION = replace(
    DESCRIPTION,
    name="tiny-open",
    encoder=DIGEST,
    network={"width": 8, "language": {"size": WIDTH}},
    attributes=("kind/thing", "kind/unknown", "concept/thing:cat"),
)
"""Of a model that reads sentences."""
Inputs = dict[str, tuple[int, list[Any]]]
INPUTS: Inputs = {
    "image": (TensorProto.UINT8, ["batch", 256, 256, 3]),
    "state": (TensorProto.FLOAT, ["batch", 5]),
}
OUTPUTS: Inputs = {
    "action": (TensorProto.FLOAT, ["batch", CHUNK, 4]),
    "choice": (TensorProto.FLOAT, ["batch", 4]),
    "gates": (TensorProto.FLOAT, ["batch", 3, 4]),
}
OPEN: dict[str, Inputs] = {
    "inputs": {**INPUTS, "words": (TensorProto.FLOAT, ["batch", "length", WIDTH])},
    "outputs": {**OUTPUTS, "present": (TensorProto.FLOAT, ["batch"])},
}
"""Inputs and outputs of a model that reads sentences."""


def graph(inputs: Inputs = INPUTS, outputs: Inputs = OUTPUTS) -> onnx.ModelProto:
    """A network that answers every step of the chunk with the brightest pixel / 255, the height, the sum of `words` or
    0, and the yaw rate; the gates' probabilities are all 0.25. Their places are all zero; in models that read
    sentences, they are ahead and 3 m away, and what is asked for is there with the probability 1 - brightest pixel /
    255.

    Other inputs and outputs make a graph that breaks the contract.
    """
    image, state, *words = inputs
    constants = {
        "to_row": [-1, 1],
        "three": [3],
        "four": [4],
        "one": [1],
        "all_but_batch": [1, 2, 3],
        "last": [1],
        "all_words": [1, 2],
        "chunked": [1, CHUNK, 1],
        "middle": [1],
        "four_times": [1, 4],
        "slots": [1, 3, 4],
        "five": [5],
    }
    initializers = [numpy_helper.from_array(np.array(value, np.int64), name) for name, value in constants.items()]
    initializers += [
        numpy_helper.from_array(np.array(255, np.float32), "white"),
        numpy_helper.from_array(np.array(0.25, np.float32), "quarter"),
        numpy_helper.from_array(np.array(0, np.float32), "nothing"),
    ]
    action, choice, gates, *present = outputs
    place = [128, 128, 0.9, 3] if present else [0, 0, 0, 0]
    initializers += [
        numpy_helper.from_array(np.array(place, np.float32).reshape(1, 1, 4), "place"),
        numpy_helper.from_array(np.array(1, np.float32), "whole"),
    ]
    node = helper.make_node
    nodes = [
        node("Cast", [image], ["pixels"], to=TensorProto.FLOAT),
        node("ReduceMax", ["pixels", "all_but_batch"], ["brightest"], keepdims=0),
        node("Div", ["brightest", "white"], ["light"]),
        node("Reshape", ["light", "to_row"], ["x"]),
        node("Slice", [state, "three", "four", "last"], ["y"]),
        node("ReduceSum", [words[0], "all_words"], ["heard"], keepdims=0)
        if words
        else node("Mul", ["light", "nothing"], ["heard"]),
        node("Reshape", ["heard", "to_row"], ["z"]),
        node("Slice", [state, "four", "five", "last"], ["turn"]),
        node("Concat", ["x", "y", "z", "turn"], ["command"], axis=1),
        node("Unsqueeze", ["command", "middle"], ["step"]),
        node("Tile", ["step", "chunked"], [action]),
        node("Mul", ["x", "nothing"], ["zero"]),
        node("Add", ["zero", "quarter"], ["even"]),
        node("Tile", ["even", "four_times"], [choice]),
        node("Unsqueeze", ["zero", "middle"], ["blank"]),
        node("Tile", ["blank", "slots"], ["nowhere"]),
        node("Add", ["nowhere", "place"], [gates]),
        *(node("Sub", ["whole", "light"], [name]) for name in present),
    ]
    return model_of(nodes, inputs, outputs, initializers)


def model_of(
    nodes: list[onnx.NodeProto], inputs: Inputs, outputs: Inputs, initializers: list[onnx.TensorProto]
) -> onnx.ModelProto:
    """A graph of these nodes."""
    return helper.make_model(
        helper.make_graph(
            nodes,
            "tiny",
            [helper.make_tensor_value_info(name, *facts) for name, facts in inputs.items()],
            [helper.make_tensor_value_info(name, *facts) for name, facts in outputs.items()],
            initializers,
        ),
        opset_imports=[helper.make_opsetid("", 18)],
        ir_version=9,
    )


def tiny_model(path: Path, description: Description | None = None, **interface: Inputs) -> Path:
    """Write a model file with what it says of itself."""
    onnx.save(graph(**interface), str(path))
    describe(path, description or DESCRIPTION)
    return path


def open_model_file(path: Path) -> Path:
    """A model file that reads sentences and tells whether what is asked for is there; its text encoder is beside it."""
    tiny_encoder(path.parent)
    return tiny_model(path, OPEN_DESCRIPTION, **OPEN)


def tiny_encoder(folder: Path, **fields: Any) -> Path:
    """Write a text encoder that gives every token its number / 100 as the first of three values; `fields` change what
    it says of itself.
    """
    tokens: Inputs = {name: (TensorProto.INT64, ["batch", "length"]) for name in ("tokens", "positions", "parts")}
    told: Inputs = {"words": (TensorProto.FLOAT, ["batch", "length", WIDTH])}
    node = helper.make_node
    nodes = [
        node("Cast", ["tokens"], ["numbers"], to=TensorProto.FLOAT),
        node("Unsqueeze", ["numbers", "last"], ["column"]),
        node("Mul", ["column", "first"], ["words"]),
    ]
    initializers = [
        numpy_helper.from_array(np.array([-1], np.int64), "last"),
        numpy_helper.from_array(np.array([0.01, 0, 0], np.float32), "first"),
    ]
    path = folder / FILE
    onnx.save(model_of(nodes, tokens, told, initializers), str(path))
    write_table(path, TEXT_ENCODER, {"pieces": PIECES, "digest": DIGEST, "size": WIDTH, **fields})
    return path


def heard(text: str) -> float:
    """What a tiny model that reads sentences says to a sentence of known words: the sum of its tokens / 100."""
    return sum(PIECES.index(piece) for piece in ("[CLS]", *text.lower().split())) / 100


def tiny_reasoner(
    folder: Path,
    names: tuple[str, ...],
    *,
    reading: tuple[np.ndarray, np.ndarray, np.ndarray],
    logits: tuple[float, ...],
    language: tuple[float, ...] = (0, 0, 0, 0),
) -> Path:
    """Write the files of a small reasoner that reads the same probabilities, looks and boxes in every frame, and whose
    selector and language give the gates and their absence these logits, whatever it is asked; returns the folder.
    """
    count = len(names)
    table = {"facets": names, "provenance": DESCRIPTION.table()["provenance"]}
    things = sum(name.startswith("concept/thing:") for name in names)
    image: Inputs = {
        "image": INPUTS["image"],
        "opinions": (TensorProto.FLOAT, ["batch", 3, things]),
        "paper": (TensorProto.FLOAT, ["batch", 3]),
    }
    told = dict(zip(("readings", "looks", "boxes"), reading, strict=True))
    sizes = {"readings": [4, count], "looks": [3, LOOKS], "boxes": [4, 4]}
    outputs: Inputs = {name: (TensorProto.FLOAT, ["batch", *size]) for name, size in sizes.items()}
    reader = folder / READER_FILE
    onnx.save(_constant(image, outputs, told), str(reader))
    write_table(reader, READER_KIND, table)
    inputs: Inputs = {name: (TensorProto.INT64, ["batch", "length"]) for name in ("tokens", "positions", "parts")}
    answer = {"logits": np.array(logits, np.float32)}
    selector = folder / SELECTOR_FILE
    onnx.save(_constant(inputs, {"logits": (TensorProto.FLOAT, ["batch", len(logits)])}, answer), str(selector))
    write_table(selector, SELECTOR, {**table, "pieces": PIECES, "notes": {}})
    tiny_encoder(folder)
    shapes: dict[str, list[int | str]] = {
        "words": ["length", WIDTH],
        "panels": [3, count],
        "looks": [3, LOOKS],
        "board": [count],
        "seen": [],
    }
    inputs = {name: (TensorProto.FLOAT, ["batch", *size]) for name, size in shapes.items()}
    answer = {"logits": np.array(language, np.float32)}
    path = folder / LANGUAGE_FILE
    onnx.save(_constant(inputs, {"logits": (TensorProto.FLOAT, ["batch", len(language)])}, answer), str(path))
    write_table(path, LANGUAGE, {**table, "encoder": DIGEST})
    return folder


def _constant(inputs: Inputs, outputs: Inputs, values: dict[str, np.ndarray]) -> onnx.ModelProto:
    """A graph that answers every batch with the same values."""
    node = helper.make_node
    first, *_ = inputs
    initializers = [
        numpy_helper.from_array(np.array([0], np.int64), "begin"),
        numpy_helper.from_array(np.array([1], np.int64), "end"),
    ]
    nodes = [node("Shape", [first], ["shape"]), node("Slice", ["shape", "begin", "end"], ["count"])]
    for name, value in values.items():
        size = np.array(value.shape, np.int64)
        initializers += [
            numpy_helper.from_array(np.asarray(value, np.float32), f"{name}.value"),
            numpy_helper.from_array(size, f"{name}.size"),
        ]
        nodes += [
            node("Concat", ["count", f"{name}.size"], [f"{name}.shape"], axis=0),
            node("Expand", [f"{name}.value", f"{name}.shape"], [name]),
        ]
    return model_of(nodes, inputs, outputs, initializers)
