"""Two runs over the same tasks, paired task by task.

Sources: R. G. Newcombe, Interval estimation for the difference between paired proportions (Statistics in Medicine 17,
1998); Q. McNemar (1947), exact form.

What the records of a run say against its policy's input: answers that do not depend on image or instruction.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from cognitivedrone.benchmark.scores.results import Results, read_results
from cognitivedrone.benchmark.scores.run_types import unanswered
from cognitivedrone.benchmark.scores.scoring import Interval, counts, passes, ratio, wilson
from cognitivedrone.errors import RunError
from cognitivedrone.plan import Rule
from cognitivedrone.types import ALL_CATEGORIES, Category, StageResult

SIGNIFICANT: Final = 0.05
"""A difference less probable than this by chance is called significant."""
MACHINE: Final = {"system": "system", "machine": "architecture"}
"""What of a machine changes the last digits, by the keys of `platform` in results.json."""


@dataclass(frozen=True, slots=True)
class Paired:
    """Two runs over the same stages: how often both, one or none passed."""

    both: int
    only_a: int
    only_b: int
    neither: int

    @property
    def n(self) -> int:
        """Stages compared."""
        return self.both + self.only_a + self.only_b + self.neither

    @property
    def rate_a(self) -> float | None:
        """Share that passed in a."""
        return ratio(self.both + self.only_a, self.n)

    @property
    def rate_b(self) -> float | None:
        """Share that passed in b."""
        return ratio(self.both + self.only_b, self.n)

    @property
    def difference(self) -> float | None:
        """Rate of b minus rate of a."""
        return ratio(self.only_b - self.only_a, self.n)

    @property
    def ci95(self) -> Interval | None:
        """95 % interval of the difference; Newcombe's (1998) method 10 for paired rates."""
        n = self.n
        b, limits_b = self.both + self.only_b, wilson(self.both + self.only_b, n)
        a, limits_a = self.both + self.only_a, wilson(self.both + self.only_a, n)
        if limits_b is None or limits_a is None:
            return None
        phi, difference = _phi(self), (self.only_b - self.only_a) / n

        def spread(x: float, y: float) -> float:
            return math.sqrt(max(0.0, x * x - 2 * phi * x * y + y * y))

        return (
            difference - spread(b / n - limits_b[0], limits_a[1] - a / n),
            difference + spread(limits_b[1] - b / n, a / n - limits_a[0]),
        )

    @property
    def p(self) -> float:
        """Two-sided exact McNemar."""
        return mcnemar(self.only_a, self.only_b)


def pair(passed: Iterable[tuple[bool, bool]]) -> Paired:
    """The two-by-two table of (a passed, b passed)."""
    table = Counter(passed)
    return Paired(table[True, True], table[True, False], table[False, True], table[False, False])


def mcnemar(a: int, b: int) -> float:
    """Two-sided exact McNemar p-value of the discordant counts of a paired table; 1 if both are 0."""
    from scipy.stats import binomtest  # takes half a second to import, and workers never need it

    return float(binomtest(a, a + b, 0.5).pvalue) if a + b else 1.0


def _phi(table: Paired) -> float:
    """Correlation of the two runs' points, with the continuity correction of Newcombe's method 10."""
    product = (
        (table.both + table.only_a)
        * (table.only_b + table.neither)
        * (table.both + table.only_b)
        * (table.only_a + table.neither)
    )
    if product == 0:
        return 0.0
    determinant: float = table.both * table.neither - table.only_a * table.only_b
    if determinant > 0:
        determinant = max(determinant - table.n / 2, 0.0)
    return determinant / math.sqrt(product)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Paired comparison of two runs."""

    name_a: str
    name_b: str
    suite: str
    rule: Rule
    overall: Paired
    categories: Mapping[Category, Paired]
    left_out: int
    """Stages that are invalid in either run."""
    other_differences: tuple[str, ...]
    """Options and versions in which the runs differ, besides the pilot."""

    @property
    def frames_differ(self) -> bool:
        """Whether the drones saw slightly different frames of the same scene: of other renderers or processors."""
        return any(line.partition(":")[0] in ("renderer", *MACHINE.values()) for line in self.other_differences)

    @property
    def verdict(self) -> str:
        """The overall difference in one sentence."""
        table, p = self.overall, self.overall.p
        if table.n == 0:
            return "no task counts in both runs, so they cannot be compared"
        more = abs(table.only_b - table.only_a)
        sentence = f"{'B' if table.only_b > table.only_a else 'A'} passes {more} more of {table.n} tasks"
        if more == 0:
            sentence = f"A and B pass equally many of {table.n} tasks"
        significant = "a significant difference" if p < SIGNIFICANT else "no significant difference"
        return f"{sentence}; {significant} (McNemar, p = {p:.3g})"


def compare(a: Path, b: Path, *, rule: Rule = "through") -> Comparison:
    """Pair two finished runs, each given as its folder or its results.json.

    Raises `RunError` if they did not fly the same tasks with the same seed.
    """
    return compare_results(read_results(a), read_results(b), rule=rule, names=(str(a), str(b)))


def compare_results(
    a: Results, b: Results, *, rule: Rule = "through", names: tuple[str, str] = ("A", "B")
) -> Comparison:
    """As `compare`, for loaded results; `names` are used in error messages."""
    for what, in_a, in_b in (
        ("suite", f"{a.run.suite.name} ({a.run.suite.digest[:12]})", f"{b.run.suite.name} ({b.run.suite.digest[:12]})"),
        ("seed", a.run.option("seed"), b.run.option("seed")),
        ("track option", a.run.option("track"), b.run.option("track")),
    ):
        if in_a != in_b:
            raise RunError(f"{names[0]} and {names[1]} cannot be paired: their {what} differs, {in_a} and {in_b}")
    stages_a, stages_b = _by_task(a, names[0]), _by_task(b, names[1])
    if stages_a.keys() != stages_b.keys():
        raise RunError(
            f"{names[0]} and {names[1]} cannot be paired: {len(stages_a.keys() ^ stages_b.keys())} tasks were flown in "
            "only one of them; run both with the same --episodes"
        )
    pairs = [(stages_a[task], stages_b[task]) for task in stages_a]
    valid = [(x.category, (passes(x, rule), passes(y, rule))) for x, y in pairs if counts(x) and counts(y)]
    present = [category for category in ALL_CATEGORIES if any(own == category for own, _ in valid)]
    return Comparison(
        name_a=_pilot(a),
        name_b=_pilot(b),
        suite=a.run.suite.name,
        rule=rule,
        overall=pair(passed for _, passed in valid),
        categories={category: pair(passed for own, passed in valid if own == category) for category in present},
        left_out=len(pairs) - len(valid),
        other_differences=_other_differences(a, b),
    )


def _by_task(results: Results, name: str) -> dict[str, StageResult]:
    """The stages by task; those of flights that are not counted as invalid."""
    stages = [
        replace(stage, outcome="invalid") if unanswered(episode) else stage
        for episode in results.episodes
        for stage in episode.stages
    ]
    by_task = {stage.task_id: stage for stage in stages}
    if len(by_task) != len(stages):
        raise RunError(
            f"{name} flew {len(stages) - len(by_task)} tasks more than once, by their ids; it cannot be paired"
        )
    return by_task


def _pilot(results: Results) -> str:
    return f"policy {results.run.policy}, reasoner {results.run.reasoner}"


def _other_differences(a: Results, b: Results) -> tuple[str, ...]:
    of_a, of_b = (
        {name: run.run.option(name) for name in ("appearance", "airframe", "labels", "link", "wind_m_s", "latency")}
        | dict(run.run.versions)
        | {"renderer": run.renderer}
        | {shown: run.platform.get(key, "unknown") for key, shown in MACHINE.items()}
        for run in (a, b)
    )
    return tuple(f"{key}: {of_a[key]} and {of_b.get(key)}" for key in of_a if of_a[key] != of_b.get(key))


FEWEST = 10
"""Flights at a gate from which a preference can be inferred."""
ALWAYS = 0.95
"""Share of the flights at one gate that cannot be what the instructions asked for."""
ASKED = 0.6
"""Largest share of the tasks in which one gate may be right, to tell."""
_WAY_OUT = "cognitivedrone doctor --policy ... examines what reaches it"


def suspicions(results: Results) -> Iterator[str]:
    """Sentences about a policy that seems not to see or not to read."""
    episodes = [episode for episode in results.episodes if episode.steps > 0]
    repeated = [episode.repeated for episode in episodes if episode.repeated is not None]
    if episodes and len(repeated) == len(episodes):
        if len(set(repeated)) == 1:
            shown = ", ".join(f"{value:.4g}" for value in repeated[0])
            yield f"the policy gave the same answer ({shown}) for all images and sentences, in every flight; {_WAY_OUT}"
        else:
            yield f"the policy gave the same answer throughout each flight, whatever it saw on the way; {_WAY_OUT}"
    table = results.summary().choices
    flown = [sum(row[gate] for row in table) for gate in range(3)]
    right = [sum(row) for row in table]
    gate = max(range(3), key=lambda each: flown[each])
    if sum(flown) >= FEWEST and flown[gate] >= ALWAYS * sum(flown) and max(right) <= ASKED * sum(right):
        yield (
            f"{flown[gate]} of {sum(flown)} flights went to gate {gate + 1}, which {right[gate]} of {sum(right)} tasks"
            f" asked for: the pilot seems not to follow the instruction; {_WAY_OUT}"
        )
