"""Attacks by files and folders: results, runs to resume and merge, task files, pictures, answers, journals."""

from __future__ import annotations

import functools
import html.parser
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from attack_tools import Attack, changed, command, each, scratch, why_not_refused

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports.report import render_report
from cognitivedrone.benchmark.runs.records import read_records
from cognitivedrone.benchmark.runs.runner import run as bench
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.errors import CognitiveDroneError, LinkError
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.vehicles.mavlink.client.checks.parameters import ParameterChanges

SUITE = "open-v1:smoke"
MARKUP = '<script>alert(1)</script><img src=x onerror="alert(1)"><a href="javascript:alert(1)">x</a>'
ODD = {
    "empty": b"", "null": b"null", "a number": b"7", "a list": b"[]", "no object": b"{", "brackets": b"[" * 200_000,
    "NaN": b'{"schema": NaN}', "a name twice": b'{"schema": 1, "schema": 2}', "no UTF-8": b"\xff\xfe\x00",
    "zeros": bytes(99),
    "a huge number": b'{"schema": ' + b"9" * 10_000 + b"}", "a huge exponent": b'{"schema": 1e999999}',
}  # fmt: skip
"""Contents that no file of the package has."""
SPECIAL: Mapping[str, Callable[[Path], object]] = {
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a broken link": lambda path: path.symlink_to("nowhere"),
    "a link to itself": lambda path: path.symlink_to(path.name),
}
"""What can lie in the place of a file."""


@functools.cache
def flown() -> Path:
    """A finished run."""
    folder = scratch() / "run"
    bench(Plan.of(policy="hover", suite=SUITE, episodes=2, workers=0, clips=0, out=folder), progress=False)
    return folder


def attacks() -> list[Attack]:
    """All of them."""
    return [
        *each("files of others", {**dict(_contents()), **dict(_results())}),
        *each("folders of runs", dict(_folders())),
        *each("reports", dict(_reports())),
        *each("journals", dict(_journals())),
        *each("files in place of models", dict(_models())),
    ]


def _contents() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Every command that reads a file, with contents and places that are none."""
    readers: dict[str, tuple[object, ...]] = {
        "compare": ("compare", "file", "file"),
        "submit": ("submit", "file", "--name", "a", "--by", "b", "--out", "x.json"),
        "verify": ("verify", "file", "--sample", 1),
        "view --tasks": ("view", "--tasks", "file"),
        "replay": ("reason", "--suite", SUITE, "--episodes", 1, "--reasoner", "replay:file"),
    }
    for reader, words in readers.items():
        for name, content in ODD.items():
            yield f"{reader}: {name}", _refused_with(functools.partial(_write, content), words)
        for name, make in SPECIAL.items():
            yield f"{reader}: {name}", _refused_with(make, words)


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def _refused_with(make: Callable[[Path], object], words: tuple[object, ...]) -> Callable[[Path], str]:
    def run(folder: Path) -> str:
        make(folder / "file")
        return why_not_refused(command(*words))

    return run


def _results() -> Iterator[tuple[str, Callable[[Path], str]]]:
    changes: dict[str, Callable[[Any], object]] = {
        "an episode twice": lambda results: results["episodes"].append(results["episodes"][0]),
        "episodes in another order": lambda results: results["episodes"].reverse(),
        "an episode below 0": lambda results: results["episodes"][0].update(episode=-1),
        "another score": lambda results: results["scores"]["through"]["overall"].update(passed=2),
        "a time that is no number": lambda results: results["episodes"][0]["stages"][0].update(time_s=math.nan),
        "another outcome": lambda results: results["episodes"][0]["stages"][0].update(outcome="passed"),
        "an unknown option": lambda results: results["options"].update(luck=1),
        "an extra key": lambda results: results.update(extra=1),
        "a policy that is a list": lambda results: results.update(policy=["os", "system"]),
        "an episode that is text": lambda results: results["episodes"].__setitem__(0, "x"),
    }
    for name, change in changes.items():

        def run(folder: Path, change: Callable[[Any], object] = change) -> str:
            document = json.loads((flown() / "results.json").read_text())
            (folder / "results.json").write_text(json.dumps(changed(document, change)))
            return why_not_refused(command("compare", "results.json", "results.json"))

        yield f"results: {name}", run


def _folders() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """A folder that somebody else prepared, in which a run is resumed, overwritten or merged."""
    words = (
        "bench",
        "--suite",
        SUITE,
        "--policy",
        "hover",
        "--episodes",
        2,
        "--workers",
        0,
        "--clips",
        0,
        "--out",
        "run",
    )
    files = (
        "run.json",
        "episodes.jsonl",
        "results.json",
        "results.json.tmp",
        "report.html",
        "report.html.tmp",
        "errors",
    )
    for option in ("--resume", "--overwrite"):
        for name in files:

            def linked(folder: Path, option: str = option, name: str = name) -> str:
                target = _copied(folder / "run") / name
                target.unlink(missing_ok=True)
                target.symlink_to(folder.parent / "secret.txt")
                if name != "run.json":
                    (folder / "run" / "run.json").touch()
                return why_not_refused(command(*words, option), "")

            yield f"bench {option}: {name} is a link to another file", linked
    for name in ("run.json", "episodes.jsonl", "results.json"):
        for what in ("a pipe", "a folder"):

            def special(folder: Path, name: str = name, what: str = what) -> str:
                target = _copied(folder / "run") / name
                target.unlink()
                SPECIAL[what](target)
                return why_not_refused(command(*words, "--resume"))

            yield f"bench --resume: {name} is {what}", special

    def other_policy(folder: Path) -> str:
        file = _copied(folder / "run") / "run.json"
        file.write_text(json.dumps(json.loads(file.read_text()) | {"policy": "os:system:touch OWNED"}))
        return why_not_refused(command(*words, "--resume"), "contains another run")

    def other_results(folder: Path) -> str:
        file = _copied(folder / "run") / "results.json"
        file.write_text(json.dumps(json.loads(file.read_text()) | {"policy": "Great"}))
        ended = command(*words, "--resume")
        return "" if ended.code == 0 and "Great" not in ended.out else f"exit code {ended.code}: {ended.out[:200]!r}"

    def merged(change: Callable[[Path], object]) -> Callable[[Path], str]:
        def run(folder: Path) -> str:
            for number in (1, 2):
                part = folder / f"part-{number}"
                command(*words[:-1], part, "--shard", f"{number}/2")
                change(part)
            ended = command("merge", "part-1", "part-2", "--out", "whole")
            return "" if ended.code == 0 else why_not_refused(ended)

        return run

    def stolen(part: Path) -> None:
        (part / "errors").mkdir(exist_ok=True)
        (part / "errors" / "episode-0000.txt").symlink_to(part.parents[1] / "secret.txt")

    def huge(part: Path) -> None:
        for name in ("run.json", "results.json"):
            document = json.loads((part / name).read_text())
            document["suite"] |= {"name": "open-v1:train", "size": 10**15}
            (part / name).write_text(json.dumps(document))

    def of_many(part: Path) -> None:
        for name in ("run.json", "results.json"):
            document = json.loads((part / name).read_text())
            document["options"] |= {"shard": "1/999999"}
            (part / name).write_text(json.dumps(document))

    def links(part: Path) -> None:
        (part / "errors").symlink_to(part.parents[1])

    yield "bench --resume: a run that names code", other_policy
    yield "bench --resume: results of another pilot", other_results
    yield "merge: errors that are links to other files", merged(stolen)
    yield "merge: errors that are a link to a folder", merged(links)
    yield "merge: a suite of 10^15 tasks", merged(huge)
    yield "merge: a million shards", merged(of_many)


def _copied(folder: Path) -> Path:
    folder.mkdir()
    for name in ("run.json", "episodes.jsonl", "results.json", "report.html"):
        (folder / name).write_bytes((flown() / name).read_bytes())
    return folder


class _Markup(html.parser.HTMLParser):
    """Finds what a browser would run or load."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            loads = name in ("src", "href") and not (value or "").startswith(("data:image/", "data:video/", "#"))
            if name.startswith("on") or (loads and tag != "link"):
                self.found.append(f"<{tag} {name}={value!r}>")

    def handle_data(self, data: str) -> None:
        if self.get_starttag_text() and "alert(1)" in (self.get_starttag_text() or ""):
            self.found.append(data)


def _reports() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Texts of results in the HTML report."""
    changes: dict[str, Callable[[Any], object]] = {
        "policy": lambda results: results.update(policy=MARKUP),
        "reasoner": lambda results: results.update(reasoner=MARKUP),
        "renderer": lambda results: results.update(renderer=MARKUP),
        "suite": lambda results: results["suite"].update(name=MARKUP),
        "message": lambda results: results["episodes"][0].update(message=MARKUP),
        "task": lambda results: results["episodes"][0]["stages"][0].update(task_id=MARKUP),
        "family": lambda results: [
            stage.update(family=MARKUP) for each in results["episodes"] for stage in each["stages"]
        ],
        "directive": lambda results: results["episodes"][0]["stages"][0].update(directive=MARKUP),
        "versions": lambda results: results["versions"].update({MARKUP: MARKUP}),
        "platform": lambda results: results["platform"].update(command=MARKUP, processor=MARKUP, commit=MARKUP),
        "end": lambda results: results["timing"].update(finished=MARKUP),
    }
    for name, change in changes.items():

        def run(folder: Path, change: Callable[[Any], object] = change) -> str:
            from cognitivedrone.benchmark.scores.results import results_from_json, results_to_json

            document = changed(json.loads((flown() / "results.json").read_text()), change)
            document["scores"] = _scores_of(document)
            try:
                results = results_from_json(document, "results")
            except CognitiveDroneError:
                return ""
            assert results_to_json(results)["policy"] == document["policy"]  # noqa: S101 - it was read as it is
            records = read_records(flown())
            page = render_report(results, [records[index].trace for index in sorted(records)], (), ())
            plain = render_report(read_results(flown()), [records[index].trace for index in sorted(records)], (), ())
            found, usual = _Markup(), _Markup()
            found.feed(page)
            usual.feed(plain)
            more = [each for each in found.found if each not in usual.found]
            return f"the page has {more[0]}" if more or page.count("<script") > plain.count("<script") else ""

        yield f"report.html: {name}", run


def _scores_of(document: Any) -> Any:
    """Scores that follow from changed episodes."""
    from cognitivedrone.benchmark.scores.codec import decode, encode
    from cognitivedrone.benchmark.scores.scoring import RULES, summarize
    from cognitivedrone.types import EpisodeResult

    episodes = [decode(EpisodeResult, each, "") for each in document["episodes"]]
    return {rule: encode(summarize(episodes, rule)) for rule in RULES}


def _journals() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """The journal of a vehicle's parameters decides what is set on a vehicle."""
    values = ("[NaN, 1]", "[1, Infinity]", "[1e999, 1]", f"[{'9' * 400}, 1]", "[1]", "1", '"x"', "[[1], 2]", "null")
    texts = {f"FENCE_ENABLE is {value[:20]}": f'{{"FENCE_ENABLE": {value}}}' for value in values}
    names = ("../x", "", "A B", "a" * 500, "FENCE\\u0000", "FENCE\\n", "\\ud800")
    texts |= {f"a parameter {name[:12]!a}": f'{{"{name}": [1, 2]}}' for name in names}
    texts |= {name: content.decode("latin-1") for name, content in ODD.items() if name not in ("a list",)}
    for name, text in texts.items():

        def run(folder: Path, text: str = text) -> str:
            (folder / "journal.json").write_text(text, encoding="latin-1")
            try:
                ParameterChanges(folder / "journal.json")
            except LinkError as error:
                return "" if "\n" not in str(error) else "more than one line"
            return "it was read"

        yield name, run


def _models() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Files in place of a model's or a reasoner's."""
    made: dict[str, Callable[[str], object]] = {"small": make_policy, "race": make_policy, "replay": make_reasoner}
    for kind, make in made.items():
        for name, place in SPECIAL.items():

            def run(
                folder: Path,
                kind: str = kind,
                make: Callable[[str], object] = make,
                place: Callable[[Path], object] = place,
            ) -> str:
                place(folder / "file.onnx")
                try:
                    make(f"{kind}:file.onnx")
                except CognitiveDroneError as error:
                    return "" if "\n" not in str(error) else "more than one line"
                return "it was made"

            yield f"{kind}: {name}", run
