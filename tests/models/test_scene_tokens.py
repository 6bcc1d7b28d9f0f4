"""Scenes in words as numbers: the pieces of BERT, five parts that begin anew, and bounds for any text."""

import numpy as np
import pytest

from cognitivedrone.errors import ModelError
from cognitivedrone.models.words.scene_tokens import INPUTS, LENGTHS, SceneText, SceneTokenizer, stacked

PIECES = ("[PAD]", "[UNK]", "[CLS]", "fly", "to", "the", "cat", "##s", "left", "gate", ",", "5")
TOKENIZER = SceneTokenizer(PIECES)
TEXT = SceneText("Fly to the cats", "", ("left gate, cat", "gate 5", "Gäte"))


def test_every_part_begins_anew() -> None:
    tokens, positions, parts = TOKENIZER.encode(TEXT.parts)
    words = [PIECES[token] for token in tokens]
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


@pytest.mark.parametrize("pieces", [(), ("a", "b"), (*PIECES, "cat"), ("[UNK]", "[PAD]", "[CLS]")])
def test_a_list_that_is_no_vocabulary_is_refused(pieces: tuple[str, ...]) -> None:
    with pytest.raises(ModelError, match="is no word-piece vocabulary"):
        SceneTokenizer(pieces)
