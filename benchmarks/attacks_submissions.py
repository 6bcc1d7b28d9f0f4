"""Attacks by submissions to the leaderboard: false scores, and texts that become markup."""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from attack_tools import Attack, changed, command, each, scratch, why_not_refused

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.measurements import markdown
from cognitivedrone.benchmark.runs.runner import run as bench
from cognitivedrone.benchmark.scores.codec import decode, encode
from cognitivedrone.benchmark.submission import leaderboard, read_submission, submission_of, write_submission
from cognitivedrone.benchmark.submission_file import SubmittedRun, scores_of, stages_of
from cognitivedrone.errors import CognitiveDroneError

SUITE = "open-v1:smoke"
FAILED = {"outcome": "out_of_bounds", "chosen": None}
INVALID = {"outcome": "invalid", "chosen": None}
NAMES = (
    "<script>alert(1)</script>", "<img src=x onerror=alert(1)>", "[x](javascript:alert(1))", "![x](http://evil.org/x)",
    "**bold**", "`code`", "a | b | c", "http://evil.org", "www.evil.org", "me@evil.org", "<!-- end -->", "&lt;b&gt;",
    "[x]: http://evil.org", "~~x~~", "</table>", "\\| x", "{: onclick=x }", "# head",
)  # fmt: skip
"""Texts that are allowed, and must be nothing but text in the table."""
UNSHOWABLE = ("a\nb", "a\x1b[2Jb", "a\u202eb", "a\ud800", "a\u200bb", "", " " * 5, "x" * 5000, "a\x00", "a\u2028b")
URLS = (
    "javascript:alert(1)", "data:text/html,<script>", "https://a](javascript:x)", "https://a b", "https://a|b",
    "https://a\nb", 'https://a" onclick="x', "https://a<script>", "//evil.org", "file:///etc/passwd",
    "https://me:word@evil.org", "https://a\u202eb.org",
)  # fmt: skip


def honest() -> tuple[Path, dict[str, Any]]:
    """A file of a run that was really flown, and its content."""
    folder = scratch()
    bench(Plan.of(policy="oracle", suite=SUITE, workers=0, clips=0, out=folder / "run"), progress=False)
    write_submission(folder / "honest.json", submission_of([folder / "run"], "Honest", "Us"))
    return folder / "honest.json", json.loads((folder / "honest.json").read_text())


def attacks(file: Path, document: Mapping[str, Any]) -> list[Attack]:
    """All of them, made from an honest file and its content."""
    return [
        *each("tampered submissions", {**dict(_inconsistent(document)), **dict(_false(file, document))}),
        *each("texts of submissions", dict(_texts(document))),
    ]


def _inconsistent(document: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[Path], str]]]:
    """What reading a file finds."""
    first = document["runs"][0]
    changes: dict[str, Callable[[Any], object]] = {
        "a higher rate": lambda run: run["overall"].update(rate=1.5),
        "more passed": lambda run: run["overall"].update(passed=31),
        "a rate that is no number": lambda run: run["overall"].update(rate=math.nan),
        "an infinite rate": lambda run: run["overall"].update(rate=math.inf),
        "a higher mean": lambda run: run.update(mean=2.0),
        "a category more": lambda run: run["categories"].update(racing=run["overall"]),
        "a category less": lambda run: run["categories"].popitem(),
        "an episode twice": lambda run: run["flown"].append(run["flown"][0]),
        "an episode in place of another": _replaced,
        "an episode left out": lambda run: run["flown"].pop(),
        "all episodes left out": lambda run: run.update(flown=[]),
        "a stage twice": lambda run: run["flown"][2].append(run["flown"][2][0]),
        "an episode without stages": lambda run: run["flown"].__setitem__(2, []),
        "another suite's hash": lambda run: run["run"]["suite"].update(digest="0" * 64),
        "another suite's size": lambda run: run["run"]["suite"].update(size=3),
        "a suite of one's own": lambda run: run["run"]["suite"].update(name="mine.json"),
        "a suite that is a path": lambda run: run["run"]["suite"].update(name="../secret.txt"),
        "an unknown outcome": lambda run: run["flown"][0][0].update(outcome="won"),
        "a fourth gate": lambda run: run["flown"][0][0].update(chosen=3),
        "a gate below 0": lambda run: run["flown"][0][0].update(chosen=-1),
        "passed at another gate": lambda run: run["flown"][0][0].update(chosen=(run["flown"][0][0]["chosen"] + 1) % 3),
        "wrong gate at the right one": lambda run: run["flown"][0][0].update(outcome="wrong_gate"),
        "not reached at the start": lambda run: run["flown"][0][0].update(outcome="not_reached", chosen=None),
        "invalid without new scores": lambda run: run["flown"][0][0].update(INVALID),
        "another seed as text": lambda run: run["run"]["options"].update(seed="0"),
        "another seed as false": lambda run: run["run"]["options"].update(seed=False),
        "an unknown option": lambda run: run["run"]["options"].update(luck=7),
        "an option left out": lambda run: run["run"]["options"].pop("seed"),
        "a few episodes": lambda run: run["run"]["options"].update(episodes=5),
        "a shard": lambda run: run["run"]["options"].update(shard="1/9"),
        "weights that are a list": lambda run: run["run"]["options"].update(model=[[]]),
        "weights that are no hash": lambda run: run["run"]["options"].update(model="x"),
        "an extra key": lambda run: run.update(trusted=True),
        "a key left out": lambda run: run.pop("finished"),
        "an end that is no time": lambda run: run.update(finished="<b>now</b>"),
        "a commit that is no commit": lambda run: run.update(commit="[x](http://evil.org)"),
        "a command with an escape": lambda run: run.update(command="\x1b[2J"),
        "a machine of two lines": lambda run: run.update(machine="a\nb"),
        "a version with a direction": lambda run: run["run"]["versions"].update(numpy="\u202e"),
    }
    for name, change in changes.items():
        yield name, _unreadable(changed(document, lambda whole, change=change: change(whole["runs"][0])))
    newer = changed(first, lambda run: run["run"]["versions"].update(numpy="99"))
    other = changed(first, lambda run: run["run"]["options"].update(model="0" * 64, wind_m_s=1.0))
    for name, runs in {
        "no run": [],
        "a run twice": [first, first],
        "a run twice, of another version": [first, newer],
        "runs of other weights": [first, other],
    }.items():
        yield name, _unreadable({**document, "runs": runs})
    text = json.dumps(document)
    yield "a name twice in an object", _unreadable(text.replace('"name"', '"name": "Nobody", "name"', 1))
    yield "10 million brackets", _unreadable("[" * 10_000_000)
    yield "a number of 5,000 digits", _unreadable(text.replace('"passed": 30', f'"passed": {"9" * 5000}', 1))


def _replaced(run: Any) -> None:
    """Another flight, through another gate, in the place of the first."""
    run["flown"][0] = next(flight for flight in run["flown"] if flight[0]["chosen"] != run["flown"][0][0]["chosen"])


def _false(file: Path, document: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[Path], str]]]:
    """What flying a sample finds. `random` passes nothing; what it is said to pass is false."""

    def claim(ends: Callable[[int, Mapping[str, Any]], Mapping[str, Any]], policy: str = "random") -> dict[str, Any]:
        """A file of this policy whose flights ended so, with scores that follow from that."""
        whole = changed(document, lambda whole: whole["runs"][0]["run"].update(policy=policy))
        (run,) = whole["runs"]
        run["flown"] = [[dict(ends(index, stage)) for stage in flight] for index, flight in enumerate(run["flown"])]
        made = decode(SubmittedRun, run, "")
        overall, categories, mean = scores_of([*stages_of(made, "")])
        return {**whole, "runs": [encode(replace(made, overall=overall, categories=categories, mean=mean))]}

    def third_invalid(index: int, stage: Mapping[str, Any]) -> Mapping[str, Any]:
        return INVALID if index % 3 else stage

    yield "control: what is honest is confirmed", _ends(dict(document), 0, 4)
    yield "all passed", _ends(claim(lambda _index, stage: stage), 1, 4)
    yield "half passed", _ends(claim(lambda index, stage: stage if index % 2 else FAILED), 1, 8)
    yield "failures called invalid", _ends(claim(lambda index, stage: INVALID if index > 1 else stage), 1, 4)
    yield "all called invalid but one", _ends(claim(lambda index, stage: INVALID if index else stage, "oracle"), 1, 4)
    yield "passes called invalid", _ends(claim(third_invalid, "oracle"), 1, 4)
    yield "another failure than it was", _ends(claim(lambda _index, _stage: {"outcome": "missed", "chosen": 0}), 1, 4)
    yield "passes called failures", _ends(claim(lambda _index, _stage: FAILED, "oracle"), 1, 4)

    def honest_where_seed_0_looks(folder: Path) -> str:
        """Whoever knows the sample is honest in it alone."""
        import numpy as np

        n = len(document["runs"][0]["flown"])
        known = {int(index) for index in np.random.default_rng([0, n]).choice(n, 6, replace=False)}
        whole = claim(lambda index, stage: stage if index in known else FAILED, "oracle")
        (folder / "file.json").write_text(json.dumps(whole))
        ended = command("verify", "file.json", "--sample", 6)
        return "" if ended.code == 1 else f"exit code {ended.code}: {(ended.out + ended.err)[-200:]!r}"

    yield "honest in the sample of seed 0", honest_where_seed_0_looks
    yield "other weights", _refused(changed(document, lambda w: w["runs"][0]["run"]["options"].update(model="0" * 64)))
    yield (
        "other code",
        _refused(changed(document, lambda w: w["runs"][0]["run"]["options"].update(policy_code="0" * 64))),
    )


def _ends(document: Mapping[str, Any], code: int, sample: int) -> Callable[[Path], str]:
    """`verify` must end with this exit code."""

    def run(folder: Path) -> str:
        (folder / "file.json").write_text(json.dumps(document))
        ended = command("verify", "file.json", "--sample", sample)
        return "" if ended.code == code else f"exit code {ended.code}: {(ended.out + ended.err)[-200:]!r}"

    return run


def _unreadable(document: Any) -> Callable[[Path], str]:
    """Reading must refuse this content in one sentence, before anything is flown."""

    def run(folder: Path) -> str:
        content = document if isinstance(document, str) else json.dumps(document)
        (folder / "file.json").write_text(content)
        try:
            read_submission(folder / "file.json")
        except CognitiveDroneError:
            return why_not_refused(command("verify", "file.json", "--sample", 1))
        return "it was read"

    return run


def _refused(document: Any) -> Callable[[Path], str]:
    def run(folder: Path) -> str:
        (folder / "file.json").write_text(json.dumps(document))
        return why_not_refused(command("verify", "file.json", "--sample", 1), "is another file here")

    return run


def _texts(document: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[Path], str]]]:
    for text in UNSHOWABLE:
        yield f"name {text[:20]!a}", _unreadable({**document, "name": text})
        yield f"author {text[:20]!a}", _unreadable({**document, "by": text})
    for url in URLS:
        yield f"url {url!a}", _unreadable({**document, "url": url})
    for text in NAMES:
        yield f"leaderboard, {text!a}", _only_text(document, text)


def _only_text(document: Mapping[str, Any], text: str) -> Callable[[Path], str]:
    """Name, author and machine must be nothing but text in the table's Markdown and its HTML."""

    def run(folder: Path) -> str:
        from markdown import markdown as page_of  # with the documentation's tools

        (folder / "file.json").write_text(json.dumps({**document, "name": text, "by": text}))
        (row,) = leaderboard([read_submission(folder / "file.json")], [SUITE])
        page = page_of(markdown(["pilot", "by", "policy", "reasoner", "score"], [row]), extensions=["extra"])
        cells = re.findall(r"<td>(.*?)</td>", page, re.DOTALL)
        if len(cells) != 5:
            return f"the row has {len(cells)} cells"
        for cell in cells[:2]:
            if "<" in cell or html.unescape(cell) != text:
                return f"it is shown as {cell!r}"
        return "an address in it becomes a link" if re.search(r"://|www\.|@", "".join(row[:2])) else ""

    return run
