"""Passwords and tokens in the addresses that a user gives: nothing that is stored or printed of a run has them."""

import io
from collections.abc import Callable

import pytest

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.audit.run import audit_table, folder_of
from cognitivedrone.benchmark import measurements
from cognitivedrone.benchmark.config import Plan, ReasonPlan
from cognitivedrone.benchmark.reasoning import reason
from cognitivedrone.benchmark.runs import runner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.benchmark.scores.results import dumps
from cognitivedrone.collect.collector import Learner
from cognitivedrone.plan import PilotSpec
from cognitivedrone.play.flight import command_line
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import Address, announced
from cognitivedrone.terminal import console

SERVER = "remote:ws://127.0.0.1:9/?token=SECRET,rows=3"
SHOWN = "remote:ws://127.0.0.1:9/?token=***,rows=3"


def test_the_pilot_of_a_run_is_recorded_without_them() -> None:
    plan = Plan.of(policy=SERVER, reasoner=SERVER.partition(",")[0], suite="open-v1:smoke")
    facts = resolve(plan).facts
    assert facts.policy == SHOWN
    stored = (dumps(facts), runner.command_of(plan), str(runner.out_of(plan)))
    assert all("SECRET" not in text and "127.0.0.1" in text.replace("-", ".") for text in stored)
    assert plan.pilot.policy == SERVER  # which is what is flown


@pytest.mark.parametrize(
    "shown",
    [
        lambda: _printed(AuditPlan.of(policy=SERVER)),
        lambda: str(folder_of(AuditPlan.of(policy=SERVER))),
        lambda: str(reason.out_of(ReasonPlan.of(reasoner=SERVER))),
        lambda: str(Learner(SERVER, 0.0, None).facts()),
        lambda: announced(ServePlan.of(policy=SERVER), Address("127.0.0.1", 1)),
        lambda: command_line(
            FlyPlan.of(
                instruction="go",
                policy=SERVER,
                link="mavlink:udp:127.0.0.1:9",
                camera="rtsp://me:SECRET@host/?pw=SECRET",
            )
        ),
        lambda: str(PilotSpec(SERVER, SERVER).shown),
        lambda: measurements.command_line(["benchmarks/some.py", "--policy", SERVER]),
    ],
)
def test_what_is_shown_of_a_pilot_has_none(shown: Callable[[], str]) -> None:
    text = str(shown())
    assert "SECRET" not in text
    assert "127" in text


def _printed(plan: AuditPlan) -> str:
    screen = console(file=io.StringIO(), width=200)
    with screen.capture() as printed:
        screen.print(audit_table(plan, []))
    return printed.get()
