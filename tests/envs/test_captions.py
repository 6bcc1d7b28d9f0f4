import unicodedata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.envs import captions
from cognitivedrone.envs.captions import drawable, font, readable, wrap


@given(st.text(st.characters(codec="ascii"), max_size=200), st.integers(40, 400), st.integers(1, 5))
def test_no_line_is_wider_and_there_are_no_more_lines_than_asked(text, width, lines):
    face = font(16)
    wrapped = wrap(text, width, face, lines)
    assert len(wrapped) <= lines
    assert all(face.getlength(line) <= width for line in wrapped)


@given(st.lists(st.sampled_from(["gate", "elephant", "a", "through"]), max_size=30))
def test_every_word_is_kept_where_there_is_room(words):
    assert " ".join(wrap(" ".join(words), 120, font(16), 100)).split() == words


def test_what_does_not_fit_ends_in_an_ellipsis_and_long_words_are_broken():
    assert wrap("one two three four five six", 60, font(16), 2)[-1].endswith("...")
    broken = wrap("x" * 100, 60, font(16), 100)
    assert len(broken) > 1
    assert "".join(broken) == "x" * 100


@pytest.mark.parametrize(
    ("option", "read"),
    [
        ("polar_bear", "polar bear"),
        ("animal/cat=3+food/apple=1", "cat 3, apple 1"),
        ("hair=bun,hair_color=red,beard=full", "red bun, full beard, blue T-shirt, smiling"),
        ("hat=hijab,hat_color=yellow,glasses=round,expression=sad", "yellow headscarf, round glasses, sad"),
        ("price=high", "price high"),
        ("14/7", "7"),
    ],
)
def test_options_are_shown_as_one_reads_them(option, read):
    assert readable(option) == read


@pytest.mark.parametrize("text", ["\ud800 gate", "a\x00b \x1b[31m", "\u0628\u0631\u062c \U0001f600", "y" * 1_000_000])
def test_any_text_can_be_wrapped(text):
    face = font(16)
    assert all(face.getlength(line) <= 200 for line in wrap(text, 200, face, 3))


LETTERS = [
    chr(code)
    for first, last in ((0x20, 0x24F), (0x370, 0x3FF), (0x400, 0x525), (0x1E00, 0x1EF9), (0x1F00, 0x1FFF))
    for code in range(first, last + 1)
    if unicodedata.category(chr(code))[0] in "LNPSZ"
]
"""Of Latin, Greek and Cyrillic texts, with Vietnamese and old Greek."""


def test_latin_greek_and_cyrillic_letters_are_drawn():
    assert len(LETTERS) > 1400
    box = bytes(font(40).getmask("\uffff"))
    for letter in LETTERS:
        assert drawable(letter) == unicodedata.normalize("NFC", letter)
        assert bytes(font(40).getmask(letter)) != box
    shapes = {bytes(font(40).getmask(letter)) for letter in "éèêeàáäαβγδжзийłøşğűắ"}
    assert len(shapes) == 21


@pytest.mark.parametrize(
    ("text", "drawn"),
    [
        ("Fliege zum Bären, cafe\u0301, Łódź", "Fliege zum Bären, café, Łódź"),
        ("Лети к їжаку", "Лети к їжаку"),
        ("飞到有狗的门", "[6 CJK letters]"),
        ("gate \u0628\u0631\u062c \u0628\u0631 (5)", "gate [5 Arabic letters] (5)"),
        ("ท", "[1 Thai letter]"),
        ("the 🐶 now", "the [dog face] now"),
        ("ＡＢ 𝐂 ☕\ufe0f", "AB C ☕"),
        ("\ue000\x1b[31m", "[U+E000][U+001B][31m"),
        ("אב \n ok\n", "[2 Hebrew letters] \n ok\n"),
        ("", ""),
    ],
)
def test_what_the_font_lacks_is_said(text, drawn):
    assert drawable(text) == drawn


@given(st.text(max_size=60))
def test_nothing_is_drawn_as_an_empty_box(text):
    box = bytes(font(40).getmask("\uffff"))
    assert all(bytes(font(40).getmask(each)) != box for each in drawable(text) if not each.isspace())
    assert drawable(drawable(text)) == drawable(text)


def test_the_font_may_be_passed_on():
    folder = Path(captions.__file__).parent / "fonts"
    for file in folder.glob("*.ttf"):
        assert "Permission is hereby granted" in file.with_suffix(".txt").read_text("utf-8")
        assert f"src/cognitivedrone/envs/fonts/{file.name}" in (Path(__file__).parents[2] / "NOTICE").read_text("utf-8")
