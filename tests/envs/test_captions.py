from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.envs.captions import font, readable, wrap


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
