"""The `cognitivedrone` command."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import track

from cognitivedrone.benchmark.reason import ReasonConfig
from cognitivedrone.benchmark.run_types import RunConfig
from cognitivedrone.benchmark.sweep import SweepConfig
from cognitivedrone.cockpit.config import FlyConfig, SimConfig
from cognitivedrone.collect.collector import CollectConfig
from cognitivedrone.errors import CognitiveDroneError, MissingExtra

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
def reason(config: Annotated[ReasonConfig, tyro.conf.arg(name="")]) -> None:
    """Score a reasoner alone: ask it about the frame that every flight begins with, and fly nothing.

    Writes reason.json and reason.jsonl, which `--reasoner replay:FOLDER/reason.jsonl` reads. Examples:

      cognitivedrone reason --suite open-v1:test --reasoner noisy-oracle
      cognitivedrone reason --suite open-v1:track --reasoner my_module:MyReasoner --out answers
    """
    from cognitivedrone.benchmark.reason import ANSWERS_FILE, score_reasoner
    from cognitivedrone.benchmark.reason_table import reason_table

    console = Console()
    results = score_reasoner(config)
    console.print(reason_table(results))
    console.print(f"answers: {results.out / ANSWERS_FILE}", highlight=False)


@app.command
def sweep(config: Annotated[SweepConfig, tyro.conf.arg(name="")]) -> None:
    """Fly a suite with growing latency of the reasoner, or of the policy, and plot the success against it.

    Latency is charged to the simulated clock, so the result does not depend on the machine. Stopped and started again,
    it goes on. Example:

      cognitivedrone sweep --policy colour_seeker --reasoner oracle --ms 0 500 2000 --out results/sweep
    """
    from cognitivedrone.benchmark.sweep import PLOT_FILE
    from cognitivedrone.benchmark.sweep import sweep as fly_all
    from cognitivedrone.benchmark.tables import sweep_table

    console = Console()
    console.print(sweep_table(fly_all(config), config.part))
    console.print(f"plot: {config.out / PLOT_FILE}", highlight=False)


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


@app.command
def collect(config: Annotated[CollectConfig, tyro.conf.arg(name="")]) -> None:
    """Collect a data set: the expert flies the tasks of a suite, frames and actions go into a store.

    A run that was stopped goes on with --resume. Examples:

      cognitivedrone collect --out data/paper
      cognitivedrone collect --recipe robust --episodes 500 --out data/robust
    """
    from cognitivedrone.collect.collector import collect as collect_set

    report = collect_set(config, progress=True)
    dropped = ", ".join(f"{outcome} {count}" for outcome, count in sorted(report.dropped.items())) or "none"
    Console().print(
        f"{report.episodes} episodes in {report.out}; this run flew {report.flown} in {report.seconds:.1f} s"
        f" ({report.episodes_per_s:.1f} episodes/s), {report.success_rate:.2%} of its flights passed,"
        f" dropped: {dropped}",
        highlight=False,
    )


@app.command
def train(
    out: Path,
    recipe: str = "small",
    data: Path | None = None,
    start: Path | None = None,
    seed: int = 0,
    resume: bool = False,
    processes: int = 1,
    threads: int = 1,
) -> None:
    """Train a small model, from flights made while it trains or from a data set, and write it as one ONNX file.

    Needs the extra `train`. A training that was stopped goes on with --resume. Examples:

      cognitivedrone train --recipe small --out runs/small --processes 2
      cognitivedrone train --recipe small --out runs/recorded --processes 2 --data flights
      cognitivedrone bench --policy small:runs/small/model.onnx
      cognitivedrone train --recipe reader --start runs/small/checkpoint.safetensors --out runs/reasoner-eyes

    Args:
        out: Folder of the run: checkpoint, curves.png, TensorBoard logs and, at the end, model.onnx.
        recipe: small, race, base or debug; reader or mind, the two parts of the small reasoner.
        data: A data set made by `collect`, to learn from it instead of from flights made on the way.
        start: For the reader: checkpoint of a policy, whose sight it starts from.
        seed: Of everything random.
        resume: Go on from the checkpoint in the folder.
        processes: Processes that share each batch: the number of CPU cores, or of GPUs.
        threads: CPU threads of each process's network.
    """
    try:
        from cognitivedrone.training.launch import TrainOptions, run
    except ModuleNotFoundError as error:
        raise MissingExtra(str(error.name), "train") from None
    model = run(TrainOptions(out, recipe, data, start, seed, resume, processes, threads))
    hint = f"; fly it with --policy small:{model}" if model.name == "model.onnx" else ""
    print(f"{model}{hint}")  # noqa: T201


@app.command
def train_openvla(
    base: Path,
    data: Path,
    out: Path,
    recipe: str = "paper",
    seed: int = 0,
    resume: bool = False,
    micro_batch: int | None = None,
    shard: bool = False,
    key: str = "cognitivedrone",
    merge: bool = False,
) -> None:
    """Fine-tune OpenVLA-7B on a data set by low-rank adapters, and merge them into a checkpoint that can be flown.

    Needs the extras `openvla` and `train`, and peft. On several GPUs, start it by torchrun. Examples:

      cognitivedrone train-openvla --base openvla-7b --data flights --out out/7b
      torchrun --nproc-per-node 8 -m cognitivedrone.cli train-openvla --base openvla-7b --data flights --out out/7b
      cognitivedrone bench --policy openvla:out/7b/merged

    Args:
        base: Folder of the checkpoint to start from: config.json, tokenizer.json, *.safetensors.
        data: A data set made by `collect` or `data import`.
        out: Folder of the run: checkpoint, metrics.jsonl, curves.png, TensorBoard logs and, at the end, merged/.
        recipe: paper, race or debug.
        seed: Of everything random.
        resume: Go on from the checkpoint in the folder.
        micro_batch: Samples at once on each GPU, 8 by default: fewer take less memory.
        shard: Spread the weights over the GPUs instead of copying them to each.
        key: Name of the action statistics in the checkpoint.
        merge: Train no further, merge what the folder's checkpoint has.
    """
    from dataclasses import replace

    from cognitivedrone.training.openvla_recipes import find_lora_recipe

    chosen = find_lora_recipe(recipe)
    if micro_batch is not None:
        chosen = replace(chosen, micro_batch=micro_batch)
    try:
        from cognitivedrone.training import openvla_lora
    except ModuleNotFoundError as error:
        raise MissingExtra(str(error.name), "openvla,train") from None
    config = openvla_lora.FineTuning(base, data, out, chosen, seed, resume, shard, key)
    merged = openvla_lora.merge(config) if merge else openvla_lora.fine_tune(config)
    print(f"{merged}; fly it with --policy openvla:{merged}")  # noqa: T201


data = tyro.extras.SubcommandApp()
app.command(data, name="data", help="Look at, check, convert and replay data sets.")


@data.command
def show(folder: tyro.conf.Positional[Path]) -> None:
    """Print counts by family, lengths and action histograms of a data set.

    Args:
        folder: The data set.
    """
    from cognitivedrone.data.summary import summary

    Console().print(summary(folder))


@data.command(name="report")
def report_card(folder: tyro.conf.Positional[Path], out: Path = Path("card.html")) -> None:
    """Write a self-contained HTML card of a data set: film strips, actions, splits, statistics.

    Args:
        folder: The data set.
        out: Page to write.
    """
    from cognitivedrone.data.card import card

    card(folder, out)
    print(out)  # noqa: T201


@data.command
def verify(folder: tyro.conf.Positional[Path]) -> None:
    """Check every shard of a data set against its hash; exit code 1 where something is missing, cut short or altered.

    Args:
        folder: The data set.
    """
    from cognitivedrone.data.verify import verify as problems_of

    problems = problems_of(folder)
    for problem in problems:
        print(problem)  # noqa: T201
    if problems:
        sys.exit(1)
    print(f"{folder}: whole")  # noqa: T201


@data.command
def export(folder: tyro.conf.Positional[Path], to: str, out: Path) -> None:
    """Write a data set in a format that trainers read.

    Args:
        folder: The data set.
        to: rlds, lerobot, lerobot-video, published, or your own as module:attribute.
        out: New folder to write.
    """
    from cognitivedrone.data.formats import export as export_set
    from cognitivedrone.data.store import Store

    store = Store.open(folder)
    count = export_set(track(store.labelled(), "exporting", total=len(store)), to, out)
    print(f"{out}: {count} episodes as {to}")  # noqa: T201


@data.command(name="import")
def import_(source: tyro.conf.Positional[Path], form: Annotated[str, tyro.conf.arg(name="from")], out: Path) -> None:
    """Take a data set of another format into a store of ours.

    Args:
        source: The data set to read.
        form: rlds, lerobot, published, or your own as module:attribute.
        out: New folder for the store.
    """
    from cognitivedrone.collect.importing import import_set

    print(f"{out}: {import_set(source, form, out)} episodes")  # noqa: T201


@data.command
def replay(folder: tyro.conf.Positional[Path], episode: tyro.conf.Positional[int]) -> None:
    """Fly the recorded commands of an episode again and say how far the end is from the record.

    Args:
        folder: The data set.
        episode: Index of the episode.
    """
    from cognitivedrone.collect.replay import replay as fly_again
    from cognitivedrone.data.store import Store

    report = fly_again(Store.open(folder).episode(episode))
    same = "the same bits" if report.same_bits else f"up to {report.path_error_m:.4f} m off on the way"
    print(f"episode {episode}: {report.steps} steps, ends {report.end_error_m:.4f} m off its record, {same}")  # noqa: T201


gazebo = tyro.extras.SubcommandApp()
app.command(gazebo, name="gazebo", help="Worlds for Gazebo: the same tasks, flown by ArduPilot.")


@gazebo.command(name="export")
def export_world(
    out: Path,
    suite: str = "open-v1:smoke",
    task: str | None = None,
    track: str | None = None,
    version: str = "harmonic",
    labels: str = "open-v1",
) -> None:
    """Write a task, or the stages of a track, as SDF worlds with meshes, textures and an ArduPilot vehicle.

    For example:

      cognitivedrone gazebo export --suite open-v1:test --task open-v1:test/0007 --out gazebo/0007
      cognitivedrone gazebo export --suite open-v1:track --track 3 --out gazebo/track3

    Args:
        out: New folder to write.
        suite: Name of the suite, or a task file.
        task: Id of one task.
        track: Number of a track, from 0, or the id of a task in it.
        version: Release of Gazebo that the README of the folder tells to install: harmonic, ionic or jetty.
        labels: Label pack, or a folder of pictures.
    """
    from cognitivedrone.links.gazebo.export import export as export_to

    done = export_to(suite, out=out, task=task, track=track, version=version, labels=labels)
    for world, shown in zip(done.worlds, done.track, strict=True):
        print(f"{world}: {shown.instruction}  (right: gate {shown.target + 1})")  # noqa: T201


@gazebo.command(name="check")
def check_world(files: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """Have SDF files checked by libsdformat, Gazebo's own parser.

    Args:
        files: Worlds or models.
    """
    from cognitivedrone.links.gazebo.check import check as check_files

    print(f"{len(files)} passed {check_files(files)}")  # noqa: T201


@app.command
def fly(config: Annotated[FlyConfig, tyro.conf.arg(name="")]) -> None:
    """Fly a drone by an instruction, in real time: our simulator, ArduPilot SITL or a vehicle over MAVLink.

    While it flies, a line that is typed is its new instruction, "land" lands it, and so does ctrl-C. Steps, events and
    a film are recorded. Exit code 0: through a gate, or landed as asked; 1: ended otherwise; 130: ctrl-C. Examples:

      cognitivedrone fly --policy colour_seeker --reasoner oracle --suite open-v1:test --episode 3
      cognitivedrone fly --policy colour_seeker --reasoner none "Fly through the red gate"
      cognitivedrone fly --link mavlink:udp:127.0.0.1:14550 --camera http://127.0.0.1:8090/ "Fly through the red gate"

    A real drone needs more than a command: read docs/real-drone.md.
    """
    from cognitivedrone.cockpit.fly import fly_mission
    from cognitivedrone.cockpit.view import summary_table

    console = Console()
    summary = fly_mission(config, console=console)
    console.print(summary_table(summary), highlight=False)
    sys.exit(summary.exit_code)


@app.command
def sim(config: Annotated[SimConfig, tyro.conf.arg(name="")]) -> None:
    """Serve the simulator as a MAVLink vehicle, until ctrl-C: ground stations and `fly` connect to it.

    Needs the extra `mavlink`. Example:

      cognitivedrone sim --mavlink --camera-port 8090 --suite open-v1:test --episode 3
    """
    from cognitivedrone.cockpit.vehicle import serve_vehicle, until_interrupted

    with until_interrupted() as stop:
        lost = serve_vehicle(config, stop, lambda served: print(served, flush=True))  # noqa: T201
    print(f"stopped; the vehicle fell {lost:.1f} s behind the clock")  # noqa: T201


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
