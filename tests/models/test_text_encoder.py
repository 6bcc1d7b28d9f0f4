"""The text encoder: words, word pieces, scenes as numbers, bounds for any text, a sentence on a bad file."""

import numpy as np
import pytest
from tiny import DIGEST, PIECES, WIDTH, heard, tiny_encoder, tiny_model, tiny_pieces

from cognitivedrone.errors import ModelError
from cognitivedrone.models.words import text_encoder
from cognitivedrone.models.words.scene_tokens import INPUTS, LENGTHS, SceneText, SceneTokenizer, stacked
from cognitivedrone.models.words.text_encoder import (
    TextEncoderModel,
    encoder_of,
    packaged_encoder,
    packed,
    parts_of,
    words_of,
)


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


BERT = ("[PAD]", "[UNK]", "[CLS]", "fly", "to", "the", "cat", "##s", "left", "gate", ",", "5")
TOKENIZER = SceneTokenizer(BERT)
TEXT = SceneText("Fly to the cats", "", ("left gate, cat", "gate 5", "Gäte"))


def test_every_part_begins_anew() -> None:
    tokens, positions, parts = TOKENIZER.encode(TEXT.parts)
    words = [BERT[token] for token in tokens]
    assert words[:6] == ["[CLS]", "fly", "to", "the", "cat", "##s"]
    assert words[6:] == ["[CLS]", "[CLS]", "left", "gate", ",", "cat", "[CLS]", "gate", "5", "[CLS]", "gate"]
    assert positions.tolist() == [0, 1, 2, 3, 4, 5, 0, 0, 1, 2, 3, 4, 0, 1, 2, 0, 1]
    assert parts.tolist() == [0] * 6 + [1] + [2] * 5 + [3] * 3 + [4] * 2


@pytest.mark.parametrize("text", ["cat " * 100_000, "\U0001f600" * 2000, "x" * 1_000_000, "", "\x00\u202e", "飛行機へ"])
def test_any_text_takes_a_bounded_length(text: str) -> None:
    tokens, *_ = TOKENIZER.encode([text] * 5)
    assert 5 <= len(tokens) <= sum(LENGTHS)


def test_a_batch_is_padded_with_nothing() -> None:
    batch = stacked([TOKENIZER.encode(TEXT.parts), TOKENIZER.encode(["", "", "", "", ""])])
    assert {name: values.shape for name, values in batch.items()} == dict.fromkeys(INPUTS, (2, 17))
    assert (batch["tokens"][1, 5:] == 0).all()
    np.testing.assert_array_equal(batch["parts"][1, :5], range(5))


@pytest.mark.parametrize("pieces", [(), ("a", "b"), (*BERT, "cat"), ("[UNK]", "[PAD]", "[CLS]")])
def test_a_list_that_is_no_vocabulary_is_refused(pieces: tuple[str, ...]) -> None:
    with pytest.raises(ModelError, match="is no word-piece vocabulary"):
        SceneTokenizer(pieces)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Fly to gate 3*3!", ["fly", "to", "gate", "3", "*", "3", "!"]),
        ("7×9", ["7", "×", "9"]),
        ("McDonald's and McDonald\u2019s", ["mcdonald", "and", "mcdonald"]),
        ("the letter 'S'", ["the", "letter", "'", "s", "'"]),
        ("CAFÉ Zürich", ["cafe", "zurich"]),
        ("A4 number17", ["a", "4", "number", "17"]),
        ("１２ polar_bear", ["12", "polar", "_", "bear"]),
        ("\t \n", []),
    ],
)
def test_a_sentence_is_parted_into_words(text, words):
    assert words_of(text) == words
