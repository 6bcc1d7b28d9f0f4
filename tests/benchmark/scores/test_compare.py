"""Runs beside each other, beside the paper's, and beside policies that do not see or do not read."""

import json
import re
from dataclasses import replace
from pathlib import Path

import benchmark_fakes
import pytest
from benchmark_fakes import text_of

from cognitivedrone import evaluate
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports.tables import comparison_table, results_table
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.scores.comparison import Paired, compare, suspicions
from cognitivedrone.benchmark.scores.published import PUBLISHED, comparable
from cognitivedrone.benchmark.scores.results import read_results, write_results
from cognitivedrone.errors import RunError

RUNNER = benchmark_fakes.FakeRunner


@pytest.fixture
def config(config):
    return config.changed(suite="open-v1:smoke")


@pytest.fixture
def two(config, tmp_path):
    a = config.changed(out=tmp_path / "a")
    b = config.changed(out=tmp_path / "b", policy="other")
    return run(a, progress=False, runner=RUNNER), run(b, progress=False, runner=RUNNER), tmp_path / "a", tmp_path / "b"


def test_tasks_are_paired_one_by_one(two):
    a, b, path_a, path_b = two
    comparison = compare(path_a, path_b)
    passed_a = {s.task_id: s.outcome == "passed" for e in a.episodes for s in e.stages}
    passed_b = {s.task_id: s.outcome == "passed" for e in b.episodes for s in e.stages}
    table = comparison.overall
    assert table.only_a == sum(passed_a[task] and not passed_b[task] for task in passed_a)
    assert table.only_b == sum(passed_b[task] and not passed_a[task] for task in passed_a)
    assert table.only_a != table.only_b
    assert comparison.overall.difference == pytest.approx(b.summary().overall.rate - a.summary().overall.rate)
    assert sum(part.n for part in comparison.categories.values()) == table.n == 20
    mirrored = compare(path_b, path_a)
    assert mirrored.overall.difference == -comparison.overall.difference
    assert mirrored.overall.p == comparison.overall.p


def test_a_run_does_not_differ_from_itself(two):
    comparison = compare(two[2], two[2])
    assert comparison.overall.difference == 0
    assert comparison.overall.p == 1
    assert comparison.other_differences == ()


def test_invalid_stages_are_left_out_of_both(two):
    a, _, path_a, path_b = two
    first = a.episodes[0]
    broken = replace(first, stages=(replace(first.stages[0], outcome="invalid"),))
    write_results(path_a / "results.json", replace(a, episodes=(broken, *a.episodes[1:])))
    comparison = compare(path_a, path_b)
    assert comparison.left_out == 1
    assert comparison.overall.n == 19


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"seed": 1}, "seed differs, 0 and 1"),
        ({"suite": "open-v1:test"}, "suite differs"),
        ({"track": True}, "track option differs, False and True"),
    ],
)
def test_unlike_runs_are_not_paired(two, config, tmp_path, option, message):
    run(config.changed(out=tmp_path / "c", **option), progress=False, runner=RUNNER)
    with pytest.raises(RunError, match=message):
        compare(two[2], tmp_path / "c")


def test_runs_over_different_numbers_of_tasks_are_not_paired(two):
    results = read_results(two[3])
    write_results(two[3] / "results.json", replace(results, episodes=results.episodes[:15]))
    with pytest.raises(RunError, match="5 tasks were flown in only one of them"):
        compare(two[2], two[3])


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (lambda made: {"renderer": "another"}, "renderer: imagination and another"),
        (lambda made: {"platform": {**made.platform, "machine": "aarch64"}}, "architecture: {here} and aarch64"),
    ],
)
def test_another_renderer_or_architecture_is_said(two, change, difference):
    assert "frames" not in text_of(comparison_table(compare(two[2], two[3])))
    results = read_results(two[3])
    write_results(two[3] / "results.json", replace(results, **change(results)))
    comparison = compare(two[2], two[3])
    here = results.platform.get("machine", "unknown")
    assert comparison.other_differences == (difference.format(here=here),)
    assert comparison.frames_differ
    assert "frames of other renderers and processors differ" in " ".join(text_of(comparison_table(comparison)).split())


def test_tables_fit_a_terminal_and_say_the_scores(two):
    a, _, path_a, path_b = two
    text = text_of(results_table(a))
    assert f"{100 * a.summary().overall.rate:.1f} %" in text
    assert "open-v1:smoke" in text
    for category in a.summary().categories:
        assert category.replace("_", " ") in text
    assert "…" not in text
    comparison = compare(path_a, path_b)
    text = text_of(comparison_table(comparison))
    assert "p (McNemar)" in text
    assert f"A: policy {a.run.policy}, reasoner none\n" in re.sub(" +\n", "\n", text)
    assert "B: policy other, reasoner none\n" in re.sub(" +\n", "\n", text)
    assert text.splitlines()[-1].strip() == comparison.verdict
    assert "…" not in text


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Of a run that no test changes."""
    plan = Plan.of(
        policy="fake", suite="open-v1:smoke", episodes=20, workers=0, clips=0, out=tmp_path_factory.mktemp("run") / "a"
    )
    return run(plan, progress=False, runner=RUNNER)


def test_the_result_comes_first_in_a_sentence(results):
    overall = results.summary().overall
    low, high = (f"{100 * limit:.0f}" for limit in overall.ci95)
    expected = " ".join(text_of(results_table(results)).partition("choice  pass|choice")[0].split())
    assert expected.startswith(
        f"fake passes {overall.passed} of {overall.n} tasks of open-v1:smoke, {100 * overall.rate:.1f} % (95 % interval"
        f" {low} to {high} %); random choice gives a third"
    )
    thinking = replace(results, run=replace(results.run, reasoner="oracle"))
    assert "fake with the reasoner oracle passes" in text_of(results_table(thinking))
    assert "by the rule within_1m, " in " ".join(text_of(results_table(results, "within_1m")).split())


def test_families_have_rows_from_ten_tasks_on(results):
    text = text_of(results_table(results))
    for family in results.summary().families:
        assert f"  {family.replace('_', ' ')} " not in text
    assert f"{len(results.summary().families)} families of fewer than 10 tasks: in the report" in text
    episodes = tuple(
        replace(episode, stages=tuple(replace(stage, family="people") for stage in episode.stages))
        for episode in results.episodes
    )
    text = text_of(results_table(replace(results, episodes=episodes)))
    assert text.count("\n  people ") == 2  # scores and endings
    assert "in the report" not in text


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (Paired(20, 1, 2, 7), "B passes 1 more of 30 tasks; no significant difference (McNemar, p = 1)"),
        (Paired(20, 2, 2, 6), "A and B pass equally many of 30 tasks; no significant difference (McNemar, p = 1)"),
        (Paired(20, 9, 1, 0), "A passes 8 more of 30 tasks; a significant difference (McNemar, p = 0.0215)"),
        (Paired(0, 0, 0, 0), "no task counts in both runs, so they cannot be compared"),
    ],
)
def test_the_verdict_is_one_sentence(two, table, expected):
    assert replace(compare(two[2], two[3]), overall=table).verdict == expected


def test_errors_of_the_policy_and_of_the_physics_stand_below_the_table(results):
    first, second, *rest = results.episodes
    bad = replace(first, stages=(replace(first.stages[0], outcome="policy_error"),), message="not a finite number")
    lost = replace(second, stages=(replace(second.stages[0], outcome="invalid"),))
    text = text_of(results_table(replace(results, episodes=(bad, lost, *rest))))
    assert "not counted: 1 invalid" in text
    assert "not a finite number" in " ".join(text.split())


def test_a_suite_like_the_papers_is_told_beside_it(results):
    like = replace(results.run, suite=replace(results.run.suite, name="open-v1:test"))
    assert "2503.01378" in text_of(results_table(replace(results, run=like)))
    assert "2503.01378" not in text_of(results_table(results))


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


def test_a_policy_that_gives_the_same_answer_whatever_it_sees_is_named(tmp_path):
    evaluation = evaluate("user_pilots:Constant", episodes=2, workers=0, out=tmp_path / "run", clips=0, progress=False)
    (warning,) = suspicions(evaluation.results)
    assert "the same answer (0, 0, 1.5, 0) for all images and sentences, in every flight" in warning
    assert "warning: the policy gave the same answer" in " ".join(evaluation.table().split())
    document = json.loads((tmp_path / "run" / "results.json").read_text())
    assert [episode["repeated"] for episode in document["episodes"]] == [[0.0, 0.0, 1.5, 0.0]] * 2
    assert list(suspicions(read_results(tmp_path / "run"))) == [warning]


@pytest.mark.parametrize(
    ("policy", "episodes", "says"),
    [
        ("user_pilots:Constant:rows=7", 1, "in every flight"),  # a chunk that is repeated
        ("user_pilots:PerFlight", 2, "throughout each flight"),
    ],
)
def test_an_answer_that_differs_in_nothing_or_between_flights_alone_is_named(policy, episodes, says):
    evaluation = evaluate(policy, episodes=episodes, workers=0, progress=False)
    assert says in next(iter(suspicions(evaluation.results)))


def test_a_policy_that_flies_at_one_gate_whatever_it_reads_is_named_and_one_that_reads_is_not(tmp_path):
    plan = Plan.of(policy="fake", suite="open-v1:test", episodes=12, workers=0, clips=0, out=tmp_path / "run")
    results = run(plan, progress=False, runner=benchmark_fakes.FakeRunner)

    def flown_at(gate):
        """The results, had every flight gone to that gate, or to the right one."""
        stages = [replace(each.stages[0], outcome="collision", chosen=gate) for each in results.episodes]
        stages = [replace(stage, chosen=stage.target) if gate is None else stage for stage in stages]
        episodes = zip(results.episodes, stages, strict=True)
        return replace(results, episodes=tuple(replace(each, stages=(stage,)) for each, stage in episodes))

    (warning,) = suspicions(flown_at(1))
    assert "12 of 12 flights went to gate 2, which " in warning
    assert "seems not to follow the instruction" in warning
    assert list(suspicions(flown_at(None))) == []
