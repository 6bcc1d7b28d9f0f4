"""A model file explains itself, and one that does not keep to the contract is refused in one sentence."""

import json
import re
import sys

import numpy as np
import onnx
import pytest
from onnx import TensorProto
from tiny import (
    DESCRIPTION,
    INPUTS,
    OPEN_DESCRIPTION,
    OUTPUTS,
    graph,
    heard,
    open_model_file,
    tiny_encoder,
    tiny_eyes,
    tiny_language,
    tiny_model,
)

from cognitivedrone.errors import MissingExtra, ModelError, PolicyError
from cognitivedrone.models.onnx_file import BLANK, KEY, numbers_of, seal
from cognitivedrone.models.small_file import KIND, SmallModel, describe, read_description


def images(*brightness: int):
    return np.stack([np.full((256, 256, 3), value, np.uint8) for value in brightness])


def states(n: int):
    return np.tile(np.array([0.1, 0.2, 0.3, 0.9, -0.5], np.float32), (n, 1))


def with_metadata(path, metadata: str):
    model = graph()
    onnx.helper.set_model_props(model, {KEY: metadata})
    onnx.save(model, str(path))
    if BLANK in metadata:
        seal(path)
    return path


def changed(**fields):
    return json.dumps({"format": 2, "checksum": BLANK, "kind": KIND, **DESCRIPTION.table(), **fields})


def changed_action(**fields):
    return changed(action={**DESCRIPTION.table()["action"], **fields})


def refused(path) -> str:
    """Why a file is refused, by both ways to read it where both can tell."""
    with pytest.raises(PolicyError) as error:
        SmallModel.load(path)
    message = str(error.value)
    assert "\n" not in message
    assert str(path.parent) in message
    return message


def test_a_file_says_of_itself_what_was_written(tiny_model_file):
    assert read_description(tiny_model_file) == DESCRIPTION
    assert SmallModel.load(tiny_model_file).description == DESCRIPTION


def test_describing_again_replaces_and_keeps_what_others_wrote(tmp_path):
    path = tmp_path / "model.onnx"
    model = graph()
    onnx.helper.set_model_props(model, {"exporter": "someone", KEY: "old"})
    onnx.save(model, str(path))
    describe(path, DESCRIPTION)
    describe(path, DESCRIPTION)
    assert read_description(path) == DESCRIPTION
    assert {entry.key: entry.value for entry in onnx.load(str(path)).metadata_props}["exporter"] == "someone"
    assert [file.name for file in tmp_path.iterdir()] == ["model.onnx"]


def test_describing_without_onnx_says_what_to_install(tiny_model_file, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(MissingExtra, match=r"cognitivedrone\[train\]"):
        describe(tiny_model_file, DESCRIPTION)


def test_it_sees_and_flies_several_frames(tiny_model_file):
    model = SmallModel.load(tiny_model_file)
    sight = model.eyes.see(images(0, 51, 255))
    flown = model.fly(sight, states(3))
    assert sight.gates.shape == (3, 3, 4)
    assert sight.readings is None
    assert flown.options.shape == (3, 4, 2, 4)
    assert np.allclose(flown.options[:, 0, 0, 0], [0, 0.2, 1])
    assert np.allclose(flown.options[:, 3, 1, 1], 0.9)
    assert np.allclose(flown.options[:, 0, 0, 3], -0.5)
    assert flown.inclination.shape == (3, 4)
    assert model.mind is None


def test_the_same_frame_is_looked_at_once_whoever_asks(tiny_model_file):
    first, second = (SmallModel.load(tiny_model_file).eyes for _ in range(2))
    assert first is second
    frame = images(77)
    seen = first.see(frame)
    assert second.see(frame.copy()) is seen
    frame[:] = 78
    assert first.see(frame) is not seen
    assert first.see(images(77)) is seen


def test_the_same_input_gives_the_same_bits_alone_and_in_another_session(tiny_model_file):
    first, second = (SmallModel.load(tiny_model_file, threads=threads) for threads in (1, 2))
    one, other = (model.fly(model.eyes.see(images(77)), states(1)) for model in (first, second))
    assert first.eyes is not second.eyes
    assert np.array_equal(one.options, other.options)


@pytest.mark.parametrize(
    ("frames", "motion", "says"),
    [
        (np.zeros((1, 128, 128, 3), np.uint8), states(1), r"images of uint8 \(n, 256, 256, 3\)"),
        (np.zeros((1, 256, 256, 3), np.float32), states(1), "not float32"),
        (images(0), states(2), r"states must be float32 \(1, 5\)"),
        (images(0), np.zeros((1, 4), np.float32), r"states must be float32 \(1, 5\)"),
        (images(0), np.zeros((1, 5)), "not float64"),
    ],
)
def test_inputs_of_other_shapes_are_refused(tiny_model_file, frames, motion, says):
    model = SmallModel.load(tiny_model_file)
    with pytest.raises(PolicyError, match=says):
        model.fly(model.eyes.see(frames), motion)


@pytest.mark.parametrize("name", ["eyes.onnx", "language.onnx"])
def test_a_part_that_is_missing_or_of_another_model_is_said(tmp_path, name):
    path = open_model_file(tmp_path / "model.onnx")
    write = {"eyes.onnx": tiny_eyes, "language.onnx": tiny_language}[name]
    write(tmp_path, ("kind/thing", "kind/unknown", "concept/thing:dog"))
    assert "do not belong together" in refused(path)
    (tmp_path / name).unlink()
    assert f"{name} is missing beside" in refused(path)


def test_a_file_that_is_not_there(tmp_path):
    assert "no model file" in refused(tmp_path / "none.onnx")
    assert "no model file" in refused(tmp_path)


@pytest.mark.parametrize("kept", [0.0, 0.01, 0.5, 0.95])
def test_a_file_that_was_cut_short(tmp_path, tiny_model_file, kept):
    content = tiny_model_file.read_bytes()
    path = tmp_path / "cut.onnx"
    path.write_bytes(content[: int(len(content) * kept)])
    says = "cut short|does not match its checksum"
    assert re.search(says, refused(path))
    with pytest.raises(PolicyError, match=says):
        read_description(path)


def test_an_operator_that_the_runtime_does_not_have(tmp_path):
    model = graph()
    model.graph.node[0].op_type = "Imagine"
    onnx.save(model, str(tmp_path / "model.onnx"))
    assert "cannot load" in refused(tmp_path / "model.onnx")


def test_a_file_that_does_not_describe_itself(tmp_path):
    path = tmp_path / "bare.onnx"
    onnx.save(graph(), str(path))
    assert "lacks the metadata" in refused(path)


@pytest.mark.parametrize(
    ("metadata", "says"),
    [
        ("{", "is not JSON"),
        ("[]", "format None"),
        (changed(format=3), "format 3 and this version reads formats 1 and 2"),
        (changed(format=True), "format True and this version reads"),
        (changed(kind="reasoner"), "kind 'reasoner'"),
        (changed(kind=[]), "kind [], not"),
        (changed(facets=["a", 7]), "'facets' of the description"),
        (changed(kind="small-vla"), "reads sentences by a list of words; use the release that it came with"),
        (changed(kind="small-policy"), "sees and flies by one file; use the release that it came with"),
        (changed(encoder=None), "'encoder'"),
        (changed(chunk=0), "'chunk'"),
        (changed(chunk=True), "'chunk'"),
        (changed(image_size=128), "128 pixels"),
        (changed(action=None), "'action'"),
        (changed(action={}), "lacks 'low'"),
        (changed_action(mean=[0, 0, 0]), "'mean'"),
        (changed_action(std=[0, 0, 0, float("nan")]), "NaN is no finite number"),
        (changed_action(q01=[0, 0, 0, "1"]), "'q01'"),
        (changed_action(high=[2, 2, -1.5, 1]), "below its high"),
        (changed(provenance={}), "lacks 'recipe'"),
    ],
)
def test_a_description_that_cannot_be_trusted(tmp_path, metadata, says):
    path = with_metadata(tmp_path / "model.onnx", metadata)
    assert says in refused(path)
    with pytest.raises(PolicyError):
        read_description(path)


@pytest.mark.parametrize(
    ("interface", "says"),
    [
        ({"inputs": {**INPUTS, "slots": (TensorProto.DOUBLE, ["batch", 3, 17])}}, "input 'slots'"),
        ({"inputs": {**INPUTS, "slots": (TensorProto.FLOAT, ["batch", 3, 9])}}, "input 'slots'"),
        ({"inputs": {**INPUTS, "state": (TensorProto.FLOAT, [1, 5])}}, "input 'state'"),
        (
            {"inputs": {"slots": INPUTS["slots"], "all": INPUTS["whole"], "state": INPUTS["state"]}},
            "inputs slots, all, state; expected slots, whole, state",
        ),
        (
            {"outputs": {"actions": OUTPUTS["options"], "inclination": OUTPUTS["inclination"]}},
            "outputs actions, inclination",
        ),
    ],
)
def test_a_graph_of_another_interface(tmp_path, interface, says):
    assert says in refused(tiny_model(tmp_path / "model.onnx", **interface))


def test_a_chunk_other_than_described(tmp_path):
    tiny_eyes(tmp_path)
    path = with_metadata(tmp_path / "model.onnx", changed(chunk=3))
    assert "output 'options'" in refused(path)


# ---- files of models that read sentences


def test_a_model_that_reads_sentences_weighs_the_gates(tmp_path):
    model = SmallModel.load(open_model_file(tmp_path / "open.onnx"))
    assert model.description == read_description(tmp_path / "open.onnx") == OPEN_DESCRIPTION
    assert model.mind is not None
    sight = model.eyes.see(images(51))
    for text, gate in (("the letter a", 0), ("fly through the red gate", 1), ("fly through the small round gate", 2)):
        told = model.mind.weigh(text, sight.readings[0, :3], sight.looks[0], sight.readings[0, 3])
        assert told.choice.argmax() == gate
        assert np.allclose(told.choice, [4 - 10 * heard(text), 0, 10 * heard(text) - 5.5], atol=1e-5)
        assert np.exp(told.match[3]) == pytest.approx(0.2)


def test_a_model_is_run_with_the_text_encoder_that_it_was_trained_with(tmp_path):
    path = open_model_file(tmp_path / "open.onnx")
    tiny_encoder(tmp_path, digest="e" * 64)
    assert "was trained with another text encoder than" in refused(path)
    # Without one beside it, the packaged one is taken, which is another one, too.
    (tmp_path / "text_encoder.onnx").unlink()
    assert "was trained with another text encoder than" in refused(path)
    assert read_description(path) == OPEN_DESCRIPTION


class Session:
    """Answers with what it was made with."""

    def __init__(self, *answers: list[float]) -> None:
        self.answers = [np.array(each, np.float32) for each in answers]

    def run(self, outputs: tuple[str, ...], inputs: object) -> list[np.ndarray]:
        return self.answers[: len(outputs)]


def test_values_that_are_no_numbers_are_told_with_their_network() -> None:
    sound = numbers_of(Session([1.0, -np.inf]), ("logits",), {}, "the gate selector")
    assert sound[0].tolist() == [1.0, -np.inf]  # as of what is masked
    with pytest.raises(ModelError, match=r"the gate selector answers with values that are not numbers \(looks\)"):
        numbers_of(Session([1.0], [np.nan]), ("readings", "looks"), {}, "the gate selector")
