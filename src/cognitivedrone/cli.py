"""The `cognitivedrone` command."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from cognitivedrone.benchmark.run_types import RunConfig
from cognitivedrone.errors import CognitiveDroneError

app = tyro.extras.SubcommandApp()


@app.command
def bench(config: Annotated[RunConfig, tyro.conf.arg(name="")]) -> None:
    """Fly a policy through a suite of tasks and score it.

    Writes results.json, one record per episode, and a self-contained report.html. A run that was stopped goes on with
    --resume. Examples:

      cognitivedrone bench --suite open-v1:smoke --policy colour_seeker --reasoner oracle
      cognitivedrone bench --policy my_package.my_module:MyPolicy --suite open-v1:test
      cognitivedrone bench --tasks my_tasks.json --labels my_pictures/
    """
    from cognitivedrone.benchmark.runner import out_of, run
    from cognitivedrone.benchmark.tables import results_table

    console = Console()
    console.print(results_table(run(config, progress=True)))
    console.print(f"report: {out_of(config) / 'report.html'}", highlight=False)


@app.command
def compare(
    a: tyro.conf.Positional[Path],
    b: tyro.conf.Positional[Path],
) -> None:
    """Compare two runs of the same suite and seed, task by task (McNemar's test).

    Args:
        a: Folder or results.json of the first run.
        b: Folder or results.json of the second run.
    """
    from cognitivedrone.benchmark.compare import compare as compare_runs
    from cognitivedrone.benchmark.tables import comparison_table

    Console().print(comparison_table(compare_runs(a, b)))


@app.command
def view(
    suite: str = "open-v1:smoke",
    episode: int = 0,
    out: Path = Path("view.png"),
    look: str = "plain",
    labels: str = "open-v1",
    seed: int = 0,
) -> None:
    """Draw what the drone sees at the start of a task, with a chase and a top view beside it.

    Args:
        suite: Name of the suite, or a task file.
        episode: Which of its tasks, from 0.
        out: Picture to write.
        look: plain or varied.
        labels: Label pack, or a folder of pictures.
        seed: Draws start and look.
    """
    from cognitivedrone.benchmark.suites import open_suite
    from cognitivedrone.envs.snapshot import snapshot

    task = snapshot(open_suite(suite), episode, out, look=look, labels=labels, seed=seed)
    print(f"{out}: {task.instruction}  (right: gate {task.target + 1}, {task.options[task.target]})")  # noqa: T201


@app.command(name="list")
def list_names() -> None:
    """List the suites, task families, policies and reasoners that come with the package."""
    from cognitivedrone.benchmark.catalogue import catalogue

    Console().print(catalogue())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; a mistake of the user's ends in one sentence and exit code 2."""
    try:
        app.cli(prog="cognitivedrone", description=__doc__, args=arguments)
    except CognitiveDroneError as error:
        print(f"cognitivedrone: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(2)
    except KeyboardInterrupt as stop:
        print(f"cognitivedrone: {stop or 'stopped'}", file=sys.stderr)  # noqa: T201
        sys.exit(130)


if __name__ == "__main__":
    main()
