"""What a run says of its reasoner, apart from the flying; and success against latency."""

import json
from dataclasses import replace

import pytest

from cognitivedrone.benchmark import Plan, run
from cognitivedrone.benchmark.reports.tables import _reasoning
from cognitivedrone.benchmark.runs.sweep import PLOT_FILE, SweepPlan, sweep
from cognitivedrone.benchmark.scores.results import results_from_json, results_to_json
from cognitivedrone.benchmark.scores.scoring import score, summarize
from cognitivedrone.errors import RunError
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import EpisodeResult, ReasonerReport, StageResult

EPISODES = 4


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Right, then wrong, then none at all, then right by its colour alone."""
    folder = tmp_path_factory.mktemp("answers")
    tasks = [track[0] for track in load_suite("open-v1:smoke").tracks[:EPISODES]]
    wrong = tasks[1].gates[(tasks[1].target + 1) % 3]
    lines = [
        {"task": tasks[0].id, "directive": tasks[0].directive},
        {"task": tasks[1].id, "directive": f"Go to the {wrong.size} {wrong.color} {wrong.shape} gate"},
        {"task": tasks[2].id, "fault": "refusal"},
        {"task": tasks[3].id, "directive": f"Take the {tasks[3].gates[tasks[3].target].color} gate"},
    ]
    file = folder / "answers.jsonl"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return file


@pytest.fixture(scope="module")
def flown(answers, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "run"
    config = Plan.of(
        policy="colour_seeker", reasoner=f"replay:{answers}", suite="open-v1:smoke", workers=0,
        episodes=EPISODES, latency="policy=30ms,reasoner=300ms", out=out, clips=0,
    )  # fmt: skip
    return run(config, progress=False)


def test_every_stage_says_what_its_reasoner_did(flown):
    right, wrong, refused, short = (episode.stages[0].reasoner for episode in flown.episodes)
    assert (right.gate, right.size, right.color, right.shape) == (True, True, True, True)
    assert right.answers > 3
    assert right.changes == 0
    assert not right.faults
    # Asked at 0, 0.5, ...; flown by from the control step after 0.3 s until the next answer at 0.8 s.
    assert 0.3 <= right.age_s <= 0.8
    assert right.rate_hz == pytest.approx(2, abs=0.5)
    assert wrong.gate is False
    assert wrong.color is False
    assert (refused.gate, refused.color, refused.answers, refused.age_s) == (False, None, 0, None)
    assert set(refused.faults) == {"refusal"}
    assert (short.gate, short.size, short.color, short.shape) == (True, None, True, None)


def test_the_drone_goes_where_it_is_reported(flown):
    assert [episode.stages[0].outcome == "passed" for episode in flown.episodes][:2] == [True, False]


def test_scores_of_reasoner_and_flying_are_separate(flown):
    async_reasoner = flown.summary().overall.reasoner
    assert async_reasoner.n == EPISODES
    assert async_reasoner.gate == 0.5
    assert async_reasoner.color == pytest.approx(2 / 3)
    assert async_reasoner.faults["refusal"] >= 2
    assert async_reasoner.answers == sum(episode.stages[0].reasoner.answers for episode in flown.episodes)


def test_the_file_of_results_holds_it_and_what_it_came_from(flown, answers):
    options = flown.run.options
    assert options["latency"] == "policy=30ms,reasoner=300ms"
    assert len(options["reasoner_model"]) == 64
    assert results_from_json(results_to_json(flown), "here") == flown


PASSED = StageResult("t", "reasoning", "math", 0, "passed", 0, 5.0, 6.0, 1.0, 0.3, 0.1)


def test_stages_without_a_reasoner_have_no_such_score():
    assert score([PASSED]).reasoner is None
    report = ReasonerReport(3, {}, 0, 0.2, 2.0, True, None, False, False)
    mixed = score([PASSED, replace(PASSED, directive="Go", reasoner=report)])
    assert (mixed.n, mixed.reasoner.n, mixed.reasoner.size, mixed.reasoner.color) == (2, 1, 1.0, None)


def late_stage(answers, late, faults=0):
    report = ReasonerReport(answers, {"refusal": faults} if faults else {}, 0, 0.9, 1.4, True, None, False, False, late)
    return replace(PASSED, reasoner=report)


def test_late_answers_in_a_row_are_counted_over_stages_without_one_in_time():
    stages = [late_stage(8, 8), late_stage(30, 5), late_stage(20, 20), late_stage(10, 22, faults=12), late_stage(9, 0)]
    found = score(stages).reasoner
    assert (found.late, found.late_in_a_row) == (55, 42)


@pytest.mark.parametrize(("late", "says"), [(39, False), (40, True)])
def test_a_run_whose_reasoner_was_always_late_says_that_it_flew_without_it(late, says):
    summary = summarize([EpisodeResult(0, 0, (late_stage(late, late),), 300)])
    text = " ".join(str(part) for part in _reasoning(summary, {}))
    assert f"late: {late}" in text
    assert (f"the policy flew without its reasoner: {late} answers in a row were late" in text) is says


def test_a_sweep_flies_each_latency_once_and_plots(tmp_path):
    config = SweepPlan.of(
        out=tmp_path / "sweep", policy="colour_seeker", suite="open-v1:smoke", ms=(2000, 0), episodes=1, workers=0
    )
    points = sweep(config, progress=False)
    assert [ms for ms, _ in points] == [0, 2000]
    assert points[0][1].summary().overall.rate == 1.0
    first = points[1][1].episodes[0].stages[0].reasoner
    assert first.age_s > 2.0
    assert (config.out / PLOT_FILE).read_text().count("<circle") == 4
    again = sweep(config, progress=False)
    assert [run.timing for _, run in again] == [run.timing for _, run in points]
    with pytest.raises(RunError, match="at least one latency"):
        SweepPlan.of(out=tmp_path / "no", ms=())
