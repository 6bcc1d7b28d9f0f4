"""Commands that score pilots: bench, merge, reason, sweep, compare, view, list."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import OmitArgPrefixes as Flat

from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.benchmark.config import Plan, PredictPlan, ReasonPlan, SweepPlan
from cognitivedrone.plan import Options, Scenario
from cognitivedrone.ranges import Count, Index, Seed
from cognitivedrone.text.printable import visible


def bench(plan: Annotated[Flat[Plan], tyro.conf.arg(name="")]) -> None:
    """Fly a policy through a suite of tasks and score it: without arguments, the small VLA through the test suite.

    Writes results.json, one record per episode, and a self-contained report.html. A stopped run continues with
    --resume. Exit code 1 if every episode ended in an error of the policy, or the reasoner's server
    did not answer 5 % of the questions. Examples:

      cognitivedrone bench
      cognitivedrone bench --suite open-v1:smoke --policy colour_seeker --reasoner oracle
      cognitivedrone bench --policy my_package.my_module:MyPolicy --suite open-v1:test
      cognitivedrone bench --tasks my_tasks.json --labels my_pictures/
    """
    from cognitivedrone.benchmark.reports.tables import results_table
    from cognitivedrone.benchmark.runs.runner import out_of, run
    from cognitivedrone.tasks.suites import how_many
    from cognitivedrone.terminal import console

    screen = console()
    if notice := how_many(plan.scenario, plan.episodes):
        screen.print(notice)
    results = run(plan, progress=True)
    screen.print(results_table(results))
    screen.print(f"report: {out_of(plan) / 'report.html'}")
    if plan.shard is not None:
        screen.print(f"This is shard {plan.shard} alone; 'cognitivedrone merge' joins the folders of all shards.")
    if results.policy_failure or results.not_measured:
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
    from cognitivedrone.benchmark.reports.report import REPORT_FILE
    from cognitivedrone.benchmark.reports.tables import results_table
    from cognitivedrone.benchmark.runs.merge import merge as merge_shards
    from cognitivedrone.terminal import console

    screen = console()
    screen.print(results_table(merge_shards(parts, out, overwrite=overwrite)))
    screen.print(f"report: {out / REPORT_FILE}")


def reason(plan: Annotated[Flat[ReasonPlan], tyro.conf.arg(name="")]) -> None:
    """Score a reasoner alone, on the first frame of every flight, simulated or recorded, without flying.

    Writes reason.json and reason.jsonl, which `--reasoner replay:FOLDER/reason.jsonl` reads. Examples:

      cognitivedrone reason --suite open-v1:test --reasoner noisy-oracle
      cognitivedrone reason --suite open-v1:track --reasoner my_module:MyReasoner --out answers
      cognitivedrone reason --flights docker_CognitiveDrone_DataCollector/Validation --reasoner small
    """
    from cognitivedrone.benchmark.reasoning.reason import ANSWERS_FILE, score_reasoner
    from cognitivedrone.benchmark.reasoning.reason_table import reason_table
    from cognitivedrone.terminal import console

    screen = console()
    results = score_reasoner(plan)
    screen.print(reason_table(results))
    screen.print(f"answers: {results.out / ANSWERS_FILE}")
    if results.not_measured:
        raise SystemExit(1)


def predict(plan: Annotated[Flat[PredictPlan], tyro.conf.arg(name="")]) -> None:
    """Ask a policy about recorded flights without flying: L1 error, accuracy and cross-entropy of its actions.

    The paper's three training curves, overall and by category. Examples:

      cognitivedrone predict --flights data/paper --split val --policy small
      cognitivedrone predict --flights docker_CognitiveDrone_DataCollector/Validation --policy openvla:checkpoint
    """
    from cognitivedrone.benchmark.open_loop import out_of, predict_table
    from cognitivedrone.benchmark.open_loop import predict as ask
    from cognitivedrone.terminal import console

    screen = console()
    screen.print(predict_table(plan, ask(plan)))
    screen.print(f"scores: {out_of(plan)}")


def sweep(plan: Annotated[Flat[SweepPlan], tyro.conf.arg(name="")]) -> None:
    """Fly a suite at increasing latency of the reasoner or the policy, and plot the success rate.

    Latency is charged to the simulated clock, so the result does not depend on the machine. A stopped sweep continues
    when it is started again. Example:

      cognitivedrone sweep --policy small --reasoner oracle --ms 0 500 2000 --out results/sweep
    """
    from cognitivedrone.benchmark.reports.tables import sweep_table
    from cognitivedrone.benchmark.runs.sweep import PLOT_FILE
    from cognitivedrone.benchmark.runs.sweep import sweep as fly_all
    from cognitivedrone.terminal import console

    screen = console()
    screen.print(sweep_table(fly_all(plan), plan.part))
    screen.print(f"plot: {plan.out / PLOT_FILE}")


def doctor(policy: str = "small", seed: Seed = 0) -> None:
    """Examine a policy: ask it about views whose right commands are known, and say in a sentence each what is wrong.

    Whether it looks at the image and follows the instruction, the order and range of images, exchanged colour channels,
    the order and signs of state and commands, their scale, chunks, latency, determinism and memory. Takes about a
    thousand calls of the policy. Exit code 1 if anything is wrong. Examples:

      cognitivedrone doctor --policy small
      cognitivedrone doctor --policy my_module:MyPolicy:weights.pt
      cognitivedrone doctor --policy remote:ws://127.0.0.1:8000

    Args:
        policy: Policy, as in bench: a name, or your own as module:attribute.
        seed: Of the views.
    """
    from cognitivedrone.doctor.report import examined

    if examined(policy, seed):
        raise SystemExit(1)


def audit(plan: Annotated[Flat[AuditPlan], tyro.conf.arg(name="")]) -> None:
    """Fly a pilot again and again with one thing changed, to see why it passes a benchmark.

    No question or a meaningless one, another question about the same scene, panels, the gates' appearance or the order
    of a mission swapped, a mirrored stage, paraphrases, gates moved, photographed places, light, wind, a shifted or
    turned camera, latency.
    All audits are 39 runs of up to --episodes flights each, 3,900 by default; fewer than 30 flights are too few to
    tell. Writes audit.json and audit.html; a stopped audit continues when it is started again. Examples:

      cognitivedrone audit --policy small --reasoner small
      cognitivedrone audit --policy my_module:MyPolicy --episodes 50 --only "no question" wind
    """
    from cognitivedrone.audit.run import PAGE_FILE, audit_table, folder_of, render_audit
    from cognitivedrone.audit.run import audit as fly_all
    from cognitivedrone.benchmark.scores.results import write_whole
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
    from cognitivedrone.benchmark.reports.tables import comparison_table
    from cognitivedrone.benchmark.scores.comparison import compare as compare_runs
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


def verify(
    file: tyro.conf.Positional[Path],
    sample: Count = 20,
    seed: Seed | None = None,
    policy: str | None = None,
    reasoner: str | None = None,
) -> None:
    """Check a leaderboard file, and fly a random sample of every run again, in this process.

    Scores that do not follow from the flights, other tasks, other weights, and other code of the user's own are errors.
    Nothing that a file names is run or opened but what is part of the package: name anything else yourself. Exit code 1
    if flights end otherwise than submitted, beyond chance, or the sample is too small to tell. Examples:

      cognitivedrone verify leaderboard/small.json
      PYTHONPATH=folder cognitivedrone verify leaderboard/my-vla.json --policy my_module:MyPolicy

    Args:
        file: A file made by `submit`.
        sample: Episodes of each run to fly.
        seed: Which episodes: a number that was printed, to repeat that sample. Drawn anew by default, so that nobody
            knows the sample beforehand.
        policy: The submission's policy as you have it, code that you trust: in place of the file's name.
        reasoner: Its reasoner, likewise.
    """
    from cognitivedrone.benchmark.submission import SURE, draw_seed, read_submission
    from cognitivedrone.benchmark.submission import verify as fly_sample

    submission = read_submission(file)
    drawn = draw_seed() if seed is None else seed
    print(visible(f"sample: --seed {drawn}"), flush=True)  # noqa: T201
    checked = fly_sample(submission, sample, drawn, policy=policy, reasoner=reasoner)
    for run in checked:
        verdicts = {
            "confirmed": "confirmed",
            "refuted": "NOT confirmed",
            "undecided": f"undecided: give more than --sample {run.flown}",
        }
        lines = [
            f"{run.suite}: {run.equal} of {run.flown} flights ended as submitted; {run.passed} stages passed, "
            f"{run.submitted} submitted as passed: {verdicts[run.verdict]}"
        ]
        if run.valid:
            lines.append(f"{run.valid} stages that were submitted as invalid are valid")
        if not run.repeats:
            lines.append("the pilot does not repeat its own flights, so only passes are compared (McNemar's test)")
        elif run.finds is not None and run.verdict == "confirmed":
            lines.append(
                f"{run.finds} or more false flights among the {run.size} would not have been confirmed, with a"
                f" probability of {100 * SURE:.0f} %"
            )
        if run.differences:
            lines.append(f"other versions here: {', '.join(run.differences)}")
        if run.equal < run.flown and run.repeats:
            lines.append("on another renderer or processor the last digits of frames differ: what counts is outcomes")
        print("\n  ".join(map(visible, lines)))  # noqa: T201
    if any(run.verdict != "confirmed" for run in checked):
        raise SystemExit(1)


@dataclass(frozen=True, slots=True)
class ViewPlan(Options):
    """Draw what the drone sees at the start of a task."""

    scenario: Scenario = Scenario(suite="open-v1:smoke")
    episode: Index = 0
    """Task of the suite, from 0."""
    out: Path = Path("view.png")
    """Picture to write."""


def film(
    run: tyro.conf.Positional[Path],
    episode: Index = 0,
    policy: str | None = None,
    reasoner: str | None = None,
    tasks: Path | None = None,
    labels: Path | None = None,
    out: Path | None = None,
) -> None:
    """Film an episode of a run: flies it again, and writes flight.mp4 and a page for it, flight.html.

    The film shows the drone's view and one from behind, a map, instruction, directive, command and outcome. Example:

      cognitivedrone film results/open-v1-test-small-none --episode 3

    Args:
        run: Folder of a finished run.
        episode: Episode of the run, from 0.
        policy: Policy, if the run flew your own: module:attribute.
        reasoner: Reasoner, if the run flew your own.
        tasks: Task file or folder, if the run flew one.
        labels: Folder of pictures, if the run showed one.
        out: Folder for the film; films/EPISODE in the run's folder by default.
    """
    from cognitivedrone.benchmark.runs.film import film_episode
    from cognitivedrone.terminal import console

    screen = console()
    with console(stderr=True).status("flying and filming"):
        done = film_episode(run, episode, policy=policy, reasoner=reasoner, tasks=tasks, labels=labels, out=out)
    screen.print(f"{done.headline}: {done.page}")
    if not done.repeats:
        screen.print("this flight ended differently from the recorded one: the pilot does not repeat itself")


def view(plan: Annotated[Flat[ViewPlan], tyro.conf.arg(name="")]) -> None:
    """Draw what the drone sees at the start of a task, with a chase view and a top view."""
    from cognitivedrone.envs.captions import readable
    from cognitivedrone.envs.snapshot import snapshot
    from cognitivedrone.tasks.suites import suite_of

    suite = suite_of(plan.scenario, plan.episode + 1)
    task = snapshot(suite, plan.episode, plan.out, plan.scenario)
    right = "(right: no gate)"
    if task.target is not None:
        right = f"(right: gate {task.target + 1}, {readable(task.options[task.target])})"
    print(visible(f"{plan.out}: {task.instruction}  {right}"))  # noqa: T201


def list_names() -> None:
    """List suites, task families, airframes, and policies and reasoners with their arguments; and what draws here."""
    from cognitivedrone.sim.drawing.gl import look_ahead

    look_ahead()
    from cognitivedrone.benchmark.reports.catalogue import catalogue
    from cognitivedrone.terminal import console

    console().print(catalogue())
