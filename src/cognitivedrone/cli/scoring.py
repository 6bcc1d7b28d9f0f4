"""Commands that score pilots: bench, merge, reason, sweep, compare, view, list."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import OmitArgPrefixes as Flat

from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.benchmark.config import Plan, ReasonPlan, SweepPlan
from cognitivedrone.plan import Options, Scenario
from cognitivedrone.printable import visible


def bench(plan: Annotated[Flat[Plan], tyro.conf.arg(name="")]) -> None:
    """Fly a policy through a suite of tasks and score it: without arguments, the small VLA through the test suite.

    Writes results.json, one record per episode, and a self-contained report.html. A stopped run continues with
    --resume. Exit code 1 if every episode ended in an error of the policy. Examples:

      cognitivedrone bench
      cognitivedrone bench --suite open-v1:smoke --policy colour_seeker --reasoner oracle
      cognitivedrone bench --policy my_package.my_module:MyPolicy --suite open-v1:test
      cognitivedrone bench --tasks my_tasks.json --labels my_pictures/
    """
    from cognitivedrone.benchmark.runner import out_of, run
    from cognitivedrone.benchmark.tables import results_table
    from cognitivedrone.tasks.scenario import how_many
    from cognitivedrone.terminal import console

    screen = console()
    if notice := how_many(plan.scenario, plan.episodes):
        screen.print(notice)
    results = run(plan, progress=True)
    screen.print(results_table(results))
    screen.print(f"report: {out_of(plan) / 'report.html'}")
    if plan.shard is not None:
        screen.print(f"This is shard {plan.shard} alone; 'cognitivedrone merge' joins the folders of all shards.")
    if results.policy_failure:
        raise SystemExit(1)


def merge(
    parts: tyro.conf.Positional[tuple[Path, ...]],
    out: Path,
    overwrite: bool = False,
) -> None:
    """Join the folders that bench --shard wrote into one run, equal to a run that was never divided.

    Checks that they are all shards of the same run, and that none is missing or given twice. Example:

      cognitivedrone merge results/part-* --out results/whole

    Args:
        parts: Folders of all shards of a run.
        out: Folder for the whole run.
        overwrite: Delete the run in that folder.
    """
    from cognitivedrone.benchmark.merge import merge as merge_shards
    from cognitivedrone.benchmark.report import REPORT_FILE
    from cognitivedrone.benchmark.tables import results_table
    from cognitivedrone.terminal import console

    screen = console()
    screen.print(results_table(merge_shards(parts, out, overwrite=overwrite)))
    screen.print(f"report: {out / REPORT_FILE}")


def reason(plan: Annotated[Flat[ReasonPlan], tyro.conf.arg(name="")]) -> None:
    """Score a reasoner alone, on the first frame of every flight, without flying.

    Writes reason.json and reason.jsonl, which `--reasoner replay:FOLDER/reason.jsonl` reads. Examples:

      cognitivedrone reason --suite open-v1:test --reasoner noisy-oracle
      cognitivedrone reason --suite open-v1:track --reasoner my_module:MyReasoner --out answers
    """
    from cognitivedrone.benchmark.reason import ANSWERS_FILE, score_reasoner
    from cognitivedrone.benchmark.reason_table import reason_table
    from cognitivedrone.terminal import console

    screen = console()
    results = score_reasoner(plan)
    screen.print(reason_table(results))
    screen.print(f"answers: {results.out / ANSWERS_FILE}")


def sweep(plan: Annotated[Flat[SweepPlan], tyro.conf.arg(name="")]) -> None:
    """Fly a suite at increasing latency of the reasoner or the policy, and plot the success rate.

    Latency is charged to the simulated clock, so the result does not depend on the machine. A stopped sweep continues
    when it is started again. Example:

      cognitivedrone sweep --policy small --reasoner oracle --ms 0 500 2000 --out results/sweep
    """
    from cognitivedrone.benchmark.sweep import PLOT_FILE
    from cognitivedrone.benchmark.sweep import sweep as fly_all
    from cognitivedrone.benchmark.tables import sweep_table
    from cognitivedrone.terminal import console

    screen = console()
    screen.print(sweep_table(fly_all(plan), plan.part))
    screen.print(f"plot: {plan.out / PLOT_FILE}")


def audit(plan: Annotated[Flat[AuditPlan], tyro.conf.arg(name="")]) -> None:
    """Fly a pilot again and again with one thing changed, to see why it passes a benchmark.

    No question or a meaningless one, another question about the same scene, panels or the gates' appearance swapped, a
    mirrored stage, paraphrases, gates moved, light, wind, a shifted or turned camera, latency. All audits are 35 runs
    of up to --episodes flights each, 3,500 by default; fewer than 30 flights are too few to tell. Writes audit.json
    and audit.html; a stopped audit continues when it is started again. Examples:

      cognitivedrone audit --policy small --reasoner small
      cognitivedrone audit --policy my_module:MyPolicy --episodes 50 --only "no question" wind
    """
    from cognitivedrone.audit.report import PAGE_FILE, audit_table, render_audit
    from cognitivedrone.audit.run import audit as fly_all
    from cognitivedrone.audit.run import folder_of
    from cognitivedrone.benchmark.results import write_whole
    from cognitivedrone.terminal import console

    screen, page = console(), folder_of(plan) / PAGE_FILE
    rows = fly_all(plan)
    write_whole(page, render_audit(plan, rows))
    screen.print(audit_table(plan, rows))
    screen.print(f"page: {page}")


def compare(
    a: tyro.conf.Positional[Path],
    b: tyro.conf.Positional[Path],
) -> None:
    """Compare two runs of the same suite and seed, task by task (McNemar's test).

    Args:
        a: Folder or results.json of the first run.
        b: Folder or results.json of the second run.
    """
    from cognitivedrone.benchmark.comparison import compare as compare_runs
    from cognitivedrone.benchmark.tables import comparison_table
    from cognitivedrone.terminal import console

    console().print(comparison_table(compare_runs(a, b)))


def submit(
    runs: tyro.conf.Positional[tuple[Path, ...]],
    name: str,
    by: str,
    out: Path,
    url: str = "",
) -> None:
    """Make a file for the leaderboard from finished runs of one pilot, one for each suite or set of options.

    A stopped or partial run is refused. Examples:

      cognitivedrone submit results/test results/words --name "My VLA" --by "My lab" --out leaderboard/my-vla.json

    Args:
        runs: Folders or results.json of whole runs of shipped suites, without --labels.
        name: Of the pilot, as the leaderboard shows it.
        by: Who submits it.
        out: File to write.
        url: Where to read about the pilot.
    """
    from cognitivedrone.benchmark.submission import submission_of, write_submission

    submission = submission_of(runs, name, by, url)
    write_submission(out, submission)
    for run in submission.runs:
        print(visible(f"{run.run.suite.name}: {run.overall.passed} of {run.overall.n} passed"))  # noqa: T201
    print(visible(f"{out}: check it with `cognitivedrone verify {out}`"))  # noqa: T201


def verify(file: tyro.conf.Positional[Path], sample: int = 20, seed: int = 0) -> None:
    """Check a leaderboard file, and fly a random sample of every run again, in this process.

    Scores that do not follow from the flights, other tasks, other weights, and other code of the user's own are errors.
    Exit code 1 if a sample passes less often than submitted, beyond chance, or is too small to tell.

    Args:
        file: A file made by `submit`.
        sample: Episodes of each run to fly.
        seed: Which episodes.
    """
    from cognitivedrone.benchmark.submission import read_submission
    from cognitivedrone.benchmark.submission import verify as fly_sample

    checked = fly_sample(read_submission(file), sample, seed)
    few = f"the sample has too few passes to judge the score; give more than --sample {sample}"
    for run in checked:
        said = {
            "confirmed": "confirmed" if run.telling else f"not refuted, but {few}",
            "refuted": "NOT confirmed",
            "undecided": f"undecided: {few}",
        }
        print(  # noqa: T201
            visible(
                f"{run.suite}: {run.equal} of {run.flown} stages ended as submitted; {run.passed} passed, "
                f"{run.submitted} submitted as passed: {said[run.verdict]}"
            )
        )
        if run.differences:
            print(visible(f"  other versions here: {', '.join(run.differences)}"))  # noqa: T201
    if any(run.verdict != "confirmed" for run in checked):
        raise SystemExit(1)


@dataclass(frozen=True, slots=True)
class ViewPlan(Options):
    """Draw what the drone sees at the start of a task."""

    scenario: Scenario = Scenario(suite="open-v1:smoke")
    episode: int = 0
    """Task of the suite, from 0."""
    out: Path = Path("view.png")
    """Picture to write."""


def view(plan: Annotated[Flat[ViewPlan], tyro.conf.arg(name="")]) -> None:
    """Draw what the drone sees at the start of a task, with a chase view and a top view."""
    from cognitivedrone.envs.captions import readable
    from cognitivedrone.envs.snapshot import snapshot
    from cognitivedrone.tasks.scenario import suite_of

    suite = suite_of(plan.scenario, plan.episode + 1)
    task = snapshot(suite, plan.episode, plan.out, plan.scenario)
    right = "(right: no gate)"
    if task.target is not None:
        right = f"(right: gate {task.target + 1}, {readable(task.options[task.target])})"
    print(visible(f"{plan.out}: {task.instruction}  {right}"))  # noqa: T201


def list_names() -> None:
    """List suites, task families, airframes, and policies and reasoners with their arguments."""
    from cognitivedrone.benchmark.catalogue import catalogue
    from cognitivedrone.terminal import console

    console().print(catalogue())
