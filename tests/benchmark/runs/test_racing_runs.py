"""Runs of the racing suite: scored and shown without a word of choosing."""

import pytest
from benchmark_fakes import text_of

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports.report import render_report
from cognitivedrone.benchmark.reports.tables import results_table
from cognitivedrone.benchmark.runs.records import read_records
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.scores.scoring import summarize
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import CATEGORIES, EpisodeResult, StageResult


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Results and records of two races that the oracle flew."""
    out = tmp_path_factory.mktemp("race") / "run"
    config = Plan.of(policy="oracle", suite="open-v1:race", episodes=2, workers=0, out=out, clips=1)
    return run(config, progress=False), read_records(out)


def test_the_oracle_passes_and_the_stages_are_recorded_as_they_stood(flown):
    results, records = flown
    assert results.summary().overall.passed == 10
    for episode, track in enumerate(load_suite("open-v1:race").tracks[:2]):
        assert [stage.only for stage in records[episode].trace.stages] == [task.target for task in track]


def test_table_and_report_have_the_race_and_no_chance_of_guessing_right(flown):
    results, records = flown
    table = text_of(results_table(results), 100)
    page = render_report(results, [records[k].trace for k in range(2)], [])
    assert "pass|choice" in table
    for text in (table, page):
        assert "racing" in text
        assert "100.0 %" in text
        for word in ("mean of", "random choice"):
            assert word not in text
    assert 'class="chance"' not in page
    assert "Beside the published scores" not in page


def result(category, outcome="passed", chosen=1):
    return StageResult("x", category, category, 1, outcome, chosen, 5.0, 6.0, 1.0, 0.1, 0.1)


def test_races_stand_behind_the_papers_categories_and_outside_their_mean():
    stages = [result("racing")] * 3 + [result("racing", "collision"), result("racing", "timeout", None)]
    stages += [result(category, "wrong_gate", 0) for category in CATEGORIES]
    summary = summarize([EpisodeResult(0, 0, tuple(stages), 1)])
    assert list(summary.categories) == [*CATEGORIES, "racing"]
    assert list(summary.families) == [*CATEGORIES, "racing"]
    assert summary.overall.n == 8
    assert (summary.mean_of_categories.categories, summary.mean_of_categories.rate) == (3, 0.0)
    assert summary.categories["racing"].rate == 0.6
    assert summary.categories["racing"].pass_given_choice == 0.75
