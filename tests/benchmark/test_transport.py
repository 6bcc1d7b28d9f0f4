"""A reasoner whose server does not answer is not scored as if it had."""

import json

import pytest
from chat_server import GOOD, Script, chat, serving

from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.benchmark.scores.run_types import not_measured
from cognitivedrone.cli import main

pytestmark = pytest.mark.usefixtures("no_vlm_settings")


@pytest.mark.parametrize(
    ("faults", "asked", "told"),
    [
        ({"http": 1}, 20, False), ({"http": 2}, 20, True), ({"unreachable": 1, "http": 1}, 20, True),
        ({"garbage": 20}, 20, False), ({"timeout": 20}, 20, False), ({}, 0, False),
    ],
)  # fmt: skip
def test_five_percent_of_the_questions_may_be_lost(faults, asked, told):
    assert bool(not_measured(faults, asked)) == told


@pytest.mark.filterwarnings("ignore:reasoner vlm")
@pytest.mark.parametrize("command", ["reason", "bench"])
def test_a_run_whose_server_does_not_answer_says_so_first_and_fails(tmp_path, capsys, command):
    words = ["--suite", "open-v1:smoke", "--episodes", "1", "--out", str(tmp_path / "out")]
    if command == "bench":
        words += ["--policy", "colour_seeker", "--workers", "0"]
    with serving(Script(replies=[(401, b"no key")])) as url, pytest.raises(SystemExit) as ended:
        main([command, *words, "--reasoner", f"vlm:{url},model=eye-7b,timeout=60"])
    assert ended.value.code == 1
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("this is not a measurement")


def test_what_was_not_asked_is_no_part_of_the_score(tmp_path, capsys):
    replies = [(401, b"no key"), (200, chat(GOOD))]
    with serving(Script(replies=replies)) as url, pytest.raises(SystemExit), pytest.warns(RuntimeWarning):
        main(["reason", "--suite", "open-v1:smoke", "--episodes", "2", "--out", str(tmp_path / "out"), "--reasoner",
              f"vlm:{url},model=eye-7b,timeout=60"])  # fmt: skip
    scores = json.loads((tmp_path / "out" / "reason.json").read_text())["scores"]["overall"]
    assert (scores["n"], scores["faults"]) == (1, {"http": 1})


def test_a_flight_in_which_the_server_did_not_answer_is_told_beside_the_rates(tmp_path, capsys):
    """Of three flights the first loses a question: the other two are the score."""
    asked: list[str] = []

    def behave(handler):
        asked.append(handler.path)
        handler.answer(*((401, b"no key") if len(asked) == 2 else (200, chat(GOOD))))

    words = ["bench", "--suite=open-v1:smoke", "--episodes=3", "--policy=colour_seeker", "--workers=0"]
    with serving(Script(behave=behave)) as url, pytest.warns(RuntimeWarning):
        main([*words, "--out", str(tmp_path / "out"), "--reasoner", f"vlm:{url},model=eye-7b,timeout=60"])
    said = " ".join(capsys.readouterr().out.split())
    assert " of 2 tasks of open-v1:smoke" in said
    assert "not counted: 1 of 3 flights without an answer of the reasoner's server" in said
    summary = read_results(tmp_path / "out").summary()
    assert (summary.overall.n, summary.episodes, summary.unanswered) == (2, 2, 1)
    assert "this is not a measurement" not in said
