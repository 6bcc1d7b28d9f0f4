"""Submissions: made from real runs, tampering is found, and a sample is flown again."""

import html
import json
import math
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.measurements import markdown
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.scores.results import decode, encode, read_results
from cognitivedrone.benchmark.submission import (
    Rate,
    Verified,
    leaderboard,
    read_submission,
    submission_of,
    verify,
    write_submission,
)
from cognitivedrone.benchmark.submission_file import SubmittedRun, scores_of, stages_of
from cognitivedrone.cli import main
from cognitivedrone.errors import PolicyError, RunError
from cognitivedrone.files import digest_of_file
from cognitivedrone.rollout.pool import InProcess
from cognitivedrone.tasks import load_suite
from cognitivedrone.text.printable import unprintable

DIVING = """
class Dive:
    def reset(self, context): pass
    def act(self, observation): return [[0.0, 0.0, -3.0, 0.0]]

class Moody:
    flights = 0
    def reset(self, context): Moody.flights += 1
    def act(self, observation): return [[0.0, 0.0, 3.0 if Moody.flights == 1 else -3.0, 0.0]]
"""
"""Pilots whose flights are soon over: at the floor, or the first one above the bounds."""


@pytest.fixture
def file(smoke_run, tmp_path):
    path = tmp_path / "leaderboard" / "mine.json"
    write_submission(path, submission_of([smoke_run], "Mine", "Us"))
    return path


def edit(file: Path, change: Callable[[Any], object]) -> None:
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


def test_a_submission_holds_the_run_and_is_read_back(smoke_run, file):
    submission = read_submission(file)
    assert submission == submission_of([smoke_run], "Mine", "Us")
    (made,) = submission.runs
    assert made.overall.n == 30
    assert made.overall.rate == 1.0
    assert made.mean == 1.0
    assert len(made.flown) == 30
    assert made.command.startswith("cognitivedrone bench")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda run: run["overall"].update(passed=29), "scores do not follow"),
        (lambda run: run["flown"][3].__setitem__(0, {"outcome": "timeout", "chosen": None}), "scores do not follow"),
        (lambda run: run["flown"].pop(), "flights are not those of the suite"),
        (lambda run: run["run"]["suite"].update(digest="0" * 64), "other tasks than the suite"),
        (lambda run: run["run"]["suite"].update(name="mine"), "no shipped suite"),
        (lambda run: run["flown"][3].__setitem__(0, {"outcome": "won", "chosen": 1}), "won"),
        (lambda run: run.pop("machine"), "missing"),
        (lambda run: run["overall"].update(rate=math.nan), "no finite number"),
        (lambda run: run["flown"].__setitem__(3, run["flown"][4]), "cannot have ended as|scores do not follow"),
        (lambda run: run["flown"][3].append(run["flown"][3][0]), "flights are not those of the suite"),
        (lambda run: run["flown"][3][0].update(chosen=7), "cannot have ended as passed with the gate 7"),
        (lambda run: run["flown"][3][0].update(outcome="not_reached"), "cannot have ended as not_reached"),
        (lambda run: run["flown"][3][0].update(outcome="invalid"), "cannot have ended as invalid"),
        (lambda run: run["flown"][3][0].update(outcome="hesitated"), "cannot have ended as hesitated"),
        (lambda run: run["run"]["suite"].update(size=29), "other tasks than the suite"),
        (lambda run: run["run"]["options"].update(seed=False), "must be a whole number"),
        (lambda run: run["run"]["options"].update(luck=1), "does not know"),
        (lambda run: run["run"]["options"].update(episodes=5), "has 5 episodes only"),
        (lambda run: run["run"]["options"].update(shard="1/2"), "is a shard"),
        (lambda run: run["run"]["options"].update(model="<b>"), "must be a SHA-256"),
        (lambda run: run["run"]["options"].update(model=["x"]), "options.model"),
        (lambda run: run.update(machine="a\nb"), "printable characters"),
        (lambda run: run.update(command="x\u202ey"), "printable characters"),
        (lambda run: run.update(commit="<script>"), "40 hexadecimal digits"),
        (lambda run: run.update(finished="yesterday"), "ISO 8601"),
        (lambda run: run["run"]["versions"].update({"numpy\x1b[2J": "1"}), "printable characters"),
        (lambda run: run["run"].update(policy="x" * 3000), "printable characters"),
    ],
)
def test_tampering_is_found(file, change, message):
    edit(file, lambda document: change(document["runs"][0]))
    with pytest.raises(RunError, match=message):
        read_submission(file)


@pytest.mark.parametrize("text", ["", " ", "x" * 61, "a\nb", "a\x1b[2J", "a\ud800", "a\u202eb", "a\u200bb"])
@pytest.mark.parametrize("key", ["name", "by"])
def test_a_name_is_checked_when_it_is_read(file, key, text):
    edit(file, lambda document: document.update({key: text}))
    with pytest.raises(RunError, match="must have 1 to 60 printable characters") as error:
        read_submission(file)
    assert not unprintable(str(error.value))


@pytest.mark.parametrize(
    "url",
    [
        "javascript:alert(1)", "JAVASCRIPT:alert(1)", "data:text/html,x", "file:///etc/passwd", "//evil", "https://",
        "https://a b", "https://a)b", "https://a](x", "https://a|b", "https://a\nb", 'https://a"onclick=', "https://a<b>",
        "https://me:pass@host", "https://a\\b", "https://é.org", "https://a/" + "x" * 200, "ftp://a.org", "a.org",
    ],
)  # fmt: skip
def test_an_address_is_a_plain_one_of_the_web(file, url):
    edit(file, lambda document: document.update(url=url))
    with pytest.raises(RunError, match="must be a web address"):
        read_submission(file)


def test_the_runs_of_a_file_are_one_pilot_s_and_each_is_there_once(file):
    original = json.loads(file.read_text())

    def with_runs(*runs):
        file.write_text(json.dumps({**original, "runs": runs}))

    (first,) = original["runs"]
    newer = json.loads(json.dumps(first))
    newer["run"]["versions"]["numpy"] = "9.9.9"
    other = json.loads(json.dumps(first))
    other["run"]["options"] |= {"wind_m_s": 2.0, "model": "0" * 64}
    for runs, message in (
        ((), "has no run"),
        ((first, first), "several runs of open-v1:smoke"),
        ((first, newer), "several runs of open-v1:smoke"),
        ((first, other), "different pilots"),
    ):
        with_runs(*runs)
        with pytest.raises(RunError, match=message):
            read_submission(file)
    file.write_text(json.dumps(original).replace('"name"', '"name": "Nobody", "name"', 1))
    with pytest.raises(RunError, match="the name 'name' is given twice"):
        read_submission(file)


def test_episodes_of_another_order_are_not_submitted(smoke_run, tmp_path):
    def swap(document):
        _, one, other, *_ = document["episodes"]
        one["stages"], other["stages"] = other["stages"], one["stages"]

    changed = Path(shutil.copy(smoke_run / "results.json", tmp_path))
    edit(changed, swap)
    with pytest.raises(RunError, match=r"not those of the suite, in order|does not follow"):
        submission_of([changed], "Mine", "Us")


def test_what_cannot_be_submitted(smoke_run):
    with pytest.raises(RunError, match="printable characters"):
        submission_of([smoke_run], "", "Us")
    with pytest.raises(RunError, match="must be a web address"):
        submission_of([smoke_run], "Mine", "Us", "javascript:alert(1)")
    with pytest.raises(RunError, match="has no run"):
        submission_of([], "Mine", "Us")
    with pytest.raises(RunError, match="several runs of open-v1:smoke"):
        submission_of([smoke_run, smoke_run], "Mine", "Us")


def test_a_sample_is_flown_again(file, capsys):
    (checked,) = verify(read_submission(file), 2, progress=False)
    assert (checked.flown, checked.equal, checked.passed, checked.submitted) == (2, 2, 2, 2)
    assert (checked.worse, checked.better, checked.valid, checked.repeats) == (0, 0, 0, True)
    assert checked.verdict == "confirmed"
    main(["verify", str(file), "--sample", "4", "--seed", "3"])
    assert capsys.readouterr().out == (
        "sample: --seed 3\n"
        "open-v1:smoke: 4 of 4 flights ended as submitted; 4 stages passed, 4 submitted as passed: confirmed\n"
        "  15 or more false flights among the 30 would not have been confirmed, with a probability of 95 %\n"
    )


def test_the_sample_is_another_one_each_time_and_can_be_repeated(file, capsys, monkeypatch):
    flown = []

    def noted(self, items):
        flown.append([*items])
        raise RunError("it is known what would be flown")

    monkeypatch.setattr(InProcess, "fly", noted)
    seeds: list[str] = []
    for more in ([], [], ["--seed"]):
        with pytest.raises(SystemExit):
            main(["verify", str(file), "--sample", "5", *more, *(seeds[:1] if more else [])])
        seeds.append(capsys.readouterr().out.partition("\n")[0].removeprefix("sample: --seed "))
    first, second, again = flown
    assert seeds[0] == seeds[2] != seeds[1]
    assert first != second
    assert first == again


@pytest.fixture
def diving(tmp_path, monkeypatch):
    """The module of pilots whose flights are soon over."""
    (tmp_path / "diving.py").write_text(DIVING)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "diving", raising=False)
    return tmp_path / "diving.py"


def tampered(file: Path, ends: dict[str, Any], policy: str, code: Path) -> Path:
    """A file that says that the first 20 flights ended so, and the others at the floor; its scores follow."""
    document = json.loads(file.read_text())
    run = document["runs"][0]
    run["run"] |= {"policy": policy}
    run["run"]["options"] |= {"policy_code": digest_of_file(code)}
    suite = load_suite("open-v1:smoke")
    floor = {"outcome": "collision", "chosen": None}
    right = [{"chosen": track[0].target, **ends} for track in suite.tracks]
    run["flown"] = [[each if index < 20 else floor] for index, each in enumerate(right)]
    made = decode(SubmittedRun, run, "")
    overall, categories, mean = scores_of([*stages_of(made, "")])
    document["runs"] = [encode(replace(made, overall=overall, categories=categories, mean=mean))]
    file.write_text(json.dumps(document))
    return file


def test_failures_that_are_called_invalid_are_refuted(file, diving, capsys):
    invalid = {"outcome": "invalid", "chosen": None}
    submission = read_submission(tampered(file, invalid, "diving:Dive", diving))
    assert submission.runs[0].overall.n == 10
    (checked,) = verify(submission, 2, policy="diving:Dive", progress=False)
    assert checked.valid >= 2  # of the flights called invalid, as many as the sample has, besides those in it
    assert checked.verdict == "refuted"
    with pytest.raises(SystemExit, match="1"):
        main(["verify", str(file), "--sample", "1", "--policy", "diving:Dive"])
    message = capsys.readouterr().out
    assert "NOT confirmed" in message
    assert "stages that were submitted as invalid are valid" in message


@pytest.mark.parametrize("ends", [{"outcome": "passed"}, {"outcome": "timeout", "chosen": None}])
def test_outcomes_that_are_false_are_refuted_whatever_they_are(file, diving, ends):
    submission = read_submission(tampered(file, ends, "diving:Dive", diving))
    (checked,) = verify(submission, 3, seed=1, policy="diving:Dive", progress=False)
    assert checked.equal < 3
    assert checked.verdict == "refuted"


@pytest.mark.parametrize(
    ("flown", "equal", "worse", "better", "valid", "repeats", "verdict"),
    [
        (20, 20, 0, 0, 0, True, "confirmed"),
        (20, 19, 1, 0, 0, True, "undecided"),
        (20, 19, 0, 0, 0, True, "undecided"),  # another failure than submitted
        (20, 18, 2, 0, 0, True, "refuted"),
        (20, 18, 0, 2, 0, True, "refuted"),
        (300, 299, 1, 0, 0, True, "confirmed"),  # another machine, once
        (300, 294, 6, 0, 0, True, "refuted"),
        (1, 1, 0, 0, 0, True, "confirmed"),
        (1, 0, 1, 0, 0, True, "refuted"),
        (20, 20, 0, 0, 1, True, "refuted"),
        (20, 10, 5, 5, 0, False, "confirmed"),  # a pilot that flies otherwise each time
        (20, 16, 4, 0, 0, False, "confirmed"),
        (20, 14, 6, 0, 0, False, "undecided"),
        (20, 12, 8, 0, 0, False, "refuted"),
        (20, 12, 0, 8, 0, False, "confirmed"),
        (20, 12, 5, 3, 1, False, "refuted"),
    ],
)
def test_a_sample_confirms_refutes_or_is_too_small(flown, equal, worse, better, valid, repeats, verdict):
    assert Verified("open-v1:test", flown, 300, equal, 9, 9, worse, better, valid, repeats, ()).verdict == verdict


def test_what_a_sample_finds_is_reported_as_it_is():
    drawn = np.random.default_rng(0)
    for flown, size in ((20, 300), (60, 300), (8, 30)):
        checked = Verified("open-v1:test", flown, size, flown, 9, 9, 0, 0, 0, True, ())
        verdicts = []
        for _ in range(400):
            false = int((drawn.choice(size, flown, replace=False) < checked.finds).sum())
            verdicts.append(replace(checked, equal=flown - false).verdict)
        assert verdicts.count("confirmed") < 40  # 20 are expected
    assert Verified("open-v1:test", 300, 300, 300, 9, 9, 0, 0, 0, True, ()).finds == 4


def test_a_pilot_that_does_not_repeat_its_flights_is_compared_by_passes(file, diving):
    submission = read_submission(tampered(file, {"outcome": "collision", "chosen": None}, "diving:Moody", diving))
    (checked,) = verify(submission, 4, seed=1, policy="diving:Moody", progress=False)
    assert checked.equal < 4
    assert not checked.repeats
    assert checked.verdict == "confirmed"  # it passes as seldom as it said


@pytest.mark.parametrize(
    ("names", "options", "says"),
    [
        *((names, {}, "which must not choose the code, files or servers that are used") for names in (
            {"policy": "os:system:touch imported"}, {"policy": "owned:Dive"}, {"policy": "remote:ws://127.0.0.1:9"},
            {"policy": "small:/etc/passwd"}, {"reasoner": "replay:/etc/passwd"},
            {"reasoner": "os:system:touch imported"}, {"reasoner": "vlm:http://127.0.0.1:9/v1"},
        )),
        ({}, {"latency": "policy=/etc/passwd"}, "depends on a file, which is not read here"),
        ({}, {"link": "gazebo"}, "only the simulator is verified"),
        ({}, {"link": "mavlink:udp:127.0.0.1:14550"}, "only the simulator is verified"),
    ],
)  # fmt: skip
def test_what_a_file_names_is_not_run_and_not_opened(file, tmp_path, capsys, monkeypatch, names, options, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "owned.py").write_text("open('imported', 'w').close()\n" + DIVING)
    monkeypatch.syspath_prepend(str(tmp_path))
    edit(file, lambda document: document["runs"][0]["run"].update(names))
    edit(file, lambda document: document["runs"][0]["run"]["options"].update(options))
    with pytest.raises(SystemExit, match="2"):
        main(["verify", str(file), "--sample", "1"])
    assert says in capsys.readouterr().err
    assert not (tmp_path / "imported").exists()


def test_the_code_of_an_own_policy_is_named_by_the_person_and_must_be_the_same(tmp_path, diving):
    plan = Plan.of(policy="diving:Dive", suite="open-v1:smoke", workers=0, clips=0, out=tmp_path / "run")
    run(plan, progress=False)
    file = tmp_path / "mine.json"
    write_submission(file, submission_of([tmp_path / "run"], "Mine", "Us"))
    with pytest.raises(PolicyError, match="name it yourself with --policy"):
        verify(read_submission(file), 2, progress=False)
    (checked,) = verify(read_submission(file), 2, policy="diving:Dive", progress=False)
    assert checked.verdict == "confirmed"
    with pytest.raises(RunError, match="policy_code is another file here"):
        verify(read_submission(file), 2, policy="hover", progress=False)
    diving.write_text(DIVING + "# edited\n")
    with pytest.raises(RunError, match=r"policy_code is another file here .*; get the submission's code"):
        verify(read_submission(file), 2, policy="diving:Dive", progress=False)
    with pytest.raises(RunError, match=r"contains another run: .*policy_code"):
        run(plan.changed(resume=True), progress=False)


def test_other_weights_are_refused(file):
    edit(file, lambda document: document["runs"][0]["run"]["options"].update(model="0" * 64))
    with pytest.raises(RunError, match="model is another file here"):
        verify(read_submission(file), 1, progress=False)


def test_the_leaderboard_is_sorted(smoke_run):
    good = submission_of([smoke_run], "a|b", "Us", "https://example.org")
    rows = leaderboard([good], ["open-v1:smoke", "open-v1:test"])
    assert rows == [["[a|b](https://example.org)", "Us", "`oracle` (ground truth)", "`none`", "100.0 (89 to 100)", "–"]]


@pytest.mark.parametrize(
    "text",
    [
        "<script>alert(1)</script>", "[x](javascript:x)", "![x](http://evil)", "**bold**", "`code`", "a | b",
        "http://evil.org", "www.evil.org", "WWW.evil.org", "me@evil.org", "<!-- end -->", "&lt;b&gt;", "\\| x",
        "# head",
        "a_b_c", "~~x~~", "<http://evil.org>", "[x]: http://evil", "{: onclick=x }", ":smile:", "$x$", "==x==", "^x^",
        "[^1]",
    ],
)  # fmt: skip
def test_texts_of_a_submission_are_text_in_the_table(smoke_run, text):
    markdown_of = pytest.importorskip("markdown").markdown
    (row,) = leaderboard([submission_of([smoke_run], text, text)], ["open-v1:smoke"])
    page = markdown_of(markdown(["pilot", "by", "policy", "reasoner", "score"], [row]), extensions=["extra"])
    cells = re.findall(r"<td>(.*?)</td>", page)
    assert len(cells) == 5
    for cell in cells[:2]:
        assert "<" not in cell
        assert html.unescape(cell) == text
    assert not re.search(r"://|www\.|@", "".join(row[:2]), re.IGNORECASE)  # what GitHub would make a link


def test_a_policy_s_name_is_text_in_the_table(smoke_run):
    submission = submission_of([smoke_run], "Mine", "Us")
    (made,) = submission.runs
    for name in ("`<b>x</b>`", "<b>x</b>", "a|b"):
        shown = replace(submission, runs=(replace(made, run=replace(made.run, policy=name)),))
        (row,) = leaderboard([shown], ["open-v1:smoke"])
        assert row[2] in (f"`{name}`", "&#96;&#60;b&#62;x&#60;/b&#62;&#96;")
        assert row[2].count("`") in (0, 2)


def test_the_leaderboard_counts_runs_with_default_options_alone(smoke_run, tmp_path):
    windy = Path(shutil.copy(smoke_run / "results.json", tmp_path))
    edit(windy, lambda document: document["options"].update(wind_m_s=4.0))
    submission = submission_of([smoke_run, windy], "Mine", "Us")
    still, moved = submission.runs
    assert still.flown_with()
    assert not still.flown_with(wind_m_s=4.0)
    assert moved.flown_with(wind_m_s=4.0)
    lower = replace(still, overall=Rate(30, 15, 0.5, (0.3, 0.7)))
    for runs, shown in (((moved, lower), "50.0 (30 to 70)"), ((lower, moved), "50.0 (30 to 70)"), ((moved,), "–")):
        assert leaderboard([replace(submission, runs=runs)], ["open-v1:smoke"])[0][4] == shown


def test_a_run_has_its_scores_by_family_and_the_commit_that_flew_it(smoke_run):
    (made,) = submission_of([smoke_run], "Mine", "Us").runs
    results = read_results(smoke_run)
    flown = results.summary()
    assert {name: score.passed for name, score in made.summary.families.items()} == {
        name: score.passed for name, score in flown.families.items()
    }
    assert made.summary.overall.pass_given_choice == flown.overall.pass_given_choice
    assert made.summary.choices == flown.choices
    assert (made.commit or "none") == results.platform["commit"]
    assert made.renderer == results.renderer


def test_verify_says_where_something_else_draws(file):
    here = read_submission(file).runs[0].renderer
    for there, differences in ((here, ()), ("NVIDIA H100/PCIe/SSE2", (f"renderer {here} instead of NVIDIA H100",))):

        def drawn(document, there=there):
            document["runs"][0]["renderer"] = there

        edit(file, drawn)
        (checked,) = verify(read_submission(file), 1, seed=1, progress=False)
        assert tuple(text.partition("/")[0] for text in checked.differences) == differences


def test_the_command(smoke_run, tmp_path, capsys):
    out = tmp_path / "mine.json"
    main(["submit", str(smoke_run), "--name", "Mine", "--by", "Us", "--out", str(out)])
    assert "open-v1:smoke: 30 of 30 passed" in capsys.readouterr().out
    assert read_submission(out).name == "Mine"
