"""Commands for data sets: collect, and those of `data`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import OmitArgPrefixes as Flat

from cognitivedrone.collect.config import CollectPlan
from cognitivedrone.ranges import Index
from cognitivedrone.text.printable import visible


def collect(config: Annotated[Flat[CollectPlan], tyro.conf.arg(name="")]) -> None:
    """Collect a data set: the expert flies the tasks of a suite, frames and actions go into a store.

    Continue a stopped run with --resume. With --policy, the policy flies and the expert labels every step with its own
    command (DAgger). Examples:

      cognitivedrone collect --out data/paper
      cognitivedrone collect --recipe robust --episodes 500 --out data/robust
      cognitivedrone collect --policy small:runs/a/model.onnx --beta 0.3 --episodes 500 --out data/dagger
    """
    from cognitivedrone.collect.collector import collect as collect_set
    from cognitivedrone.terminal import console

    report = collect_set(config, progress=True)
    dropped = ", ".join(f"{outcome} {count}" for outcome, count in sorted(report.dropped.items())) or "none"
    console().print(
        f"{report.episodes} episodes in {report.out}; this run flew {report.flown} in {report.seconds:.1f} s"
        f" ({report.episodes_per_s:.1f} episodes/s), {report.success_rate:.2%} of its flights passed,"
        f" dropped: {dropped}",
        highlight=False,
    )


def show(folder: tyro.conf.Positional[Path]) -> None:
    """Print counts by family, lengths and action histograms of a data set.

    Args:
        folder: The data set.
    """
    from cognitivedrone.data.overview import summary
    from cognitivedrone.terminal import console

    console().print(summary(folder))


def report_card(folder: tyro.conf.Positional[Path], out: Path = Path("card.html")) -> None:
    """Write a self-contained HTML card of a data set: film strips, actions, splits, statistics.

    Args:
        folder: The data set.
        out: Page to write, in the current folder by default: a data set's own folder holds no other files.
    """
    from cognitivedrone.data.card import card

    card(folder, out)
    print(visible(f"report: {out.resolve()}"))  # noqa: T201


def verify(folder: tyro.conf.Positional[Path]) -> None:
    """Check every shard of a data set against its hash; exit code 1 if anything is missing, truncated or altered.

    Args:
        folder: The data set.
    """
    from cognitivedrone.data.verify import verify as problems_of

    problems = problems_of(folder)
    for problem in problems:
        print(visible(str(problem)))  # noqa: T201
    if problems:
        again = "collect it again with --resume and the settings it was made with; an import is imported again"
        print(f"{folder}: {len(problems)} problems; to repair them, {again}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    print(visible(f"{folder}: intact"))  # noqa: T201


def export(folder: tyro.conf.Positional[Path], to: str, out: Path) -> None:
    """Export a data set to a format for trainers.

    Args:
        folder: The data set.
        to: A format, such as rlds, lerobot or mcap (docs/data.md lists all), or your own as module:attribute.
        out: New folder to write.
    """
    from cognitivedrone.data.formats import FRONT_ONLY
    from cognitivedrone.data.formats import export as export_set
    from cognitivedrone.data.store import Store
    from cognitivedrone.terminal.progress import counted

    store = Store.open(folder)
    count = export_set(counted(store.labelled(), "exporting", len(store)), to, out)
    print(visible(f"{out}: {count} episodes as {to}"))  # noqa: T201
    if to in FRONT_ONLY and store.down_camera:
        print(f"frames of the camera that looks down are left out: {to} has no place for them")  # noqa: T201


def import_(
    source: tyro.conf.Positional[Path],
    form: Annotated[str, tyro.conf.arg(name="from")],
    out: Path,
    columns: str = "",
) -> None:
    """Import a data set of another format into a new store.

    Args:
        source: The data set to read.
        form: A format, such as rlds, lerobot or published, or your own as module:attribute.
        out: New folder for the store.
        columns: With rlds or lerobot data of others: which numbers of a step are vx, vy, vz, yaw rate, and velocity,
            height, yaw rate, such as 'action=0+1+2+5 state=0+1+2+3+4'.
    """
    from cognitivedrone.collect.replay import import_set

    print(visible(f"{out}: {import_set(source, form, out, columns)} episodes"))  # noqa: T201
    if form == "published":
        from cognitivedrone.data.formats.published import agreement

        print(visible(agreement(source)))  # noqa: T201


def replay(folder: tyro.conf.Positional[Path], episode: tyro.conf.Positional[Index]) -> None:
    """Fly the recorded commands of an episode again and print the distance from the recorded end.

    Args:
        folder: The data set.
        episode: Index of the episode.
    """
    from cognitivedrone.collect.replay import replay as fly_again
    from cognitivedrone.data.store import Store

    report = fly_again(Store.open(folder).episode(episode))
    same = "the same bits" if report.same_bits else f"up to {report.path_error_m:.4f} m off on the way"
    print(f"episode {episode}: {report.steps} steps, ends {report.end_error_m:.4f} m off its record, {same}")  # noqa: T201
