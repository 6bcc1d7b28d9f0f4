"""Flies the audits of a pilot: one run a variant, each resumed where an earlier one stopped.

The result of an audit: a table for the terminal, and a self-contained page.
"""

from __future__ import annotations

import itertools
import json
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from cognitivedrone.audit.catalogue import AUDITS, CHANCE_BAND, FALL, FOLLOWED, Audit, Expected, Variant
from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports.tables import interval, new_table, percent
from cognitivedrone.benchmark.runs.runner import results_folder, run
from cognitivedrone.benchmark.scores.results import Results, write_whole
from cognitivedrone.benchmark.scores.scoring import CHANCE, OUTCOMES, Interval, wilson
from cognitivedrone.errors import RunError, did_you_mean
from cognitivedrone.files import check_no_link, safe_name, writing
from cognitivedrone.reasoners import NONE
from cognitivedrone.tasks import Suite, open_suite
from cognitivedrone.tasks.format import task_to_json
from cognitivedrone.terminal import console
from cognitivedrone.text.pages import render_page
from cognitivedrone.types import Outcome, StageResult, Task, Track

BASELINE = "as it is"
AUDIT_FILE = "audit.json"
SCHEMA = "cognitivedrone.audit/1"
FEWEST_FLIGHTS: Final = 30
"""A row of fewer flights has no verdict: with 10, a pilot that only flies straight on is sound in most rows."""
_BY_PLACE = frozenset({"relations", "memory", "race", "absent"})
"""Families that are left out: a sentence about places does not follow its panels, and the others are no choice."""


@dataclass(frozen=True, slots=True)
class Row:
    """What a pilot did under one change."""

    audit: str
    variant: str
    expected: Expected
    n: int
    """Flights counted; a change that does not fit a task leaves it out."""
    rate: float | None
    """Share that flew through the right gate; for `chance`, among the flights that chose a gate; for `same choice`,
    share that chose the gate that was chosen before."""
    ci95: Interval | None
    baseline: float | None
    """The pilot's rate on the same tasks as they are."""
    declined: int
    """Flights that reported that no gate matches the instruction."""
    chosen: tuple[int, int, int, int]
    """Flights at gate 1, 2, 3 and none."""
    sound: bool | None
    """Whether it is as expected: `as before` compares the rates, the others fail if the interval excludes what is
    required. None if there are fewer than `FEWEST_FLIGHTS`."""
    outcomes: Mapping[Outcome, int]
    """Flights by outcome, in the order of `OUTCOMES`."""


def audit(plan: AuditPlan, *, progress: bool = True) -> list[Row]:
    """Fly all audits and return a row for each variant, the baseline first; also written to `audit.json`.

    Raises `RunError` for an unknown audit or a suite without choices.
    """
    chosen = _chosen(plan.only)
    folder = folder_of(plan)
    suite = open_suite(plan.source.suite, plan.source.tasks, size=plan.episodes, seed=plan.source.seed)
    tracks = list(_audited(suite))[: plan.episodes]
    if not tracks:
        raise RunError(f"{plan.source.title} has no task with three gates and a right one; audits need choices")
    runs = [
        (each, variant, changed)
        for each in chosen
        for variant in each.variants
        if (changed := list(_changed(plan.source.seed, tracks, each, variant)))
    ]
    screen = console(stderr=True, quiet=not progress)
    screen.print(f"audit 1/{len(runs) + 1}: baseline, {BASELINE}")
    before = _fly(plan, folder / "baseline", tracks, Variant(BASELINE), progress)
    usual = {stage.task_id: stage for stage in _stages(before)}
    rows = [_row(Audit("baseline", "", "as before", ()), Variant(BASELINE), _stages(before), usual)]
    _write(folder, plan, suite, rows)
    for number, (each, variant, changed) in enumerate(runs, start=2):
        screen.print(f"audit {number}/{len(runs) + 1}: {each.name}, {variant.name}")
        name = safe_name(re.sub(r"\W+", "-", f"{each.name}-{variant.name}").strip("-"))
        results = _fly(plan, folder / name, changed, variant, progress)
        rows.append(_row(each, variant, _stages(results), usual))
        _write(folder, plan, suite, rows)
    return rows


def folder_of(plan: AuditPlan) -> Path:
    """The folder given, or one named after suite, policy and reasoner."""
    pilot = plan.pilot.shown
    return plan.out or results_folder("audit", plan.source.title, pilot.policy, pilot.reasoner)


def _chosen(names: Iterable[str]) -> tuple[Audit, ...]:
    known = {each.name: each for each in AUDITS}
    for name in names:
        if name not in known:
            raise RunError(f"unknown audit {name!r}; {did_you_mean(name, known)}")
    return tuple(each for each in AUDITS if each.name in names) or AUDITS


def _audited(suite: Suite) -> Iterator[Track]:
    """The missions, and of all other tracks each task that is a choice by itself."""
    for track in suite.tracks:
        if track[0].mission is not None:
            yield track
        else:
            yield from ((task,) for task in track if _is_choice(task))


def _is_choice(task: Task) -> bool:
    return task.target is not None and task.only is None and task.missing is None and task.family not in _BY_PLACE


def _changed(seed: int, tracks: Iterable[Track], each: Audit, variant: Variant) -> Iterator[Track]:
    key = zlib.crc32((variant.seed_name or f"{each.name}/{variant.name}").encode())
    for index, track in enumerate(tracks):
        changed = _change(variant, np.random.default_rng([6, seed, key, index]), track)
        if changed is not None:
            yield changed


def _change(variant: Variant, rng: np.random.Generator, track: Track) -> Track | None:
    if variant.change is None and variant.mission is None:
        return track
    if track[0].mission is not None:
        return None if variant.mission is None else variant.mission(rng, track)
    task = None if variant.change is None else variant.change(rng, track[0])
    return None if task is None else (task,)


def _fly(plan: AuditPlan, folder: Path, tracks: list[Track], variant: Variant, progress: bool) -> Results:
    file = folder.with_suffix(".json")
    with writing(folder, RunError, "give another --out"):
        folder.parent.mkdir(parents=True, exist_ok=True)
        check_no_link(folder.parent, folder.name)
    write_whole(file, json.dumps([task_to_json(task) for track in tracks for task in track], indent=1) + "\n")
    policy, reasoner = plan.pilot.policy, plan.pilot.reasoner
    if variant.camera:
        policy = _filtered("FilteredPolicy", policy, variant)
        reasoner = reasoner if reasoner == NONE else _filtered("FilteredReasoner", reasoner, variant)
    return run(
        Plan.of(
            policy=policy,
            reasoner=reasoner,
            suite="",
            tasks=file,
            labels=plan.source.labels,
            seed=plan.source.seed,
            workers=plan.workers,
            out=folder,
            resume=True,
            clips=0,
            **variant.options,
        ),
        progress=progress,
    )


def _filtered(kind: str, name: str, variant: Variant) -> str:
    options = ",".join(f"{key}={value:g}" for key, value in variant.camera.items())
    return f'cognitivedrone.audit.catalogue:{kind}:"{name}",{options}'


def _stages(results: Results) -> list[StageResult]:
    return [stage for episode in results.episodes for stage in episode.stages if stage.outcome != "invalid"]


def _row(each: Audit, variant: Variant, stages: list[StageResult], before: Mapping[str, StageResult]) -> Row:
    """`before` are the stages of the baseline, by task."""
    declined = sum(stage.outcome == "false_alarm" for stage in stages)
    usual = [before[stage.task_id] for stage in stages if stage.task_id in before]
    counted = stages
    if each.expected == "chance":
        counted = [stage for stage in stages if stage.chosen is not None]
        right = sum(stage.chosen == stage.target for stage in counted)
    elif each.expected == "same choice":  # of a mission's stages, only those that were flown before as well
        counted = [stage for stage in stages if stage.task_id in before]
        right = sum(stage.chosen == was.chosen for stage, was in zip(counted, usual, strict=True))
    else:
        right = sum(stage.outcome == "passed" for stage in stages)
    ci95, n = wilson(right, len(counted)), len(counted)
    rate = right / n if n else None
    baseline = sum(stage.outcome == "passed" for stage in usual) / len(usual) if usual else None
    places = [stage.chosen for stage in stages]
    chosen = places.count(0), places.count(1), places.count(2), places.count(None)
    enough = len(stages) >= FEWEST_FLIGHTS and (n == 0 or n >= FEWEST_FLIGHTS)
    sound = is_sound(each.expected, rate, ci95, baseline) if enough else None
    tally = Counter(stage.outcome for stage in stages)
    outcomes = {outcome: tally[outcome] for outcome in OUTCOMES if tally[outcome]}
    return Row(each.name, variant.name, each.expected, n, rate, ci95, baseline, declined, chosen, sound, outcomes)


def is_sound(expected: Expected, rate: float | None, ci95: Interval | None, baseline: float | None) -> bool:
    """Whether rates are as expected; the interval is that of `rate`, both none if no gate was chosen."""
    if rate is None or ci95 is None:
        return True  # nothing was chosen: nothing gave the answer away
    low, high = ci95
    if expected == "chance":
        return low <= CHANCE + CHANCE_BAND and high >= CHANCE - CHANCE_BAND
    if expected in ("follows", "same choice"):
        return high >= FOLLOWED
    return baseline is None or round(baseline - rate, 9) <= FALL  # 0.8 - 0.7 is more than 0.1 in floating point


def _write(folder: Path, plan: AuditPlan, suite: Suite, rows: list[Row]) -> None:
    document = {
        "schema": SCHEMA,
        "suite": {"name": suite.name, "digest": suite.digest},
        "policy": plan.pilot.shown.policy,
        "reasoner": plan.pilot.shown.reasoner,
        "episodes": plan.episodes,
        "seed": plan.source.seed,
        "rows": [asdict(row) for row in rows],
    }
    write_whole(folder / AUDIT_FILE, json.dumps(document, indent=1) + "\n")


PAGE_FILE: Final = "audit.html"
EXPECTED: Final = {
    "as before": "the rate falls by at most 10 points",
    "follows": "at least 95 %, or an interval that reaches it",
    "same choice": "the same gate as before in at least 95 %, or an interval that reaches it",
    "chance": "33 %, to 7 points, or an interval that reaches that",
}
VERDICTS: Final = {True: "yes", False: "NO", None: "too few"}


def audit_table(plan: AuditPlan, rows: Sequence[Row]) -> RenderableType:
    """The rows, one a variant, below the names of their audits. In 80 columns; names wrap where they do not fit."""
    pilot = plan.pilot.shown
    title = f"audit of {pilot.policy}, reasoner {pilot.reasoner}, on {plan.source.title}"
    table = new_table(title, "", "n", "rate", "95 % CI", "before", "declined", "sound")
    table.columns[0].no_wrap = False
    for row, last in zip(rows, [None, *rows], strict=False):
        if last is None or row.audit != last.audit:
            table.add_row(Text(row.audit, style="bold"))
        table.add_row(
            Text(f"  {row.variant}"),
            str(row.n),
            percent(row.rate),
            interval(row.ci95),
            percent(row.baseline),
            str(row.declined),
            VERDICTS[row.sound],
        )
    few = any(row.sound is None for row in rows)
    notes = [
        "before: the same tasks as they are; declined: the pilot reported that nothing fits",
        *([f"too few: below {FEWEST_FLIGHTS} flights, which show neither a sound pilot nor another"] if few else []),
    ]
    return Group(table, "", *(Text(note, style="dim") for note in notes))


def render_audit(plan: AuditPlan, rows: Sequence[Row]) -> str:
    """The page; it loads nothing, and all text in it is escaped."""
    groups = [(name, list(part)) for name, part in itertools.groupby(rows, key=lambda row: row.audit)]
    return render_page(
        "cognitivedrone.audit",
        "audit.html.j2",
        {"percent": percent, "interval": interval},
        plan=plan,
        groups=groups,
        questions={each.name: each.question for each in AUDITS},
        expected=EXPECTED,
        chance=CHANCE,
        unsound=[row for row in rows if row.sound is False],
        too_few=sum(row.sound is None for row in rows),
        fewest=FEWEST_FLIGHTS,
        runs=len(rows),
    )
