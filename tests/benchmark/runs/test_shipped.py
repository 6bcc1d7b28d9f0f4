"""The models that come with the install, as everybody flies them. Their scores: docs/small.md and docs/r1.md."""

import pytest

from cognitivedrone.benchmark import Plan, run
from cognitivedrone.benchmark.reasoning.reason import ReasonPlan, score_reasoner
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.format import write_tasks


def test_the_small_reasoner_knows_the_gate_from_the_first_frame(tmp_path):
    scored = score_reasoner(
        ReasonPlan.of(reasoner="small", suite="open-v1:smoke", out=tmp_path / "answers"), progress=False
    )
    assert len(scored.answers) == 30
    answered = [answer for answer in scored.answers if answer.fault is None]
    assert len(answered) >= 24
    named = [answer for answer in answered if answer.gate is not None]
    assert len(named) >= 20
    assert sum(bool(answer.right.gate) for answer in named) >= 0.95 * len(named)


@pytest.mark.slow
def test_policy_and_reasoner_fly_what_the_policy_alone_does_not_understand(tmp_path):
    tasks = tmp_path / "relations.json"
    every = (task for track in load_suite("open-v1:hard").tracks for task in track)
    write_tasks(tasks, (task for task in every if task.family == "relations"))
    rates = {}
    for reasoner in ("none", "small"):
        plan = Plan.of(policy="small", reasoner=reasoner, tasks=tasks, out=tmp_path / reasoner, clips=0)
        rates[reasoner] = run(plan, progress=False).summary().overall.rate
    assert rates["small"] >= 0.8
    assert rates["small"] - rates["none"] >= 0.2


def test_policy_and_reasoner_pass(tmp_path):
    plan = Plan.of(
        policy="small", reasoner="small", suite="open-v1:smoke", episodes=2, out=tmp_path / "run", clips=0, workers=0
    )
    assert run(plan, progress=False).summary().overall.passed == 2


def test_the_racer_races(tmp_path):
    race = Plan.of(
        policy="race", reasoner="none", suite="open-v1:race", episodes=2, out=tmp_path / "race", clips=0, workers=0
    )
    assert run(race, progress=False).summary().overall.pass_given_choice >= 0.8
