"""Fine-tuning of OpenVLA in small, from flights to a flight: kept, killed, gone on with, merged, flown."""

import json
import math
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from openvla_files import write_checkpoint
from quick_trainings import killed_at

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.cli import main
from cognitivedrone.data.statistics import spread
from cognitivedrone.data.store import Store
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.openvla import checkpoint as checkpoints
from cognitivedrone.models.openvla.actions import ActionStatistics, from_tokens, to_tokens
from cognitivedrone.models.openvla.checkpoint import inspect
from cognitivedrone.models.openvla.config import Config
from cognitivedrone.models.openvla.network import IGNORED
from cognitivedrone.models.openvla.prepare import END, ImagePreparation, prompt_ids, read_encoder
from cognitivedrone.models.openvla.tensors import elements, unused_tensors, used_tensors
from cognitivedrone.models.openvla.weights import load
from cognitivedrone.training.openvla import lora as openvla_lora
from cognitivedrone.training.openvla.adapters import (
    add_adapters,
    cast_inputs,
    check_machine,
    fitted,
    needed_bytes,
    read_base,
    take_adapters,
    trained_weights,
)
from cognitivedrone.training.openvla.data import SampleMaker, answer_measures, rows_of_step
from cognitivedrone.training.openvla.lora import MERGED, FineTuning, fine_tune, merge
from cognitivedrone.training.openvla.recipes import LORA_RECIPES, PAPER, LoraRecipe, find_lora_recipe
from cognitivedrone.training.trainer.checkpoint import CHECKPOINT, DIMENSIONS, METRICS, read_checkpoint, read_rows

# A rate at which a tiny network changes in six steps.
RECIPE = replace(LORA_RECIPES["debug"], learning_rate=5e-3, validate_every=4)


@dataclass(frozen=True)
class Runs:
    """A training that was never stopped, and one that was."""

    whole: FineTuning
    resumed: FineTuning


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As published, with the statistics of an arm."""
    folder = write_checkpoint(tmp_path_factory.mktemp("openvla") / "base")
    told = json.loads((folder / "config.json").read_text())
    told["norm_stats"] = {"bridge_orig": {"action": {"q01": [-1.0] * 7, "q99": [1.0] * 7}}}
    (folder / "config.json").write_text(json.dumps(told))
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, base: Path, flights: Path) -> Runs:
    folder = tmp_path_factory.mktemp("runs")
    whole = FineTuning(base, flights, folder / "whole", RECIPE, seed=3, key="drone")
    resumed = replace(whole, out=folder / "resumed", resume=True)
    with killed_at(4) as kill:
        fine_tune(replace(resumed, resume=False), kill)
    # The kill came between a row and its checkpoint.
    assert (read_checkpoint(resumed.out / CHECKPOINT)[1]["step"], read_rows(resumed.out / METRICS)[-1]["step"]) == (
        2,
        4,
    )
    for config in (resumed, whole):
        assert fine_tune(config, lambda _: None) == config.out / MERGED
    return Runs(whole, resumed)


def test_a_killed_training_ends_with_the_same_weights(runs: Runs) -> None:
    (whole, facts), (resumed, same) = (read_checkpoint(each.out / CHECKPOINT) for each in (runs.whole, runs.resumed))
    assert facts == same
    assert facts["step"] == RECIPE.steps
    assert whole.keys() == resumed.keys()
    for name, value in whole.items():
        assert torch.equal(value, resumed[name]), name
        assert value.isfinite().all(), name
    files = [(each.out / MERGED / checkpoints.WEIGHTS).read_bytes() for each in (runs.whole, runs.resumed)]
    assert files[0] == files[1]


def test_a_killed_training_leaves_the_same_curves(runs: Runs) -> None:
    whole, resumed = (
        [{key: row[key] for key in row if key != "samples_per_s"} for row in read_rows(each.out / METRICS)]
        for each in (runs.whole, runs.resumed)
    )
    assert [row["step"] for row in whole] == [2, 4, 6]
    assert whole == resumed
    assert (runs.resumed.out / "curves.png").stat().st_size > 10_000
    assert list((runs.resumed.out / "tensorboard").glob("events.*"))


def test_rows_have_the_measures_of_the_literature_and_the_baseline(runs: Runs) -> None:
    rows = read_rows(runs.whole.out / METRICS)
    wanted = {"train loss", "train accuracy", "samples_per_s"}
    for measure in ("l1", "accuracy", "cross-entropy", "baseline accuracy", "baseline l1"):
        wanted |= {measure} | {f"{measure} {dimension}" for dimension in DIMENSIONS}
    for row in rows[1:]:
        assert wanted <= row.keys()
        assert all(math.isfinite(value) for value in row.values())
        assert row["l1"] == pytest.approx(sum(row[f"l1 {name}"] for name in DIMENSIONS) / 4)
    assert "l1" not in rows[0]
    assert rows[1]["baseline l1"] == rows[2]["baseline l1"]  # the validation frames stay the same


def test_a_checkpoint_has_adapters_and_moments_and_nothing_of_the_base(runs: Runs) -> None:
    tensors, _ = read_checkpoint(runs.whole.out / CHECKPOINT)
    count = {
        kind: sum(value.numel() for name, value in tensors.items() if name.startswith(f"network.{kind}/"))
        for kind in ("adapter", "exp_avg", "exp_avg_sq")
    }
    assert set(count.values()) == {trained_weights(runs.whole.checkpoint.config, RECIPE.rank)}
    assert {name.split(".")[1].split("/")[0] for name in tensors} == {*count, "step"}
    # Each adapter begins with zeros on its way out, so that every one has learnt.
    assert all(value.any() for name, value in tensors.items() if "lora_B" in name)


def test_the_merged_network_answers_as_the_adapted_one(runs: Runs) -> None:
    config = runs.whole
    maker = _maker(config)
    samples = {name: value for name, value in maker(config.flights.val[:2]).items() if name != "labels"}
    plain, adapted = (load(config.checkpoint, "cpu", torch.float32) for _ in range(2))
    take_adapters(add_adapters(adapted, RECIPE), read_checkpoint(config.out / CHECKPOINT)[0])
    merged = load(inspect(config.out / MERGED), "cpu", torch.float32)
    with torch.no_grad():
        before, wanted, got = (network.eval()(**samples).logits for network in (plain, adapted, merged))
    torch.testing.assert_close(got, wanted, atol=1e-5, rtol=1e-4)
    assert (wanted - before).abs().max() > 1e-3


def test_the_merged_checkpoint_has_the_statistics_of_the_training_split(runs: Runs, flights: Path) -> None:
    found = inspect(runs.whole.out / MERGED)
    wanted = spread(Store(flights).actions("train"))
    assert found.statistics_key == "drone"
    assert found.statistics == ActionStatistics(tuple(wanted["q01"]), tuple(wanted["q99"]))


def test_what_was_trained_flies(runs: Runs, tmp_path: Path) -> None:
    policy = f"openvla:{runs.whole.out / MERGED},device=cpu"
    results = run(Plan.of(policy=policy, suite="open-v1:smoke", episodes=1, workers=0, out=tmp_path / "run", clips=0))
    outcomes = results.summary().overall.outcomes
    assert sum(outcomes.values()) == 1
    assert not outcomes["invalid"]
    assert not outcomes["policy_error"]


def test_a_batch_is_learnt_by_heart(base: Path, flights: Path) -> None:
    config = FineTuning(base, flights, Path("unused"), RECIPE)
    network = load(config.checkpoint, "cpu", torch.float32)
    trained = add_adapters(network, replace(RECIPE, rank=16, alpha=32))
    network.train()
    optimizer = torch.optim.AdamW(trained.values(), 0.03)
    samples = _maker(config)(config.flights.train[::7][:4])
    losses = []
    for _ in range(25):
        loss = network(**samples).loss
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[0] > 9
    assert losses[-1] < losses[0] / 3


def test_adapters_without_copies_of_their_inputs_learn_the_same_bits_in_less_memory(base: Path, flights: Path) -> None:
    config = FineTuning(base, flights, Path("unused"), RECIPE)
    samples = _maker(config)(config.flights.train[:4])
    network = load(config.checkpoint, "cpu", torch.bfloat16)
    trained = add_adapters(network, RECIPE)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():  # those on the way out begin with zeros, which hide what goes in
        for value in trained.values():
            value.copy_(0.1 * torch.randn(value.shape, generator=generator))
    network.train()

    def learnt() -> tuple[list[torch.Tensor], int]:
        kept: dict[int, int] = {}

        def keep(value: torch.Tensor) -> torch.Tensor:
            kept[value.untyped_storage().data_ptr()] = value.untyped_storage().nbytes()
            return value

        with torch.autograd.graph.saved_tensors_hooks(keep, lambda value: value), torch.autocast("cpu", torch.bfloat16):
            loss = network(**samples).loss
        return [loss.detach(), *torch.autograd.grad(loss, list(trained.values()))], sum(kept.values())

    ours, bytes_kept = learnt()
    cast_inputs(network, enabled=True)  # as PEFT does by itself
    copied, more_bytes = learnt()
    assert all(torch.equal(one, other) for one, other in zip(ours, copied, strict=True))
    assert any(value.any() for value in ours[1:])
    assert bytes_kept < 0.95 * more_bytes


@pytest.fixture
def nothing_is_merged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(openvla_lora, "merge", lambda _: None)


@pytest.mark.usefixtures("nothing_is_merged")
def test_gradients_of_micro_batches_add_up(base: Path, flights: Path, tmp_path: Path) -> None:
    recipe = replace(RECIPE, steps=1)
    moments = []
    for size in (4, 1):
        config = FineTuning(
            base, flights, tmp_path / str(size), replace(recipe, micro_batch=size, checkpointing=size > 1)
        )
        fine_tune(config, lambda _: None)
        tensors, _ = read_checkpoint(config.out / CHECKPOINT)
        moments.append({name: value for name, value in tensors.items() if name.startswith("network.exp_avg/")})
        assert config.identity == replace(config, recipe=recipe).identity
    whole, parts = moments
    assert whole.keys() == parts.keys()
    difference = sum(float((parts[name] - value).square().sum()) for name, value in whole.items())
    # To the roundings of bfloat16, in which the products are.
    assert 0 < difference < 0.02**2 * sum(float(value.square().sum()) for value in whole.values())


@pytest.mark.usefixtures("nothing_is_merged")
def test_where_memory_runs_out_in_the_middle_it_goes_on_with_fewer_samples_at_once(
    base: Path, flights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, tried = openvla_lora._step, []

    def short(network: Any, optimizer: Any, accelerator: Any, parts: Any, number: int) -> Any:
        tried.append((number, [len(part["input_ids"]) for part in parts]))
        if number and max(tried[-1][1]) > 2:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return step(network, optimizer, accelerator, parts, number)

    monkeypatch.setattr(openvla_lora, "_step", short)
    recipe = replace(RECIPE, steps=3, micro_batch=4)
    with pytest.warns(UserWarning, match="step 1: the memory is full; going on with 2 samples at once"):
        fine_tune(FineTuning(base, flights, tmp_path / "run", recipe), lambda _: None)
    assert tried == [(0, [4]), (1, [4]), (1, [2, 2]), (2, [2, 2])]
    monkeypatch.setattr(openvla_lora, "_step", lambda *_: (_ for _ in ()).throw(torch.OutOfMemoryError()))
    with (
        pytest.warns(UserWarning, match="going on with 1 samples at once"),
        pytest.raises(TrainingError, match=r"the memory is full with 1 samples at once; .* with --resume"),
    ):
        fine_tune(FineTuning(base, flights, tmp_path / "other", replace(recipe, micro_batch=2)), lambda _: None)


@pytest.mark.slow
def test_two_processes_learn_what_one_does_with_the_weights_copied_and_sharded(
    base: Path, flights: Path, tmp_path: Path
) -> None:
    """By the command: DDP and FSDP over gloo, between two processes on this CPU."""
    launcher = ["torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "cognitivedrone"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    rows, moments = {}, {}
    for kind, more in (("one", []), ("copied", []), ("sharded", ["--shard"])):
        out = tmp_path / kind
        flags = ["--base", base, "--data", flights, "--out", out, "--recipe", "debug", "--micro-batch", "2", *more]
        command = ["train-openvla", *map(str, flags)]
        if kind == "one":
            main(command)
        else:
            subprocess.run([sys.executable, "-m", *launcher, *command], env=environment, timeout=240, check=True)
        assert inspect(out / MERGED).statistics_key == "cognitivedrone"
        rows[kind] = read_rows(out / METRICS)
        tensors, _ = read_checkpoint(out / CHECKPOINT)
        moments[kind] = {name: value for name, value in tensors.items() if "/" in name}
    for kind in ("copied", "sharded"):
        for one, two in zip(rows["one"], rows[kind], strict=True):
            # The same samples, summed in another order.
            assert two["train loss"] == pytest.approx(one["train loss"], rel=1e-3)
            assert two.keys() == one.keys()
        assert rows[kind][-1]["cross-entropy"] == pytest.approx(rows["one"][-1]["cross-entropy"], rel=1e-3)
        assert rows[kind][-1]["baseline l1"] == rows["one"][-1]["baseline l1"]
        # What each process held a part of is written whole.
        shapes = {name: value.shape for name, value in moments["one"].items()}
        assert {name: value.shape for name, value in moments[kind].items()} == shapes


# ---- samples


def test_samples_are_the_records_in_the_published_layout(base: Path, flights: Path) -> None:
    config = FineTuning(base, flights, Path("unused"))
    maker, numbers = _maker(config), config.flights.train[[0, 40, 90]]
    samples = maker(numbers, np.array([False, True, False]))
    read = Store(flights).steps(numbers)
    statistics, encode = config.flights.statistics, read_encoder(base / "tokenizer.json")
    for row in range(3):
        text = read["directive" if row == 1 else "instruction"][row]
        prompt = prompt_ids(encode, text)
        ids, labels = samples["input_ids"][row].tolist(), samples["labels"][row].tolist()
        assert ids[: len(prompt)] == prompt
        assert set(labels[: len(prompt)]) == {IGNORED}
        answer = labels[len(prompt) : len(prompt) + 5]
        assert answer == ids[len(prompt) : len(prompt) + 5]
        assert answer[-1] == END
        assert set(labels[len(prompt) + 5 :]) <= {IGNORED}
        assert int(samples["attention_mask"][row].sum()) == len(prompt) + 5
        clipped = np.clip(read["action"][row], statistics.q01, statistics.q99)
        width = (np.array(statistics.q99) - statistics.q01) / 255
        assert (np.abs(statistics.flown(from_tokens(np.array(answer[:4]))) - clipped) <= width / 2 + 1e-6).all()
        np.testing.assert_array_equal(samples["pixel_values"][row], ImagePreparation().pixel_values(read["image"][row]))


def test_every_epoch_shows_every_step_once_in_another_order() -> None:
    numbers = np.arange(100, 110)
    seen = np.concatenate([rows_of_step(numbers, 4, seed=1, step=step) for step in range(5)])
    assert sorted(seen[:10]) == sorted(seen[10:]) == numbers.tolist()
    assert seen[:10].tolist() != seen[10:].tolist()
    assert rows_of_step(numbers, 4, seed=2, step=0).tolist() != seen[:4].tolist()
    # More than an epoch at once, and the same order as in small steps.
    assert rows_of_step(numbers, 20, seed=1, step=0).tolist() == seen.tolist()


def test_measures_are_those_of_their_definitions() -> None:
    statistics = ActionStatistics((-1.0,) * 4, (1.0,) * 4)
    actions = from_tokens(to_tokens(np.array([[0.0, 0.5, 0.1, 0.2], [0.0, 0.5, 0.2, 0.2], [0.5, 0.5, 0.3, 0.2]])))
    guess = to_tokens(actions)
    guess[0, 1] -= 30  # one mistake, of thirty bins
    entropy = np.arange(12.0).reshape(3, 4)
    row = answer_measures(actions, guess, entropy, statistics)
    assert [row[f"accuracy {name}"] for name in DIMENSIONS] == pytest.approx([1, 2 / 3, 1, 1])
    assert [row[f"l1 {name}"] for name in DIMENSIONS] == pytest.approx([0, 30 * 2 / 255 / 3, 0, 0])
    assert [row[f"cross-entropy {name}"] for name in DIMENSIONS] == [4, 5, 6, 7]
    assert row["cross-entropy"] == 5.5
    assert [row[f"baseline accuracy {name}"] for name in DIMENSIONS] == pytest.approx([2 / 3, 1, 1 / 3, 1])
    assert row["baseline l1 vx"] == pytest.approx(0.5 / 3, abs=0.01)


# ---- sizes


def test_the_7b_is_adapted_as_published() -> None:
    # The published fine-tuning tells of 110,828,288. It also adapts what is never run: each tower's last block, and the
    # four matrices of SigLIP's pooling.
    matrices = [shape for shape in unused_tensors(Config()).values() if len(shape) == 2]
    unused = sum(PAPER.rank * (outputs + inputs) for outputs, inputs in matrices)
    assert trained_weights(Config(), PAPER.rank) + unused == 110_828_288


def test_memory_grows_with_what_is_kept_and_shrinks_with_sharding(base: Path, flights: Path) -> None:
    whole = replace(FineTuning(base, flights, Path("unused")).checkpoint, config=Config(), stored_bytes=2)
    needed = needed_bytes(Config(), PAPER)
    assert 17e9 < needed < 40e9
    assert needed < needed_bytes(Config(), replace(PAPER, checkpointing=False))
    assert needed < needed_bytes(Config(), replace(PAPER, micro_batch=16)) < 80e9
    assert needed < needed_bytes(Config(), PAPER, stored=4)
    # Before they are spread, the weights alone lie on each GPU.
    weights = 2 * elements(used_tensors(Config()).values())
    assert weights == needed_bytes(Config(), PAPER, 8, sharded=True) < needed
    check_machine(needed, 80_000_000_000, "cuda", base)

    # The fastest way that there is room for, unless the recipe says which.
    def way(recipe: LoraRecipe, gigabytes: int, processes: int = 1) -> tuple[int | None, bool | None]:
        found = fitted(whole, recipe, processes, gigabytes * 10**9, "cuda", sharded=False)
        return found.micro_batch, found.checkpointing

    assert way(PAPER, 140) == (32, False)
    assert way(PAPER, 80) == (16, False)
    assert way(PAPER, 48) == (8, False)
    assert way(PAPER, 40) == (32, True)
    assert way(PAPER, 24) == (16, True)
    assert way(PAPER, 80, processes=8) == (8, False)
    assert way(replace(PAPER, micro_batch=8), 40) == (8, True)
    assert way(replace(PAPER, checkpointing=True), 80) == (32, True)
    assert way(replace(PAPER, checkpointing=False), 40) == (4, False)
    with pytest.raises(TrainingError, match=r"needs 1\d\.\d GB of GPU memory, has 16\.0 GB free"):
        way(PAPER, 16)
    with pytest.raises(
        TrainingError, match=r"needs \d\d\.\d GB of GPU memory, has 16\.0 GB free; take a smaller --mic"
    ):
        check_machine(needed, 16_000_000_000, "cuda", base)
    with pytest.raises(TrainingError, match=r"needs \d\d\.\d GB of GPU memory, and this machine has no GPU"):
        check_machine(needed, 80_000_000_000, "cpu", base)


# ---- what is refused before anything is loaded


@pytest.fixture
def nothing_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("the weights were loaded")

    monkeypatch.setattr(openvla_lora, "load", refuse)


@pytest.mark.usefixtures("nothing_is_loaded")
class TestBeforeAnythingHeavyIsLoaded:
    def test_no_flight_of_the_recipes_category(self, base: Path, flights: Path, tmp_path: Path) -> None:
        with pytest.raises(TrainingError, match="no step of the category 'racing' in its train split; collect more"):
            fine_tune(FineTuning(base, flights, tmp_path, LORA_RECIPES["race"]))

    def test_too_little_memory(
        self, base: Path, flights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(checkpoints, "free_memory", lambda: 1_000_000)
        with pytest.raises(TrainingError, match=r"needs 0\.\d GB of memory, has 0\.0 GB free"):
            fine_tune(FineTuning(base, flights, tmp_path / "run", RECIPE))

    def test_shards_on_one_process(self, base: Path, flights: Path, tmp_path: Path) -> None:
        with pytest.raises(TrainingError, match="start it by torchrun"):
            fine_tune(FineTuning(base, flights, tmp_path / "run", RECIPE, shard=True))

    def test_a_run_that_is_there(self, runs: Runs) -> None:
        with pytest.raises(TrainingError, match="holds a training run already; go on with --resume"):
            fine_tune(runs.whole)

    def test_a_run_of_another_making(self, runs: Runs, tmp_path: Path) -> None:
        other_base = write_checkpoint(tmp_path / "base", seed=4)
        for change, named in (({"seed": 4}, "seed"), ({"base": other_base}, "base"), ({"key": "x"}, "key")):
            with pytest.raises(TrainingError, match=f"holds a training run of another {named}; choose another folder"):
                fine_tune(replace(runs.resumed, **change))
        with pytest.raises(TrainingError, match="another recipe"):
            fine_tune(replace(runs.resumed, recipe=replace(RECIPE, steps=8)))

    def test_nothing_to_merge(self, base: Path, flights: Path, tmp_path: Path) -> None:
        with pytest.raises(TrainingError, match=r"has no checkpoint.safetensors to merge; train first"):
            merge(FineTuning(base, flights, tmp_path / "run", RECIPE))

    def test_too_little_memory_to_merge(self, runs: Runs, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(checkpoints, "free_memory", lambda: 1_000_000)
        with pytest.raises(TrainingError, match=r"merging .*resumed needs 0\.0 GB .* free; nothing is lost"):
            merge(runs.resumed)

    def test_a_finished_run_has_nothing_left_to_do(self, runs: Runs) -> None:
        before = {path: path.stat().st_mtime_ns for path in runs.resumed.out.rglob("*")}
        assert fine_tune(runs.resumed) == runs.resumed.out / MERGED
        assert before == {path: path.stat().st_mtime_ns for path in runs.resumed.out.rglob("*")}


def test_a_base_leaves_the_head_of_the_parallel_decoder_and_its_chunks(tmp_path: Path) -> None:
    folder = write_checkpoint(tmp_path / "base", chunk=5)
    statistics = ActionStatistics((-1.0,) * 4, (1.0,) * 4, (True,) * 4)
    found = read_base(folder, "drone", statistics)
    assert inspect(folder).head is not None
    assert found.head is None
    assert found.config == replace(inspect(folder).config, chunk=None)
    assert (found.statistics_key, found.statistics) == ("drone", statistics)


@pytest.mark.parametrize("name", LORA_RECIPES)
def test_recipes_are_whole(name: str) -> None:
    recipe = find_lora_recipe(name)
    assert recipe.name == name
    assert recipe.validate_every % recipe.save_every == 0
    json.dumps(recipe.facts())


def test_unknown_recipes_are_named_with_near_ones() -> None:
    with pytest.raises(TrainingError, match="unknown recipe 'papr'; did you mean 'paper'"):
        find_lora_recipe("papr")
    with pytest.raises(TrainingError, match="at least 1"):
        replace(PAPER, micro_batch=0)


def _maker(config: FineTuning) -> SampleMaker:
    found = read_base(config.base, config.key, config.flights.statistics)
    return SampleMaker(config.flights, read_encoder(found.tokenizer), found.preparation)
