import re
from dataclasses import replace
from pathlib import Path

import benchmark_fakes
import pytest

from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.scores.published import PUBLISHED, comparable

ROOT = Path(__file__).parents[3]
SYSTEMS = {score.name: score for score in PUBLISHED}


def percent(rate):
    return f"{100 * rate:.1f}"


def test_the_numbers_are_the_papers():
    table = {
        "CognitiveDrone": (59.6, {"reasoning": 70.7, "human_recognition": 45.2, "symbol_understanding": 57.7}),
        "CognitiveDrone-R1": (77.2, {"reasoning": 75.9, "human_recognition": 76.8, "symbol_understanding": 78.9}),
        "RaceVLA": (31.3, {"reasoning": 36.2, "human_recognition": 23.1, "symbol_understanding": 34.6}),
    }
    assert {
        name: (100 * s.overall, {category: 100 * rate for category, rate in s.categories.items()})
        for name, s in SYSTEMS.items()
    } == {name: (pytest.approx(overall), pytest.approx(parts)) for name, (overall, parts) in table.items()}


def test_the_page_of_r1_has_the_papers_numbers_in_the_order_of_its_sentence():
    page = (ROOT / "docs" / "r1.md").read_text().replace("\n", " ")
    order = ("human_recognition", "symbol_understanding", "reasoning")
    numbers = [percent(SYSTEMS["CognitiveDrone-R1"].categories[category]) for category in order]  # type: ignore[index]
    output = "{}, {} and {} %".format(*numbers)
    assert re.search(rf"The paper's R1 passes {output} of human recognition, symbol understanding and reasoning", page)


def test_only_shipped_suites_with_all_categories_are_compared(config):
    results = run(config.changed(suite="open-v1:test"), progress=False, runner=benchmark_fakes.FakeRunner)
    likes, others = ("test", "hard", "unseen"), ("smoke", "race", "track", "train")
    assert all(comparable(f"open-v1:{name}", results.summary()) for name in likes)
    assert not any(comparable(name, results.summary()) for name in ("own.json", *(f"open-v1:{o}" for o in others)))
    some = tuple(e for e in results.episodes if e.stages[0].category != "reasoning")
    assert not comparable("open-v1:test", replace(results, episodes=some).summary())
