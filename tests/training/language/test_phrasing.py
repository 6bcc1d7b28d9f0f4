"""More ways to say the same: they fill in, they are used, and nothing that is held out is among them."""

from __future__ import annotations

import numpy as np
import pytest

from cognitivedrone.tasks import BASE_FAMILIES, facts, wording
from cognitivedrone.tasks.generate import HELD_OUT, TRAIN
from cognitivedrone.tasks.people import HELD_OUT_CAST
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.tasks.vocabulary import HELD_OUT_FONTS, HELD_OUT_STYLES
from cognitivedrone.training.language.phrasing import MORE, MORE_FRAMES, SPOKEN

LISTS = {
    value[0]: value
    for name, value in vars(wording).items()
    if name.isupper() and "FRAMES" not in name and name != "NUMBER_WORDS"
} | {fact.phrases[0]: fact.phrases for fact in facts.FACTS}


def said(phrase: str) -> str:
    return phrase.replace("{x}", "").strip().lower()


def test_every_list_of_phrases_has_more_and_none_of_them_is_held_out() -> None:
    assert set(MORE) == set(LISTS)
    held_out = {said(phrase) for phrases in LISTS.values() for phrase in HELD_OUT.wordings(phrases)}
    for first, phrases in MORE.items():
        assert len(set(phrases)) == len(phrases) > 0, first
        assert not set(phrases) & set(LISTS[first]), first
        for phrase in phrases:
            assert not any(kept in phrase.lower() for kept in held_out - {""}), phrase


def test_no_frame_is_one_of_those_held_out() -> None:
    assert len({*SPOKEN.frames}) == len(TRAIN.frames) + len(MORE_FRAMES)
    openings = [frame.partition("{x}")[0].strip().lower() for frame in wording.HELD_OUT_FRAMES]
    assert all(openings)
    for frame in MORE_FRAMES:
        assert frame.count("{x}") == 1
        assert not any(opening in frame.lower() for opening in openings), frame


@pytest.mark.parametrize("family", BASE_FAMILIES)
def test_tasks_are_said_in_more_ways_with_the_same_ingredients(family: str) -> None:
    spoken, plain = (
        [drawn_task(family, np.random.default_rng([9, i]), "task", pools) for i in range(150)]
        for pools in (SPOKEN, TRAIN)
    )
    assert len({task.instruction for task in spoken}) > len({task.instruction for task in plain})
    for task in spoken:
        assert "{" not in task.instruction
        assert not set(task.options) & set(HELD_OUT_CAST)
        styles = {label.rpartition("@")[2] for label in task.labels}
        assert not styles & {*HELD_OUT_FONTS, *HELD_OUT_STYLES}
