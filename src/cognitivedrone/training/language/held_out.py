"""Sentences that no training contains: those of the suites written by hand.

The corpus and the generators write what people type, and so do people: now and then they write the same. What is held
out is drawn again, so that the suite stays a test.
"""

from __future__ import annotations

import functools

from cognitivedrone.models.words.text import words_of
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.suites import AUTHORED


def is_held_out(sentence: str) -> bool:
    """Whether a suite written by hand has this sentence, whatever its case and punctuation."""
    return plain(sentence) in held_out_sentences()


def plain(sentence: str) -> str:
    """The words of a sentence, in lower case and without punctuation."""
    return " ".join(word for word in words_of(sentence) if word.isalnum())


@functools.cache
def held_out_sentences() -> frozenset[str]:
    """All sentences of those suites, as `plain` writes them."""
    return frozenset(
        plain(task.instruction) for name in AUTHORED for track in load_suite(name).tracks for task in track
    )
