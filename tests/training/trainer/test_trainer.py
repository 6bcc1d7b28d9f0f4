"""A whole training in small: kept, killed, gone on with, and the same in the end."""

import json
import math
import os
import re
import signal
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from quick_trainings import TINY_READER, QuickPolicyTraining, train_here

from cognitivedrone.cli.training import last_success
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.small_vla import Flight
from cognitivedrone.rollout import cards
from cognitivedrone.rollout.cards import Cards
from cognitivedrone.training.launch import ALL_RECIPES, RECIPES, find_recipe
from cognitivedrone.training.reasoner.selector import SelectorRecipe
from cognitivedrone.training.small_vla.language import DEBUG_LANGUAGE, LanguageRecipe
from cognitivedrone.training.small_vla.losses import action_measures
from cognitivedrone.training.small_vla.policy import FlightRecipe, TrainRecipe
from cognitivedrone.training.trainer import trainer
from cognitivedrone.training.trainer.checkpoint import (
    CHECKPOINT,
    DIMENSIONS,
    METRICS,
    draw_curves,
    read_checkpoint,
    read_rows,
)
from cognitivedrone.training.trainer.prefetch import PrefetchQueue, learner_path
from cognitivedrone.training.trainer.trainer import TrainConfig, learning_rate, stop_message, train
from cognitivedrone.training.trainer.training_task import Given, to_tensors

# Trials once, at the end: the rest of the time goes into processes that start.
RECIPE = replace(RECIPES["debug"], fly_every=6, fly_tasks=1)
SUPPORT = Path(__file__).parents[2] / "support"

KILLED = """
import os, signal, sys
from dataclasses import replace
from pathlib import Path
import pytest
from quick_trainings import QuickPolicyTraining, make_small
from cognitivedrone.training.trainer import trainer
from cognitivedrone.training.trainer.training_task import Given
from cognitivedrone.training.launch import RECIPES

def report(line):
    # The second round's row is written before its checkpoint: that is where the power goes.
    if line.startswith("step 4"):
        os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    make_small(pytest.MonkeyPatch())
    recipe = replace(RECIPES["debug"], fly_every=6, fly_tasks=1)
    task = QuickPolicyTraining.of(recipe.training(Given(start=Path(sys.argv[2]))))
    trainer.train(trainer.TrainConfig(Path(sys.argv[1]), task, seed=3), report)
"""


@dataclass(frozen=True)
class Runs:
    """A training that was never stopped, and one that was."""

    whole: Path
    resumed: Path
    reports: list[str]


pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def start(language_checkpoint: Path) -> Given:
    return Given(start=language_checkpoint)


def training_of(start: Given, recipe: TrainRecipe = RECIPE) -> QuickPolicyTraining:
    return QuickPolicyTraining.of(recipe.training(start))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, start: Given) -> Runs:
    folder = tmp_path_factory.mktemp("trainings")
    whole, resumed = folder / "whole", folder / "resumed"
    script = folder / "killed.py"
    script.write_text(KILLED)
    paths = os.pathsep.join([str(SUPPORT), *filter(None, [os.environ.get("PYTHONPATH")])])
    # Its end is the end of its output: were the generating process left behind, this would wait for that as well.
    killed = subprocess.run(
        [sys.executable, script, resumed, str(start.start)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    # The kill came between a row and its checkpoint.
    assert (read_checkpoint(resumed / CHECKPOINT)[1]["step"], read_rows(resumed / METRICS)[-1]["step"]) == (2, 4)
    reports: list[str] = []
    train(TrainConfig(resumed, training_of(start), seed=3, resume=True), lambda _: None)
    train_here(whole, training_of(start), seed=3, report=reports.append)  # no process of its own makes its data
    return Runs(whole, resumed, reports)


def test_a_killed_training_ends_with_the_same_weights(runs: Runs) -> None:
    (whole, facts), (resumed, same_facts) = (read_checkpoint(run / CHECKPOINT) for run in (runs.whole, runs.resumed))
    assert facts == same_facts
    assert facts["step"] == RECIPE.steps
    assert whole.keys() == resumed.keys()
    for name, value in whole.items():
        assert torch.equal(value, resumed[name]), name
        assert value.isfinite().all(), name


def test_a_killed_training_leaves_the_same_curves(runs: Runs) -> None:
    whole, resumed = (
        [{key: row[key] for key in row if key not in ("steps_per_s", "waiting")} for row in read_rows(run / METRICS)]
        for run in (runs.whole, runs.resumed)
    )
    assert [row["step"] for row in whole] == [2, 4, 6]
    assert whole == resumed


def test_a_training_changes_all_weights_but_those_of_reader_and_language(runs: Runs, start: Given) -> None:
    first, last = (read_checkpoint(path)[0] for path in (learner_path(runs.whole, 0), runs.whole / CHECKPOINT))
    moved = {name for name in first if (first[name] != last[name]).any()}
    kept = {name for name in first if name.startswith(("network.reader.", "network.language."))}
    assert moved == set(first) - kept
    assert start.start is not None
    before = read_checkpoint(start.start)[0]
    assert kept == {name for name in before if not name.startswith("network.encoder.")}
    assert all(torch.equal(before[name], last[name]) for name in kept)


def test_rows_have_the_measures_of_the_literature_and_the_baseline(runs: Runs) -> None:
    rows = read_rows(runs.whole / METRICS)
    wanted = {"step", "steps_per_s", "waiting", "choice accuracy", "train loss", "train choice accuracy"}
    for measure in ("l1", "accuracy", "baseline accuracy", "baseline l1"):
        wanted |= {measure} | {f"{measure} {dimension}" for dimension in DIMENSIONS}
    for part in ("heat", "place", "looks", "choice", "action"):
        wanted |= {part, f"train {part}"}
    for row in rows:
        assert wanted <= row.keys()
        assert all(math.isfinite(value) for value in row.values())
        assert 0 <= row["accuracy"] <= 1
        assert 0 < row["baseline accuracy"] <= 1
        assert row["l1"] == pytest.approx(sum(row[f"l1 {name}"] for name in DIMENSIONS) / 4)
    assert "success" in rows[-1]
    assert 0 <= rows[-1]["success"] <= 1
    assert not any("success" in row for row in rows[:-1])
    assert len({row["baseline accuracy"] for row in rows}) == 1  # the validation frames stay the same
    assert [line.split("  ")[0] for line in runs.reports] == ["step 2", "step 4", "step 6"]
    assert "success" in runs.reports[-1]


def test_curves_are_a_picture_and_tensorboard_has_its_file(runs: Runs) -> None:
    with Image.open(runs.resumed / "curves.png") as picture:
        picture.load()
        assert picture.format == "PNG"
        assert min(picture.size) > 500
        assert len(picture.convert("RGB").getcolors(1 << 24)) > 10
    assert list((runs.resumed / "tensorboard").glob("events.*"))


def test_the_folder_tells_its_recipe(runs: Runs) -> None:
    told = json.loads((runs.whole / "recipe.json").read_text())
    assert told["seed"] == 3
    assert told["recipe"]["name"] == "debug"
    assert told["data"] == "from debug-language, step 6, seed 0"
    assert told["recipe"]["network"]["language"] == {**DEBUG_LANGUAGE.network.facts(), "size": 32}
    assert told["recipe"]["network"]["reader"] == TINY_READER.network.facts()


# ---- what is refused, and what there is nothing to do about


def test_a_finished_training_has_nothing_left_to_do(runs: Runs, start: Given) -> None:
    before = {path: path.stat().st_mtime_ns for path in runs.whole.rglob("*")}
    reports: list[str] = []
    assert (
        train(TrainConfig(runs.whole, training_of(start), seed=3, resume=True), reports.append)
        == runs.whole / CHECKPOINT
    )
    assert reports == []
    assert before == {path: path.stat().st_mtime_ns for path in runs.whole.rglob("*")}


@pytest.mark.parametrize("name", ["learners", "tensorboard"])
def test_nothing_is_trained_through_a_link(tmp_path: Path, start: Given, name: str) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(theirs)
    with pytest.raises(TrainingError, match=f"'{name}' is a link or in one"):
        train(TrainConfig(tmp_path / "out", training_of(start), seed=3))
    assert not list(theirs.iterdir())


def test_a_training_is_not_begun_over_another(runs: Runs, start: Given) -> None:
    with pytest.raises(TrainingError, match="holds a training run already; go on with --resume or choose another"):
        train(TrainConfig(runs.whole, training_of(start), seed=3))


@pytest.mark.parametrize(
    ("recipe", "seed"),
    [(RECIPE, 4), (replace(RECIPE, learning_rate=1e-3), 3), (replace(RECIPE, steps=8), 3)],
    ids=["seed", "rate", "steps"],
)
def test_a_training_does_not_go_on_by_another_recipe_or_seed(
    runs: Runs, start: Given, recipe: TrainRecipe, seed: int
) -> None:
    with pytest.raises(TrainingError, match="a training run by another recipe, seed or data; choose another folder"):
        train(TrainConfig(runs.whole, training_of(start, recipe), seed=seed, resume=True))


# ---- curves


def test_measures_of_actions_are_those_of_their_definitions() -> None:
    network = Flight(RECIPE.network)
    bins = torch.tensor([[10, 100, 100, 100], [10, 120, 100, 100], [10, 140, 110, 100], [11, 160, 110, 100]])
    span = network.high - network.low
    target = (network.low + bins / 255 * span)[:, None]
    right = bins.clone()
    right[0, 1] += 30  # one mistake, of thirty bins
    raw = (2 * right / 255 - 1)[:, None]
    row = action_measures(network, raw, target)
    assert [row[f"accuracy {name}"] for name in DIMENSIONS] == [1, 0.75, 1, 1]
    assert row["accuracy"] == pytest.approx(15 / 16)
    wrong = float(30 / 255 * span[1] / 4)
    assert [row[f"l1 {name}"] for name in DIMENSIONS] == pytest.approx([0, wrong, 0, 0], abs=1e-5)
    assert row["l1"] == pytest.approx(wrong / 4, abs=1e-5)
    # What the commonest token would give.
    assert [row[f"baseline accuracy {name}"] for name in DIMENSIONS] == [0.75, 0.25, 0.5, 1]
    assert row["baseline l1 vx"] == pytest.approx(float(span[0]) / 255 / 4, abs=1e-5)


def test_a_row_cut_short_by_a_kill_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / METRICS
    assert read_rows(path) == []
    path.write_text('{"step": 2, "l1": 0.5}\n{"step": 4, "l')
    assert read_rows(path) == [{"step": 2, "l1": 0.5}]


def test_curves_are_drawn_of_whatever_there_is(tmp_path: Path) -> None:
    rows = [
        {"step": 2, "l1": 0.5, "cross-entropy": math.nan},
        {"step": 4, "l1": 0.4, "success": 0.5, "success race": 1},
    ]
    lesson = [{"step": 100, "train loss": 2.0, "train pictures read": 0.5, "pictures read": 0.4, "policy right": 0.2}]
    for drawn in (rows, lesson):
        draw_curves(drawn, tmp_path / "curves.png")
        with Image.open(tmp_path / "curves.png") as picture:
            picture.load()


def test_a_model_that_passes_no_gate_is_not_recommended(tmp_path: Path) -> None:
    assert last_success(tmp_path) is None
    (tmp_path / METRICS).write_text('{"step": 2, "success": 0.5}\n{"step": 4, "success": 0.0}\n{"step": 6, "l1": 1}\n')
    assert last_success(tmp_path) == 0


# ---- recipes


def test_unknown_recipes_are_named_with_near_ones() -> None:
    assert find_recipe("debug") is RECIPES["debug"]
    with pytest.raises(TrainingError, match="unknown recipe 'smal'; did you mean 'small'"):
        find_recipe("smal")


@pytest.mark.parametrize("name", RECIPES)
def test_recipes_are_whole(name: str) -> None:
    recipe = RECIPES[name]
    assert recipe.name == name
    assert recipe.validate_every % recipe.round_steps == 0
    assert recipe.fly_every % recipe.validate_every == 0
    json.dumps(recipe.facts())


def test_processes_share_a_batch(start: Given) -> None:
    training_task = RECIPES["small"].training(start)
    part = training_task.share(4)
    whole, shared = training_task.recipe.stream, part.recipe.stream
    assert shared.batch * 4 == whole.batch
    assert replace(part, recipe=replace(part.recipe, stream=whole)) == training_task
    with pytest.raises(TrainingError, match="a batch of 24 frames cannot be shared by 5 processes"):
        training_task.share(5)


def test_a_policy_flies_along_where_flights_are_made_and_the_recipe_gives_it_some(start: Given) -> None:
    training_task = training_of(start)
    network = training_task.network()
    pilot = training_task.learner(network)
    assert pilot is not None
    assert pilot.network is network  # so it flies with whatever weights the network is given
    assert replace(training_task, data=Path("recorded")).learner(network) is None
    expert_alone = replace(RECIPE, stream=replace(RECIPE.stream, learner=0.0))
    assert replace(training_task, recipe=expert_alone).learner(network) is None


def test_the_learning_rate_warms_up_stays_and_falls_to_nothing() -> None:
    recipe = RECIPES["small"]
    rates = [learning_rate(recipe, step) for step in range(recipe.steps + 1)]
    assert rates[0] == pytest.approx(recipe.learning_rate / recipe.warmup_steps)
    level = int(recipe.steps * (1 - recipe.decay_share))
    assert rates[recipe.warmup_steps : level] == [recipe.learning_rate] * (level - recipe.warmup_steps)
    assert all(earlier >= later for earlier, later in zip(rates[level:], rates[level + 1 :], strict=False))
    assert rates[-1] == 0


def test_a_stopped_training_says_what_is_kept(runs: Runs) -> None:
    assert stop_message(runs.whole) == (
        f"stopped; the checkpoint of step 6 is kept in {runs.whole}, the same command with --resume goes on"
    )


def test_ctrl_c_before_the_first_checkpoint_says_that_there_is_nothing_to_resume(tmp_path: Path, start: Given) -> None:
    class Stopped:
        def __init__(self, *_: object) -> None:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cognitivedrone.training.trainer.trainer._CheckpointManager", Stopped)
        with pytest.raises(KeyboardInterrupt, match=r"stopped at step 0, before the first checkpoint; .*start again"):
            train_here(tmp_path / "run", training_of(start), seed=3)


def test_a_card_that_fills_up_is_a_sentence_and_no_round_is_lost(
    tmp_path: Path, start: Given, monkeypatch: pytest.MonkeyPatch
) -> None:
    step_once = trainer._step

    def step(*arguments: Any) -> Any:
        if arguments[-1] == 3:
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")
        return step_once(*arguments)

    monkeypatch.setattr(trainer, "_step", step)
    with pytest.raises(TrainingError, match=r"memory is full: end what else .*; --resume goes on from the last round"):
        train_here(tmp_path / "run", training_of(start), seed=3)
    assert read_checkpoint(tmp_path / "run" / CHECKPOINT)[1]["step"] == 2


def test_the_stream_tells_how_it_begins(tmp_path: Path, start: Given, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process starts, its first flights fill the buffer, and only then comes a batch; Ctrl-C is not its own.

    It draws on the card of its rank, where there are several.
    """
    monkeypatch.setattr(cards, "here", lambda: Cards(("0", "1")))
    told: list[str] = []
    training_task = training_of(start)
    with PrefetchQueue(training_task, tmp_path, seed=3, rank=1, first_round=0, waiting=told.append) as prefetch:
        next(iter(prefetch))
        size = RECIPE.stream.batch * RECIPE.stream.pool
        assert prefetch._filled[1] == size
        assert _ignores_ctrl_c(prefetch._process.pid)
        assert b"CUDA_VISIBLE_DEVICES=1" in Path(f"/proc/{prefetch._process.pid}/environ").read_bytes().split(b"\0")
    assert told
    allowed = {"starting the stream", "waiting for a batch"}
    assert all(text in allowed or re.fullmatch(rf"flying: \d+ of {size} samples", text) for text in told)


def _ignores_ctrl_c(pid: int | None) -> bool:
    """Whether a process blocks SIGINT, as the kernel tells."""
    status = Path(f"/proc/{pid}/status").read_text()
    blocked = int(re.search(r"SigBlk:\s*([0-9a-f]+)", status)[1], 16)
    return bool(blocked & 1 << (signal.SIGINT - 1))


QUICK = ("debug", "race", "debug-language", "debug-obstacles", "debug-selector", "reader", "flight")
"""One of every kind; the others are larger, or have other settings of the same."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in ALL_RECIPES if name != "teach"],
)
def test_whatever_may_learn_gets_a_gradient(
    name: str, selector_checkpoint: Path, language_checkpoint: Path, policy_checkpoint: Path
) -> None:
    """Processes that share a training wait for every gradient; one that never comes ends it."""
    recipe = ALL_RECIPES[name]
    if isinstance(recipe, TrainRecipe):
        stream = replace(recipe.stream, batch=6, worlds=3, learner=0.0, sampled=0.5, pool=2)
        recipe = replace(recipe, stream=stream)
    if isinstance(recipe, SelectorRecipe):
        recipe = replace(recipe, pretrained=False, batch=4)
    if isinstance(recipe, LanguageRecipe):
        recipe = replace(recipe, batch=4)
    language = isinstance(recipe, TrainRecipe) and not isinstance(recipe, FlightRecipe)
    start = selector_checkpoint if isinstance(recipe, LanguageRecipe) else policy_checkpoint
    task = recipe.training(Given(start=language_checkpoint if language else start))
    batches = task.batches()((0, 0))
    loss_module = task.loss_module(task.network()).train()
    loss, _ = loss_module(to_tensors(next(batches)))
    loss.backward()
    without = [name for name, value in loss_module.named_parameters() if value.requires_grad and value.grad is None]
    assert not without


def test_a_recipe_of_another_length_keeps_everything_else():
    recipe = RECIPES["small"]
    longer, shorter = recipe.of_length(9_000), recipe.of_length(10)
    assert replace(longer, steps=recipe.steps) == recipe
    assert (shorter.steps, shorter.warmup_steps, shorter.round_steps, shorter.validate_every) == (10, 2, 10, 10)
    assert (recipe.fly_every, longer.fly_every, shorter.fly_every) == (2000, 2000, 0)
    assert shorter.network == recipe.network
    with pytest.raises(TrainingError, match="at least 1"):
        recipe.of_length(0)
