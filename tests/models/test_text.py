import pytest

from cognitivedrone.models.words.text_encoder import words_of


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
