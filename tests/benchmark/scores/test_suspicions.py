"""Runs of policies that do not see, or do not read, come with a warning; others do not."""

import json
from dataclasses import replace

import benchmark_fakes
import pytest

from cognitivedrone import evaluate
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.scores.comparison import suspicions
from cognitivedrone.benchmark.scores.results import read_results


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
