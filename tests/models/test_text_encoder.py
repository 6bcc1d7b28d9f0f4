"""The text encoder's file: the same meaning alone and in a batch, bounds for any text, a sentence on a bad file."""

import numpy as np
import pytest
from tiny import DIGEST, PIECES, WIDTH, heard, tiny_encoder, tiny_model, tiny_pieces

from cognitivedrone.errors import ModelError
from cognitivedrone.models.words import text_encoder
from cognitivedrone.models.words.scene_tokens import LENGTHS
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of, packaged_encoder, packed, parts_of


@pytest.fixture
def encoder(tmp_path):
    return TextEncoderModel.load(tiny_encoder(tmp_path))


def refused(load) -> str:
    with pytest.raises(ModelError) as error:
        load()
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_sentence_has_the_same_words_alone_and_in_a_batch(encoder):
    assert (encoder.digest, encoder.size, encoder.pieces.known) == (DIGEST, WIDTH, PIECES)
    texts = ["fly", "fly through the small gate", "the gate"]
    batch = encoder.batch(texts)
    assert batch.shape == (3, 6, WIDTH)
    for text, row in zip(texts, batch, strict=True):
        words = encoder.words(text)
        np.testing.assert_array_equal(row[: len(words)], words)
        assert not row[len(words) :].any()
        assert words.sum() == pytest.approx(heard(text))
    np.testing.assert_array_equal(packed([encoder.words(text) for text in texts]), batch)


def test_a_calculation_is_read_with_its_result():
    assert parts_of("Fly to the gate with 3 + 4") == ("Fly to the gate with 3 + 4", "answer: 7 seven")
    assert parts_of("Fly to the letter A") == ("Fly to the letter A",)


def test_words_of_a_sentence_are_remembered_but_not_of_endlessly_many(encoder, monkeypatch):
    monkeypatch.setattr(text_encoder, "_KEPT", 3)
    first = encoder.words("gate a")
    assert encoder.words("gate a") is first
    for text in ("b", "c", "gate", "left"):
        encoder.words(text)
    assert len(encoder._known) == 3
    np.testing.assert_array_equal(encoder.words("gate a"), first)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "gate " * 400,
        "x" * 2000,
        "12 + " * 500 + "1",
        "飛行機へ進め",
        "الباب الأحمر",
        "\U0001f600\U0001f6f8",
        "\x00\u202e",
    ],
)
def test_any_text_is_read_in_bounded_time(encoder, text):
    words = encoder.words(text)
    assert 1 <= len(words) <= sum(LENGTHS[:2])
    assert np.isfinite(words).all()


@pytest.mark.skipif(not packaged_encoder().is_file(), reason="this checkout has no weights")
def test_the_packaged_encoder_reads_any_text_and_tells_sentences_apart():
    encoder = TextEncoderModel.load()
    for text in ("", "gate " * 400, "飛行機へ進め", "\U0001f600"):
        assert np.isfinite(encoder.words(text)).all()
    assert encoder.words("the cat").shape == encoder.words("the dog").shape
    assert np.abs(encoder.words("the cat") - encoder.words("the dog")).max() > 0.01
    batch = encoder.batch(["the cat", "fly to the gate that shows neither a cat nor a dog"])
    np.testing.assert_allclose(batch[0, : len(encoder.words("the cat"))], encoder.words("the cat"), atol=1e-4)


# ---- files


def test_the_encoder_beside_a_model_comes_before_the_packaged_one(tmp_path):
    assert encoder_of(tmp_path / "model.onnx") == packaged_encoder()
    path = tiny_encoder(tmp_path)
    assert encoder_of(tmp_path / "model.onnx") == path


def test_another_encoder_than_a_model_was_trained_with_is_refused(tmp_path):
    path = tiny_encoder(tmp_path)
    assert TextEncoderModel.of_digest(DIGEST, tmp_path / "model.onnx").digest == DIGEST
    says = refused(lambda: TextEncoderModel.of_digest("e" * 64, tmp_path / "model.onnx"))
    assert says.startswith(f"{tmp_path / 'model.onnx'} was trained with another text encoder than {path}; put the")


def test_a_file_of_another_kind_is_refused(tmp_path):
    path = tiny_model(tmp_path / "model.onnx")
    says = refused(lambda: TextEncoderModel.load(path))
    assert "is a model of kind 'flight-head', not 'text-encoder'" in says


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"words": 3}, "'words'"),
        ({"words": "e" * 64}, "was trained with other word pieces than"),
        ({"digest": 3}, "'digest'"),
    ],
)
def test_a_description_that_cannot_be_trusted(tmp_path, fields, says):
    path = tiny_encoder(tmp_path, **fields)
    assert says in refused(lambda: TextEncoderModel.load(path))


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"pieces": ["[PAD]", 1]}, "an entry that is not a word"),
        ({"pieces": ["fly"]}, "is no word-piece vocabulary"),
        ({"digest": 3}, "'digest'"),
        ({"size": 0}, "'size'"),
        ({"size": 5}, "output 'embedded'"),
    ],
)
def test_word_pieces_that_cannot_be_trusted(tmp_path, fields, says):
    path = tiny_encoder(tmp_path)
    tiny_pieces(tmp_path, **fields)
    assert says in refused(lambda: TextEncoderModel.load(path))
