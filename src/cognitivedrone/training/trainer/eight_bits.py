"""ONNX graphs of smaller numbers: half precision and eight bits for what is stored, eight bits for what is computed.

Convolutions run in integers of eight bits, after Jacob et al. 2018 (arXiv 1712.05877): a normalisation is folded into
its convolution, ranges of what flows between them are those that frames cause, and weights have seven bits, so that
processors without VNNI or its like add them up without overflow, and all processors alike.
"""

from __future__ import annotations

import importlib
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

_HALVED_FROM = 256  # elements; smaller tensors are biases, scales and shapes
_ROUNDED_FROM = 4096  # elements; smaller matrices stay as they are
FOLD: Final = ".fold"
"""Of the factors by which the rows of a stored weight were multiplied, by its name."""
EIGHT: Final = "_quantized"
"""Of a weight's integers, by its name; `SCALE` of what one is worth, for each row."""
SCALE: Final = "_scale"


def in_half_precision(model: Any) -> None:
    """Store large single-precision weights in half precision; the runtime converts them once, on loading."""
    graph = model.graph
    casts = []
    for tensor in graph.initializer:
        if (
            tensor.data_type != onnx.TensorProto.FLOAT
            or np.prod(tensor.dims) < _HALVED_FROM
            or tensor.name.endswith(SCALE)
        ):
            continue
        name = tensor.name
        half = numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float16), f"{name}.half")
        tensor.CopyFrom(half)
        casts.append(onnx.helper.make_node("Cast", [f"{name}.half"], [name], to=onnx.TensorProto.FLOAT))
    for cast in reversed(casts):
        graph.node.insert(0, cast)


def in_eight_bits(model: Any) -> None:
    """Store large matrices and kernels as integers of eight bits and a scale for each row, as symmetric as the weights.

    The runtime turns them into single precision once, on loading; so only the weights are rounded, by 0.4 % of the
    largest of their row at most.
    """
    graph, nodes = model.graph, []
    for tensor in list(graph.initializer):
        if tensor.data_type != onnx.TensorProto.FLOAT or len(tensor.dims) < 2 or np.prod(tensor.dims) < _ROUNDED_FROM:
            continue
        name = tensor.name
        rounded, scale = rounded_rows(numpy_helper.to_array(tensor))
        tensor.CopyFrom(numpy_helper.from_array(rounded, f"{name}.eight"))
        graph.initializer.append(numpy_helper.from_array(scale, f"{name}.scale"))
        nodes += [
            onnx.helper.make_node("Cast", [f"{name}.eight"], [f"{name}.cast"], to=onnx.TensorProto.FLOAT),
            onnx.helper.make_node("Mul", [f"{name}.cast", f"{name}.scale"], [name]),
        ]
    for node in reversed(nodes):
        graph.node.insert(0, node)


def rounded_rows(values: NDArray[np.float32]) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Integers for weights float32 (rows, ...), and what one is worth in each row, (rows, 1, ...)."""
    largest = np.abs(values).max(axis=tuple(range(1, values.ndim)), keepdims=True)
    scale = np.maximum(largest / 127, 1e-12).astype(np.float32)
    return np.rint(values / scale).astype(np.int8), scale


def computing_in_eight_bits(model: Any, images: NDArray[Any]) -> None:
    """Let convolutions with a normalisation run in integers, in ranges that `images` uint8 (n, h, w, 3) cause.

    What else is large is stored in half precision.
    """
    quantization: Any = importlib.import_module("onnxruntime.quantization")

    kept = _fold_normalisations(model)
    folded = {name.removesuffix(FOLD) for name in kept}
    nodes = [node for node in model.graph.node if node.op_type == "Conv" and node.input[1] in folded]
    made = {node.output[0] for node in nodes}
    nodes += [node for node in model.graph.node if node.op_type == "Add" and made.intersection(node.input)]
    (image,) = model.graph.input

    class Shown(quantization.CalibrationDataReader):  # type: ignore[misc]
        def __init__(self) -> None:
            self._rows = iter(images)

        def get_next(self) -> dict[str, NDArray[Any]] | None:
            row = next(self._rows, None)
            return None if row is None else {image.name: row[None]}

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "eight.onnx"
        quantization.quantize_static(
            model, path, Shown(), nodes_to_quantize=[node.name for node in nodes], per_channel=True, reduce_range=True,
            activation_type=quantization.QuantType.QUInt8, weight_type=quantization.QuantType.QInt8,
        )  # fmt: skip
        model.CopyFrom(onnx.load(str(path)))
    in_half_precision(model)
    # In flight nobody reads them, and a runtime warns of what nobody reads in the graph itself.
    model.training_info.add().initialization.initializer.extend(kept.values())


def multiplying_in_eight_bits(model: Any) -> None:
    """Let products with matrices run in integers, with what is multiplied rounded as it comes.

    What else is large is stored in eight bits.
    """
    runtime: Any = importlib.import_module("onnxruntime")
    quantization: Any = importlib.import_module("onnxruntime.quantization")
    options, opsets = runtime.SessionOptions(), list(model.opset_import)
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_ENABLE_BASIC  # matrices are turned for good
    with tempfile.TemporaryDirectory() as folder:
        whole, eight = Path(folder) / "whole.onnx", Path(folder) / "eight.onnx"
        options.optimized_model_filepath = str(whole)
        runtime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
        quantization.quantize_dynamic(
            whole, eight, op_types_to_quantize=["MatMul"], per_channel=True, reduce_range=True,
            weight_type=quantization.QuantType.QInt8,
        )  # fmt: skip
        model.CopyFrom(onnx.load(str(eight)))
    del model.opset_import[:]
    model.opset_import.extend(opsets)
    in_eight_bits(model)


def weights_in(model: Any) -> dict[str, NDArray[Any]]:
    """The weights of a graph by their names in training: as before they were made smaller, but for rounding."""
    graphs = [model.graph, *(each.initialization for each in model.training_info)]
    found = {tensor.name: numpy_helper.to_array(tensor) for graph in graphs for tensor in graph.initializer}
    weights = {name.removesuffix(".half"): values for name, values in found.items()}
    for name in [name.removesuffix(FOLD) for name in found if name.endswith(FOLD)]:
        rows = (-1, *[1] * (found[name + EIGHT].ndim - 1))
        values = found[name + EIGHT] * found[name + SCALE].reshape(rows)
        fold = np.broadcast_to(found[name + FOLD].reshape(rows), values.shape)
        weights[name] = np.divide(values, fold, out=np.zeros_like(values), where=fold != 0)
    return weights


def _fold_normalisations(model: Any) -> dict[str, Any]:
    """Fold normalisations into the convolutions before them, which have no bias of their own.

    Returns what training needs to take them apart again: the normalisations' tensors, and `FOLD` of each weight.
    """
    graph = model.graph
    tensors = {tensor.name: tensor for tensor in graph.initializer}
    maker = {node.output[0]: node for node in graph.node}
    kept: dict[str, Any] = {}
    for node in [node for node in graph.node if node.op_type == "BatchNormalization"]:
        convolution = maker[node.input[0]]
        if tensors.keys() & convolution.input[2:]:  # absent ones are calculated zeros
            raise ValueError(f"{convolution.name} has a bias before its normalisation")
        weight, bias = convolution.input[1], f"{convolution.input[1]}.shift"
        gamma, beta, mean, variance = (numpy_helper.to_array(tensors[name]) for name in node.input[1:])
        factors = gamma / np.sqrt(variance + next(each.f for each in node.attribute if each.name == "epsilon"))
        values = numpy_helper.to_array(tensors[weight])
        kept |= {name: numpy_helper.from_array(numpy_helper.to_array(tensors[name]), name) for name in node.input[1:]}
        kept[weight + FOLD] = numpy_helper.from_array(factors, weight + FOLD)
        wide = factors.reshape(-1, *[1] * (values.ndim - 1))
        tensors[weight].CopyFrom(numpy_helper.from_array((values * wide).astype(np.float32), weight))
        graph.initializer.append(numpy_helper.from_array((beta - mean * factors).astype(np.float32), bias))
        convolution.input[2:] = [bias]
        convolution.output[0] = node.output[0]
        graph.node.remove(node)
    return kept
