"""Whole model files of a few hundred bytes: every contract of the real ones, and answers that tests can foresee."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from cognitivedrone.models.eyes.sight import EYES, EYES_FILE, FEATURES, LOOKS
from cognitivedrone.models.mind import LANGUAGE, LANGUAGE_FILE
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.small_file import STATE, ActionStatistics, Description, describe
from cognitivedrone.models.words.selector_file import SELECTOR, SELECTOR_FILE
from cognitivedrone.models.words.text_encoder import FILE, TEXT_ENCODER
from cognitivedrone.models.words.word_pieces import EMBEDDED, PIECES_FILE, WORD_PIECES

CHUNK = 2
WIDTH = 3
"""Of the tiny text encoder."""
DIGEST = "d" * 64
"""Of the tiny text encoder, and of its word pieces."""
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
    "slots": (TensorProto.FLOAT, ["batch", 3, 1 + FEATURES]),
    "whole": (TensorProto.FLOAT, ["batch", 1]),
    "state": (TensorProto.FLOAT, ["batch", STATE]),
}
READ: Inputs = {
    **{name: (TensorProto.INT64, ["batch", "length"]) for name in ("tokens", "positions", "parts")},
    EMBEDDED: (TensorProto.FLOAT, ["batch", "length", WIDTH]),
}
"""What text encoder and gate selector are given."""
OUTPUTS: Inputs = {
    "options": (TensorProto.FLOAT, ["batch", 4, CHUNK, 4]),
    "inclination": (TensorProto.FLOAT, ["batch", 4]),
}


def graph(inputs: Inputs = INPUTS, outputs: Inputs = OUTPUTS) -> onnx.ModelProto:
    """A head that answers every step of the chunk with the brightest pixel / 255, the height, a tenth of the number of
    the gate, 1 to 3, or 0 toward none, and the yaw rate, and is inclined to none.

    Other inputs and outputs make a graph that breaks the contract.
    """
    _, whole, state = inputs
    options, inclination = outputs
    node = helper.make_node
    nodes = [
        node("Slice", [state, "three", "five", "last"], ["motion"]),  # height and yaw rate
        node("Split", ["motion"], ["height", "turn"], axis=1, num_outputs=2),
        node("Mul", ["height", "nothing"], ["zero"]),
        node("Concat", [whole, "height", "zero", "turn"], ["command"], axis=1),
        node("Unsqueeze", ["command", "middle"], ["one"]),
        node("Add", ["one", "toward"], ["each"]),
        node("Unsqueeze", ["each", "steps"], ["step"]),
        node("Tile", ["step", "chunked"], [options]),
        node("Tile", ["zero", "four_times"], [inclination]),
    ]
    toward = np.zeros((1, 4, 4), np.float32)
    toward[0, :3, 2] = 0.1, 0.2, 0.3
    return model_of(nodes, inputs, outputs, _constants(
        three=[3], five=[5], last=[1], middle=[1], steps=[2], chunked=[1, 1, CHUNK, 1], four_times=[1, 4],
        nothing=np.float32(0), toward=toward,
    ))  # fmt: skip


def tiny_eyes(folder: Path, names: tuple[str, ...] = ()) -> Path:
    """Write eyes whose only feature is the brightest pixel / 255, which stands in all readings, too, where they have
    `names`; then they see three gates ahead, 3 m away, else nothing.
    """
    node = helper.make_node
    image: Inputs = {"image": (TensorProto.UINT8, ["batch", 256, 256, 3])}
    sizes: dict[str, list[Any]] = {"gates": [3, 4], "slots": [3, 1 + FEATURES], "whole": [1]}
    if names:
        sizes |= {"readings": [4, len(names)], "boxes": [4, 4]}
    outputs: Inputs = {name: (TensorProto.FLOAT, ["batch", *size]) for name, size in sizes.items()}
    values = {
        "gates": np.full((1, 3, 4), [128, 128, 0.9, 3] if names else 0),
        "slots": np.zeros((1, 3, 1 + FEATURES)),
        "readings": np.zeros((1, 4, max(len(names), 1))),
        "boxes": np.full((1, 4, 4), [128, 60, 30, 0.9]),
    }
    values = {name: value for name, value in values.items() if name in outputs}
    nodes = [
        node("Cast", ["image"], ["pixels"], to=TensorProto.FLOAT),
        node("ReduceMax", ["pixels", "all_but_batch"], ["brightest"], keepdims=0),
        node("Div", ["brightest", "white"], ["light"]),
        node("Reshape", ["light", "column"], ["whole"]),
        node("Reshape", ["light", "cube"], ["lights"]),
        node("Mul", ["lights", "nothing"], ["blank"]),
        *(node("Add", ["lights" if name == "readings" else "blank", f"{name}.value"], [name]) for name in values),
    ]
    constants: dict[str, Any] = {f"{name}.value": value.astype(np.float32) for name, value in values.items()}
    constants |= {"white": np.float32(255), "nothing": np.float32(0)}
    path = folder / EYES_FILE
    onnx.save(model_of(nodes, image, outputs, _constants(
        all_but_batch=[1, 2, 3], column=[-1, 1], cube=[-1, 1, 1], **constants
    )), str(path))  # fmt: skip
    write_table(path, EYES, {"facets": names, "width": 1, "classifier": False})
    return path


def tiny_language(folder: Path, names: tuple[str, ...], **fields: Any) -> Path:
    """Write a language for which no gate is what is asked for with the probability that is read of the first value, and
    that chooses the left gate for sentences that say little, the right one for those that say much (`heard`).
    """
    node = helper.make_node
    size = len(names)
    shapes: dict[str, list[Any]] = {
        "words": ["length", WIDTH],
        "panels": [3, size],
        "looks": [3, LOOKS],
        "board": [size],
        "seen": [],
    }
    inputs: Inputs = {name: (TensorProto.FLOAT, ["batch", *shape]) for name, shape in shapes.items()}
    outputs: Inputs = {"match": (TensorProto.FLOAT, ["batch", 4]), "choice": (TensorProto.FLOAT, ["batch", 3])}
    nodes = [
        node("ReduceSum", ["words", "all_words"], ["heard"], keepdims=0),
        node("Reshape", ["heard", "column"], ["told"]),
        node("Mul", ["told", "slope"], ["sloping"]),
        node("Add", ["sloping", "start"], ["choice"]),
        node("Slice", ["panels", "begin", "end", "axes"], ["first"]),
        node("Reshape", ["first", "column"], ["absent"]),
        node("Sub", ["one", "absent"], ["there"]),
        node("Concat", ["there", "there", "there", "absent"], ["shares"], axis=1),
        node("Div", ["shares", "parts"], ["each"]),
        node("Log", ["each"], ["match"]),
    ]
    path = folder / LANGUAGE_FILE
    onnx.save(model_of(nodes, inputs, outputs, _constants(
        all_words=[1, 2], column=[-1, 1], begin=[0, 0], end=[1, 1], axes=[1, 2], one=np.float32(1),
        slope=np.array([[-10, 0, 10]], np.float32), start=np.array([[4, 0, -5.5]], np.float32),
        parts=np.array([[3, 3, 3, 1]], np.float32),
    )), str(path))  # fmt: skip
    write_table(path, LANGUAGE, {"facets": names, "encoder": DIGEST, **fields})
    return path


def _constants(**values: Any) -> list[onnx.TensorProto]:
    return [
        numpy_helper.from_array(np.array(value, np.int64) if isinstance(value, list) else np.asarray(value), name)
        for name, value in values.items()
    ]


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
    """Write a head with what it says of itself, and eyes beside it."""
    described = description or DESCRIPTION
    tiny_eyes(path.parent, described.attributes)
    onnx.save(graph(**interface), str(path))
    describe(path, described)
    return path


def open_model_file(path: Path) -> Path:
    """A model that reads sentences, with all its files; in a white frame, what is asked for is not there."""
    tiny_encoder(path.parent)
    tiny_language(path.parent, OPEN_DESCRIPTION.attributes)
    return tiny_model(path, OPEN_DESCRIPTION)


def tiny_pieces(folder: Path, **fields: Any) -> Path:
    """Write word pieces of which each begins with its number / 100 as the first of three values; `fields` change what
    they say of themselves.
    """
    tokens: Inputs = {"tokens": (TensorProto.INT64, ["batch", "length"])}
    told: Inputs = {EMBEDDED: (TensorProto.FLOAT, ["batch", "length", WIDTH])}
    node = helper.make_node
    nodes = [
        node("Cast", ["tokens"], ["numbers"], to=TensorProto.FLOAT),
        node("Unsqueeze", ["numbers", "last"], ["column"]),
        node("Mul", ["column", "first"], [EMBEDDED]),
    ]
    initializers = [
        numpy_helper.from_array(np.array([-1], np.int64), "last"),
        numpy_helper.from_array(np.array([0.01, 0, 0], np.float32), "first"),
    ]
    path = folder / PIECES_FILE
    onnx.save(model_of(nodes, tokens, told, initializers), str(path))
    write_table(path, WORD_PIECES, {"pieces": PIECES, "digest": DIGEST, "size": WIDTH, **fields})
    return path


def tiny_encoder(folder: Path, **fields: Any) -> Path:
    """Write a text encoder that leaves its tokens as they begin, and its word pieces; `fields` change what it says of
    itself.
    """
    tiny_pieces(folder)
    told: Inputs = {"words": (TensorProto.FLOAT, ["batch", "length", WIDTH])}
    path = folder / FILE
    node = helper.make_node("Identity", [EMBEDDED], ["words"])
    onnx.save(model_of([node], READ, told, []), str(path))
    write_table(path, TEXT_ENCODER, {"words": DIGEST, "digest": DIGEST, **fields})
    return path


def heard(text: str) -> float:
    """What a tiny language hears of a sentence of known words: the sum of its tokens / 100."""
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
    readings, looks, boxes = (np.asarray(part, np.float32) for part in reading)
    slots = np.concatenate([np.zeros((3, 1 + FEATURES - LOOKS), np.float32), looks], axis=1)
    told = {"gates": boxes[:3], "slots": slots, "whole": np.zeros(1, np.float32), "readings": readings, "boxes": boxes}
    outputs: Inputs = {name: (TensorProto.FLOAT, ["batch", *value.shape]) for name, value in told.items()}
    eyes = folder / EYES_FILE
    onnx.save(_constant({"image": (TensorProto.UINT8, ["batch", 256, 256, 3])}, outputs, told), str(eyes))
    write_table(eyes, EYES, {**table, "width": 1})
    answer = {"logits": np.array(logits, np.float32)}
    selector = folder / SELECTOR_FILE
    onnx.save(_constant(READ, {"logits": (TensorProto.FLOAT, ["batch", len(logits)])}, answer), str(selector))
    write_table(selector, SELECTOR, {**table, "words": DIGEST, "notes": {}})
    tiny_encoder(folder)
    shapes: dict[str, list[int | str]] = {
        "words": ["length", WIDTH],
        "panels": [3, count],
        "looks": [3, LOOKS],
        "board": [count],
        "seen": [],
    }
    inputs: Inputs = {name: (TensorProto.FLOAT, ["batch", *size]) for name, size in shapes.items()}
    answer = {"match": np.array(language, np.float32), "choice": np.array(language[:3], np.float32)}
    outputs = {name: (TensorProto.FLOAT, ["batch", len(value)]) for name, value in answer.items()}
    path = folder / LANGUAGE_FILE
    onnx.save(_constant(inputs, outputs, answer), str(path))
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
