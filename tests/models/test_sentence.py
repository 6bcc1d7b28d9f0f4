"""Words are embedded by what was taught of them, by their word vectors and by their spelling."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from cognitivedrone.errors import ModelError
from cognitivedrone.models import word_vectors as table
from cognitivedrone.models.sentence import TextLayer, WordConfig, WordEmbedding
from cognitivedrone.models.text import GRAM_BUCKETS, GRAMS, Lexicon
from cognitivedrone.models.word_vectors import SCALE, SIZE, word_vectors

LEXICON = Lexicon.of(["the cat and the dog"], ["kitten", "violin"])
WIDTH = 16

pytestmark = pytest.mark.usefixtures("one_thread")


def embedding() -> WordEmbedding:
    torch.manual_seed(0)
    made = WordEmbedding(WordConfig(len(LEXICON.words), LEXICON.trained), WIDTH)
    rows = {word: row for row, word in enumerate(word_vectors().words)}
    for number, word in enumerate(LEXICON.words):
        if word in rows:
            made.vectors[number] = torch.from_numpy(word_vectors().vectors[rows[word]])
    return made.eval()


def tokens(text: str, length: int = 6) -> torch.Tensor:
    return torch.from_numpy(LEXICON.encode(text, length))[None]


def test_words_that_are_used_alike_have_vectors_that_are_alike() -> None:
    words, vectors = word_vectors()
    assert len(set(words)) == len(words) > 10_000
    assert vectors.dtype == np.int8
    rows = {word: row for row, word in enumerate(words)}

    def alike(one: str, other: str) -> float:
        a, b = (vectors[rows[word]].astype(float) * SCALE for word in (one, other))
        return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))

    for one, near, far in (
        ("cat", "dog", "violin"),
        ("guitar", "violin", "bread"),
        ("red", "blue", "seven"),
        ("seven", "eight", "horse"),
        ("left", "right", "cheese"),
    ):
        assert alike(one, near) > alike(one, far) + 0.2, (one, near, far)


@pytest.mark.parametrize("content", [None, b"", b"not a table", "other"])
def test_a_table_of_word_vectors_that_is_missing_or_damaged(tmp_path, monkeypatch, content) -> None:
    path = tmp_path / "weights" / table.FILE
    path.parent.mkdir()
    if isinstance(content, bytes):
        path.write_bytes(content)
    if content == "other":
        save_file({"vectors": np.zeros((3, SIZE), np.int8)}, path, metadata={"words": "cat dog"})
    monkeypatch.setattr(table.resources, "files", lambda _: tmp_path)
    with pytest.raises(ModelError, match="the word vectors") as told:
        table.word_vectors.__wrapped__()
    assert "\n" not in str(told.value)


def test_a_word_is_its_own_embedding_its_vector_and_its_spelling() -> None:
    made = embedding()
    (row,) = made(tokens("cat", 1))[0]
    number = LEXICON.words.index("cat")
    groups = LEXICON.encode("cat", 1)[0, 1:]
    with torch.no_grad():
        spelling = made.groups.weight[groups[groups > 0]].sum(0) / 3**0.5
        meaning = made.meaning.weight @ (made.vectors[number].float() * SCALE)
        torch.testing.assert_close(row, made.own.weight[number] + meaning + spelling)
        # Of a word that no training sentence had, the vector and the spelling are left.
        (kitten,) = made(tokens("kitten", 1))[0]
        vector = made.meaning.weight @ (made.vectors[LEXICON.words.index("kitten")].float() * SCALE)
        groups = LEXICON.encode("kitten", 1)[0, 1:]
        torch.testing.assert_close(kitten, vector + made.groups.weight[groups[groups > 0]].sum(0) / 6**0.5)


def test_padding_is_nothing_and_unknown_words_are_their_spelling() -> None:
    made = embedding()
    with torch.no_grad():
        assert (made(tokens("", 3)) == 0).all()
        one, other, same = (made(tokens(word, 1))[0, 0] for word in ("zorblax", "quibber", "zorblax"))
    assert (one != other).any()
    assert torch.equal(one, same)
    assert one.abs().max() > 0


def test_words_are_hidden_while_training_only() -> None:
    made = embedding()
    many = tokens("cat dog cat dog cat dog").expand(200, -1, -1)
    with torch.no_grad():
        whole = made(many)
        assert torch.equal(made(many), whole)
        torch.manual_seed(1)
        noisy = made.train()(many)
        unread = torch.zeros_like(many[..., :1]) + 1
        hidden = made.eval()(torch.cat([unread, many[..., 1:]], dim=-1)) + made.meaning(
            made.vectors[many[..., 0]].float() * SCALE
        )
    changed = (noisy != whole).any(-1)
    assert changed.float().mean() == pytest.approx(WordEmbedding.hidden, abs=0.04)
    torch.testing.assert_close(noisy[changed], hidden[changed])


def test_every_token_can_be_embedded() -> None:
    made = embedding()
    extreme = torch.full((1, 2, 1 + GRAMS), GRAM_BUCKETS)
    extreme[..., 0] = len(LEXICON.words) - 1
    assert made(extreme).isfinite().all()


def test_a_layer_does_not_attend_to_what_is_masked() -> None:
    torch.manual_seed(0)
    layer = TextLayer(WIDTH)
    x = torch.randn(2, 5, WIDTH)
    bias = torch.zeros(2, 1, 1, 5)
    bias[..., 3:] = -1e4
    changed = x.clone()
    changed[:, 3:] += 1
    with torch.no_grad():
        torch.testing.assert_close(layer(x, bias)[:, :3], layer(changed, bias)[:, :3])
        torch.testing.assert_close(layer(x, bias)[:, :3], layer(x[:, :3], bias[..., :3]))
