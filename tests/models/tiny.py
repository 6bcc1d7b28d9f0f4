"""A whole model file of a few hundred bytes: every contract of the real one, and answers that tests can foresee."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from cognitivedrone.models.onnx_file import Provenance
from cognitivedrone.models.small_file import ActionStatistics, Description, describe
from cognitivedrone.models.text import Vocabulary

TEXT_LENGTH = 8
CHUNK = 2
DESCRIPTION = Description(
    name="tiny",
    vocabulary=Vocabulary.of(["Fly through the red gate with the letter A", "Fly through the small round gate"]),
    text_length=TEXT_LENGTH,
    chunk=CHUNK,
    action=ActionStatistics(
        low=(-2.0, -2.0, -1.5, -1.0),
        high=(2.0, 2.0, 1.5, 1.0),
        mean=(1.0, 0.0, 0.0, 0.0),
        std=(0.5, 0.5, 0.1, 0.2),
        q01=(-0.1, -1.0, -0.5, -0.9),
        q99=(1.9, 1.0, 0.5, 0.9),
    ),
    config={"width": 8},
    provenance=Provenance("debug", "0" * 64, "0123abc", "2025-11-21T00:00:00+00:00", 10, {"smoke": 0.5}),
)
Inputs = dict[str, tuple[int, list[Any]]]
INPUTS: Inputs = {
    "image": (TensorProto.UINT8, ["batch", 256, 256, 3]),
    "state": (TensorProto.FLOAT, ["batch", 5]),
    "tokens": (TensorProto.INT64, ["batch", TEXT_LENGTH]),
}
OUTPUTS: Inputs = {
    "action": (TensorProto.FLOAT, ["batch", CHUNK, 4]),
    "choice": (TensorProto.FLOAT, ["batch", 4]),
    "gates": (TensorProto.FLOAT, ["batch", 3, 4]),
}


def graph(inputs: Inputs = INPUTS, outputs: Inputs = OUTPUTS) -> onnx.ModelProto:
    """A network that answers every step of the chunk with the brightest pixel / 255, the height, a tenth of the mean
    token, and the yaw rate; the gates' probabilities are all 0.25, their places all zero.

    Other inputs and outputs make a graph that breaks the contract.
    """
    image, state, tokens = inputs
    constants = {
        "to_row": [-1, 1],
        "three": [3],
        "four": [4],
        "one": [1],
        "all_but_batch": [1, 2, 3],
        "last": [1],
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
        numpy_helper.from_array(np.array(0.1, np.float32), "tenth"),
    ]
    action, choice, gates = outputs
    node = helper.make_node
    nodes = [
        node("Cast", [image], ["pixels"], to=TensorProto.FLOAT),
        node("ReduceMax", ["pixels", "all_but_batch"], ["brightest"], keepdims=0),
        node("Div", ["brightest", "white"], ["light"]),
        node("Reshape", ["light", "to_row"], ["x"]),
        node("Slice", [state, "three", "four", "last"], ["y"]),
        node("Cast", [tokens], ["numbers"], to=TensorProto.FLOAT),
        node("Mul", ["numbers", "tenth"], ["tenths"]),
        node("ReduceMean", ["tenths", "last"], ["z"], keepdims=1),
        node("Slice", [state, "four", "five", "last"], ["turn"]),
        node("Concat", ["x", "y", "z", "turn"], ["command"], axis=1),
        node("Unsqueeze", ["command", "middle"], ["step"]),
        node("Tile", ["step", "chunked"], [action]),
        node("Mul", ["x", "nothing"], ["zero"]),
        node("Add", ["zero", "quarter"], ["even"]),
        node("Tile", ["even", "four_times"], [choice]),
        node("Unsqueeze", ["zero", "middle"], ["blank"]),
        node("Tile", ["blank", "slots"], [gates]),
    ]
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
