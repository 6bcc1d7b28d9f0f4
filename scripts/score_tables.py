"""Tables of scores in README.md and docs/: of the runs in results/PILOT.json, and of what was measured of pilots."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from table_kinds import NOT_MEASURED, Description, Store, Table, cell, is_former, own_options

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.scores.published import PUBLISHED
from cognitivedrone.benchmark.scores.scoring import Interval, Score, Summary, wilson
from cognitivedrone.benchmark.submission import SubmittedRun, leaderboard
from cognitivedrone.types import CATEGORIES

PILOTS = {
    "r1": "**R1**: `small` with `--reasoner small`",
    "small": "**`small`**: our small VLA, from the raw instruction",
    "colour_seeker_oracle": "`colour_seeker` with gold directives (`--reasoner oracle`): flies, need not choose",
    "colour_seeker": "`colour_seeker` with the raw instruction: chooses at random",
    "cloned": "Stable-Baselines3's own network, cloned from 600 flights (`benchmarks/cloning.py`)",
    "act": "LeRobot's ACT, from the same 600 flights ([commands](own_policy.md#with-other-peoples-training))",
    "learnt": "Stable-Baselines3's PPO from the privileged state, told the right gate (`benchmarks/ppo.py`)",
    "race": "`race`: the paper's baseline, without language: flies at the middle one of three gates",
    "oracle": "`oracle`: uses privileged state",
    "hover": "`hover`: stays where it is",
    "random": "`random`: a new random velocity every second",
    "small_oracle": "`small` with `--reasoner oracle`: from gold directives",
    **{f"small_seed_{seed}": f"`small`, its flying trained on with seed {seed}" for seed in (1, 2, 3)},
}
"""Files of submissions, and how tables name the pilots."""
HELD_OUT = ("open-v2:words", "open-v2:pictures", "open-v1:unseen", "open-v2:layouts", "open-v2:absent")
OPENED_LAST = ("open-v3:words", "open-v3:photos", "open-v3:wild")
DRAWN_ANEW = ("open-v1:test", "open-v1:hard")
README_SUITES = (
    "open-v1:test",
    "open-v1:hard",
    "open-v2:layouts",
    "open-v1:unseen",
    "open-v2:words",
    "open-v2:pictures",
)
MORE = ("open-v2:test", "open-v1:track")
LEADERBOARD = ("open-v2:words", "open-v2:pictures", "open-v1:unseen", "open-v1:test", "open-v1:hard")
"""Columns: held-out suites first."""
FROM_DATA = {"recorded_500": "500", "recorded_2000": "2,000", "recorded_8062": "8,062"}


def rate(score: Score | None, digits: int = 1) -> str:
    """A rate with its interval, in per cent."""
    if score is None or score.rate is None or score.ci95 is None:
        return NOT_MEASURED
    return f"{100 * score.rate:.{digits}f} ({interval(score.ci95, 0)})"


def interval(ci95: Interval | None, digits: int = 1) -> str:
    """An interval in per cent."""
    return "" if ci95 is None else f"{100 * ci95[0]:.{digits}f} to {100 * ci95[1]:.{digits}f}"


def passed(score: Score | None) -> list[str]:
    """Passed, rate and interval, each in its cell."""
    if score is None:
        return [NOT_MEASURED, "", ""]
    return [f"{score.passed} of {score.n}", share(score.rate), interval(score.ci95)]


def share(value: float | None) -> str:
    """A share in per cent."""
    return "" if value is None else f"{100 * value:.1f} %"


def by_suite(pilots: Iterable[str], suites: Sequence[str]) -> Description:
    """Pilots down, suites across."""

    def describe(store: Store) -> Table:
        rows = []
        for pilot in pilots:
            scores = [store.summary(pilot, suite) for suite in suites]
            rows.append([PILOTS[pilot], *(rate(found and found.overall) for found in scores)])
        return Table(["pilot", *(f"`{suite}`" for suite in suites)], rows)

    return describe


def all_runs(store: Store) -> Table:
    """Every run in the files of the pilots."""
    rows = []
    for pilot in PILOTS:
        for run in store.runs(pilot):
            score = run.summary.overall
            given = share(score.pass_given_choice)
            before = ", before" * is_former(run)
            rows.append([f"`{flags_of(run)}`", f"`{pilot}`", *passed(score), given, f"{run.finished[:10]}{before}"])
    heads = ["`cognitivedrone bench` with", "pilot", "passed", "rate", "95 % interval", "success given choice", "date"]
    return Table(heads, rows or [[NOT_MEASURED, *[""] * 6]])


def other_conditions(*pilots: str) -> Description:
    """Runs of pilots with other options than the default, beside the rate of the same pilot and suite without them."""

    def describe(store: Store) -> Table:
        rows = []
        for pilot in pilots:
            for run in store.runs(pilot):
                flags, suite = flags_of(run), run.run.suite.name
                if flags == f"--suite {suite}" or run.flown_with(**own_options(suite)):
                    continue
                usual = store.summary(pilot, suite)
                without = share(usual.overall.rate) if usual else NOT_MEASURED
                before = ", before" * is_former(run)
                rows.append([f"`{flags}`{before}", f"`{pilot}`", *passed(run.summary.overall), without])
        heads = ["`cognitivedrone bench` with", "pilot", "passed", "rate", "95 % interval", "rate without"]
        return Table(heads, rows or [[NOT_MEASURED, *[""] * 5]])

    return describe


def flags_of(run: SubmittedRun) -> str:
    """What a run's command had besides the pilot."""
    flags = {"track": "--track", "guard": "--guard", "appearance": "--appearance {}", "airframe": "--airframe {}"}
    flags |= {
        "place": "--place {}",
        "wind_m_s": "--wind {:g}",
        "latency": "--latency {}",
        "link": "--link {}",
        "look": "--look {}",
    }
    flags["seed"] = "--seed {}"
    defaults = {name: default for name, (_, default) in Plan.identity_options().items()}
    given = {name: run.run.option(name) for name in flags if run.run.option(name) != defaults[name]}
    return " ".join([f"--suite {run.run.suite.name}", *(flags[name].format(value) for name, value in given.items())])


def runs_of(pilot: str, heads: Sequence[str], lines: Mapping[str, tuple[str, Mapping[str, object]]]) -> Description:
    """Chosen runs of a pilot, by title: suite and options."""

    def describe(store: Store) -> Table:
        rows = []
        for title, (suite, options) in lines.items():
            found = store.summary(pilot, suite, **options)
            given = share(found.overall.pass_given_choice) if found else ""
            rows.append([title, *passed(found and found.overall), given])
        return Table([*heads, "passed", "rate", "95 % interval", "success given choice"], rows)

    return describe


KEPT = {"appearance": "photo", "place": "kept"}
"""Options of runs in the places that no model is trained in."""
LOST = ("out_of_bounds", "timeout")


def in_places(store: Store) -> Table:
    """The packaged pilots in kept places, before they were trained in others and now, and how flights end there."""
    rows = []
    for suite in ("open-v3:places", "open-v1:test"):
        for pilot in ("small", "r1"):
            for file, when in ((f"{pilot}_without_places", "before"), (pilot, "now")):
                found = store.summary(file, suite, **KEPT)
                score = found and found.overall
                ends = [_ended(score, "wrong_gate"), _ended(score, "collision"), _ended(score, *LOST)]
                rows.append([f"`{suite}`", f"`{pilot}`", when, *passed(score), *ends])
    ended = ["wrong gate", "collisions", "lost"]
    heads = ["tasks, in kept places", "pilot", "", "passed", "rate", "95 % interval", *ended]
    return Table(heads, rows)


def _ended(score: Score | None, *outcomes: str) -> str:
    return share(sum(score.outcomes.get(each, 0) for each in outcomes) / score.n) if score and score.n else ""


def categories(pilot: str, published: str) -> Description:
    """A pilot on `open-v1:test` by category, beside a published system."""

    def describe(store: Store) -> Table:
        found = store.summary(pilot, "open-v1:test")
        (theirs,) = (each for each in PUBLISHED if each.name == published)
        rows = [["overall", *passed(found and found.overall), share(theirs.overall)]]
        for category in CATEGORIES:
            ours = found.categories.get(category) if found else None
            rows.append([category.replace("_", " "), *passed(ours), share(theirs.categories[category])])
        return Table(["", "passed", "rate", "95 % interval", "the paper's, on its own tasks"], rows)

    return describe


def families(pilot: str, suites: Sequence[str]) -> Description:
    """Families down, suites across."""

    def describe(store: Store) -> Table:
        found = [store.summary(pilot, suite) for suite in suites]
        names = dict.fromkeys(name for summary in found if summary for name in summary.families)
        rows = [[name.replace("_", " "), *(_family(summary, name) for summary in found)] for name in names]
        heads = ["family: passed", *(f"`{suite}`" for suite in suites)]
        return Table(heads, rows or [["", *[NOT_MEASURED] * len(suites)]])

    return describe


def _family(summary: Summary | None, name: str) -> str:
    if summary is None:
        return NOT_MEASURED
    score = summary.families.get(name)
    return f"{score.passed} of {score.n}" if score else ""


def reasoner_worth(store: Store) -> Table:
    """R1, the policy alone, and the reasoner alone, by suite."""
    alone = {row["suite"]: row for row in store.measured_rows("reasoner_alone")}
    rows = []
    for suite in (*HELD_OUT, *OPENED_LAST, *DRAWN_ANEW, *MORE):
        r1, policy = store.summary("r1", suite), store.summary("small", suite)
        thought = f"{100 * alone[suite]['right'] / alone[suite]['n']:.1f} %" if suite in alone else NOT_MEASURED
        policy_alone = share(policy.overall.rate) if policy else NOT_MEASURED
        error = cell("{calibration_error:.1%}", alone.get(suite, {}))
        rows.append([f"`{suite}`", *passed(r1 and r1.overall), policy_alone, thought, error])
    heads = [
        "suite",
        "R1 passed",
        "rate",
        "95 % interval",
        "the policy alone",
        "the reasoner alone names the right gate",
        "calibration error of its confidences",
    ]
    return Table(heads, rows)


def false_alarms(store: Store) -> Table:
    """How often R1 and the policy alone declined although a gate was right, which in `absent` none is."""
    pilots = {"r1": "R1", "small": "the policy alone"}
    rows = []
    for suite in (*HELD_OUT, *OPENED_LAST, *DRAWN_ANEW, *MORE):
        if suite != "open-v2:absent":
            rows.append([f"`{suite}`", *(_declined(store.summary(pilot, suite)) for pilot in pilots)])
    return Table(["suite", *pilots.values()], rows)


def _declined(summary: Summary | None) -> str:
    if summary is None:
        return NOT_MEASURED
    alarms = summary.false_alarms
    return f"{alarms.alarms} of {alarms.n}" if alarms else f"0 of {summary.overall.n}"


def latencies(store: Store) -> Table:
    """R1 against its reasoner's latency."""
    points: dict[float, Score] = {}
    for run in store.runs("r1_latency"):
        store.former |= {"`r1_latency`": None} if is_former(run) else {}
        parts = dict(part.split("=") for part in str(run.run.option("latency")).split(","))
        points[float(parts["reasoner"].removesuffix("ms"))] = run.summary.overall
    heads = ["reasoner latency, ms", *(f"{ms:,.0f}" for ms in sorted(points))]
    return Table(heads, [["passed", *(rate(points[ms]) for ms in sorted(points))] if points else [NOT_MEASURED]])


def from_data(store: Store) -> Table:
    """Training runs on a fixed set of flights, and on the stream."""
    rows = []
    for pilot, flights in {**FROM_DATA, "stream": "a stream of new flights"}.items():
        found = store.summary(pilot, "open-v1:test")
        choice = share(found.overall.choice_accuracy) if found else ""
        given = share(found.overall.pass_given_choice) if found else ""
        rows.append([flights, *passed(found and found.overall), choice, given])
    return Table(["flights", "passed", "rate", "95 % interval", "choice accuracy", "success given choice"], rows)


PAPER_SYSTEMS = {"CognitiveDrone-R1": "r1", "CognitiveDrone": "small", "RaceVLA": "race"}
"""The paper's systems, and our pilots that stand for them."""


PAPER_SUITES = ("open-v1:test", "open-v2:layouts", "open-v2:pictures", "open-v1:unseen", "open-v2:words")


def paper_table(summaries: Mapping[str, Mapping[str, Summary | None]]) -> Table:
    """Three systems by three categories, ours and the published ones; summaries by the paper's names and suites."""
    heads = ["system", *(category.replace("_", " ") for category in CATEGORIES), "mean of categories"]
    rows = []
    for theirs in PUBLISHED:
        for suite, ours in summaries.get(theirs.name, {}).items():
            cells = [
                "none" if ours and category not in ours.categories else rate(ours and ours.categories[category])
                for category in CATEGORIES
            ]
            mean = ours.mean_of_categories if ours else None
            known = mean is not None and mean.rate is not None and mean.ci95 is not None
            cells.append(f"{100 * mean.rate:.1f} ({interval(mean.ci95, 0)})" if known else NOT_MEASURED)
            rows.append([f"{theirs.name}, ours on `{suite}`", *cells])
        published = [*(theirs.categories[category] for category in CATEGORIES), theirs.overall]
        rows.append([f"{theirs.name}, published", *(f"{100 * each:.1f}" for each in published)])
    return Table(heads, rows)


def paper(store: Store) -> Table:
    """The paper's table, on held-out suites as well."""
    return paper_table(
        {name: {suite: store.summary(pilot, suite) for suite in PAPER_SUITES} for name, pilot in PAPER_SYSTEMS.items()}
    )


def audits(store: Store) -> Table:
    """Rates under every change, of the packaged pilots."""
    runs = {"R1": "audit_r1", "`small`": "audit_small", "`race`": "audit_race"}
    pilots = {title: store.measured_rows(name) for title, name in runs.items()}
    variants = dict.fromkeys((row["audit"], row["variant"]) for rows in pilots.values() for row in rows)
    rows = []
    for audit, variant in variants:
        cells = [
            _audited(row for row in rows if (row["audit"], row["variant"]) == (audit, variant))
            for rows in pilots.values()
        ]
        rows.append([audit, variant, *cells])
    return Table(["audit", "variant", *pilots], rows or [[NOT_MEASURED, *[""] * (1 + len(pilots))]])


def _audited(rows: Iterator[Mapping[str, Any]]) -> str:
    row = next(rows, None)
    if row is None:
        return ""
    ci95 = wilson(row["right"], row["n"])
    text = f"{100 * row['right'] / row['n']:.1f} ({interval(ci95, 0)})" if row["n"] else "none chosen"
    if row["sound"] is None:
        return f"{text}, too few flights"
    return text if row["sound"] else f"{text}, **not as a sound pilot**"


def lessons(store: Store) -> Table:
    """A pilot before and after a lesson."""
    heads = ["pilot", "tasks", "passed", "95 % interval"]
    rows = [
        [row["who"], row["tasks"], f"{row['passed']} of {row['n']}", interval(wilson(row["passed"], row["n"]))]
        for row in store.measured_rows("teaching")
        if "n" in row
    ]
    return Table(heads, rows or [[NOT_MEASURED, *[""] * 3]])


def sitl_scores(store: Store) -> Table:
    """Flights with ArduCopter; their intervals follow from the counts."""
    heads = ["suite", "airframe", "autopilot", "passed", "95 % interval", "lost frames"]
    return Table(
        heads,
        [
            [
                *(cell(template, row) for template in ("{suite}", "{airframe}", "{autopilot}", "{passed} of {n}")),
                interval(wilson(row["passed"], row["n"])),
                cell("{lost_frames}", row),
            ]
            for row in store.measured("sitl_scores").rows
        ],
    )


def gazebo_scores(store: Store) -> Table:
    """The same tasks in Gazebo and in our simulator; their intervals follow from the counts."""

    def score(passed: int, n: int) -> list[str]:
        return [f"{passed} of {n}", interval(wilson(passed, n))]

    return Table(
        [
            *("tasks", "pilot", "passed in Gazebo", "95 % interval", "in our simulator", "95 % interval"),
            *("time of a passed task, clearance", "in our simulator", "commands late"),
        ],
        [
            [
                *(cell(template, row) for template in ("{tasks}", "{pilot}")),
                *score(row["passed"], row["n"]),
                *(score(row["ours_passed"], row["ours_n"]) if "ours_n" in row else ["", ""]),
                cell("{time_s:.2f} s, {clearance_cm} cm", row),
                cell("{ours_time_s:.2f} s, {ours_clearance_cm} cm", row),
                cell("{late} of {commands:,}", row),
            ]
            for row in store.measured("gazebo_scores").rows
        ],
    )


def leaderboard_table(store: Store) -> Table:
    """The submissions in leaderboard/, best first."""
    return Table(["pilot", "by", "policy", "reasoner", *LEADERBOARD], leaderboard(store.submissions(), LEADERBOARD))
