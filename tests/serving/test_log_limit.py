"""The server's log stays short whatever clients send."""

import logging

from policy_clients import Client, observation

from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import KINDS, MOST, PERIOD_S, LogLimit, logging_to_stderr, serving


def record(text="%s: failed", kind="", level=logging.ERROR):
    made = logging.LogRecord("server", level, __file__, 1, text, ("client",), None)
    made.kind = kind
    return made


def test_few_records_of_a_kind_pass_in_a_period_and_the_next_says_how_many_did_not():
    now = [0.0]
    limit = LogLimit(lambda: now[0])
    passed = [made for made in (record() for _ in range(200)) if limit.filter(made)]
    assert len(passed) == MOST
    assert passed[-1].getMessage() == "client: failed (more like this are not logged for 60 s)"
    for other in (record("%s: left"), record(kind="nan"), record(level=logging.INFO)):
        assert limit.filter(other)
    now[0] = PERIOD_S
    later = record()
    assert limit.filter(later)
    assert later.getMessage() == f"client: failed ({200 - MOST} more like this were not logged)"


def test_many_kinds_do_not_fill_memory_or_the_log():
    limit = LogLimit(lambda: 0.0)
    passed = sum(limit.filter(record(kind=str(number))) for number in range(3 * KINDS))
    assert passed == KINDS + MOST
    assert len(limit._counts) == KINDS + 1


def test_200_frames_that_the_policy_fails_at_leave_few_lines_in_the_log(capsys):
    with (
        logging_to_stderr(),
        serving(ServePlan.of(policy="served_pilots:Faulty", reasoner="none", port=0)) as address,
        Client(address) as client,
    ):
        for _ in range(100):
            client.ask(observation("raise"))
            client.ask(observation("exit"))
    log = capsys.readouterr().err
    assert "Traceback" in log
    assert "more like this are not logged" in log
    assert len(log.splitlines()) < 200
