"""Checkpoints come back as they were, and what is no checkpoint is refused in a sentence."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from cognitivedrone.errors import TrainingError
from cognitivedrone.training.trainer.checkpoint import FORMAT, read_checkpoint, restore, save_checkpoint, step_of

FACTS = {"step": 7, "recipe": {"name": "debug", "network": {"blocks": 1}}, "vocabulary": ["<pad>", "é"]}


def network(width: int = 4) -> nn.Module:
    return nn.Sequential(nn.Linear(3, width), nn.BatchNorm1d(width), nn.Linear(width, 1))


def optimizer_of(made: nn.Module) -> torch.optim.Optimizer:
    return torch.optim.AdamW(made.parameters(), 0.01, fused=True)


def step(made: nn.Module, optimizer: torch.optim.Optimizer, seed: int) -> float:
    draw = torch.Generator().manual_seed(seed)
    loss = (made(torch.randn(8, 3, generator=draw)) - 1).pow(2).mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    return float(loss.detach())


@pytest.fixture
def saved(tmp_path: Path) -> tuple[Path, nn.Module, torch.optim.Optimizer]:
    torch.manual_seed(0)
    made = network()
    optimizer = optimizer_of(made)
    for seed in range(3):
        step(made, optimizer, seed)
    path = tmp_path / "checkpoint.safetensors"
    save_checkpoint(path, made, optimizer, FACTS)
    return path, made, optimizer


def test_a_training_goes_on_from_a_checkpoint_as_if_it_had_not_stopped(
    saved: tuple[Path, nn.Module, torch.optim.Optimizer],
) -> None:
    path, made, optimizer = saved
    tensors, facts = read_checkpoint(path)
    assert facts == {"format": FORMAT, **FACTS}
    torch.manual_seed(99)
    other = network()
    other_optimizer = optimizer_of(other)
    restore(tensors, other, other_optimizer)
    for seed in range(3, 6):
        assert step(made, optimizer, seed) == step(other, other_optimizer, seed)
    for name, value in made.state_dict().items():
        assert torch.equal(value, other.state_dict()[name]), name


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("optimizer.0.exp_avg", torch.full((4, 3), float("inf")), "optimizer.0.exp_avg has impossible numbers"),
        ("optimizer.0.exp_avg_sq", -torch.ones(4, 3), "optimizer.0.exp_avg_sq has impossible numbers"),
        ("optimizer.0.exp_avg_sq", torch.full((4, 3), float("nan")), "optimizer.0.exp_avg_sq has impossible numbers"),
        ("optimizer.0.step", torch.tensor(-1.0), "optimizer.0.step has impossible numbers"),
        ("optimizer.0.exp_avg", torch.ones(1), "optimizer.0.exp_avg is (1,) of torch.float32, not (4, 3) of floats"),
        ("optimizer.0.exp_avg", torch.ones(4, 3).int(), "not (4, 3) of floats"),
        ("optimizer.0.\x1b[2J", torch.ones(4, 3), "optimizer.0 has \\x1b[2J, exp_avg"),
        ("optimizer.0.exp_avg_sq", None, "optimizer.0 has exp_avg, step, not step, exp_avg, exp_avg_sq"),
        ("optimizer.99.step", torch.tensor(1.0), "has 'optimizer.99.step', which is of no weight"),
        ("optimizer.-1.step", torch.tensor(1.0), "which is of no weight"),
        ("optimizer.x", torch.tensor(1.0), "has 'optimizer.x', which is of no weight"),
        ("optimizer.x.exp_avg", torch.tensor(1.0), "has 'optimizer.x.exp_avg', which is of no weight"),
        ("optimizer.0", torch.tensor(1.0), "optimizer.0 has a nameless tensor, exp_avg, exp_avg_sq, step, not step"),
    ],
)
def test_a_state_that_the_optimiser_cannot_have_is_refused(
    saved: tuple[Path, nn.Module, torch.optim.Optimizer], name: str, value: torch.Tensor | None, says: str
) -> None:
    tensors, _ = read_checkpoint(saved[0])
    if value is None:
        del tensors[name]
    else:
        tensors[name] = value
    made = network()
    with pytest.raises(TrainingError) as refused:
        restore(tensors, made, optimizer_of(made))
    assert says in str(refused.value)
    assert str(refused.value).endswith("take an earlier checkpoint, or train anew in another folder")


@pytest.mark.parametrize("step", [None, "1", -1, 10**12, True, 1.5, [1]])
def test_a_step_that_cannot_be_is_refused(step: object) -> None:
    assert step_of({"step": 10}, 10) == 10
    with pytest.raises(TrainingError, match="not one from 0 to 10"):
        step_of({"step": step}, 10)


def test_weights_that_lie_channels_last_in_memory_go_on_the_same(tmp_path: Path) -> None:
    def parts(seed: int) -> tuple[nn.Module, torch.optim.Optimizer]:
        torch.manual_seed(seed)
        made = nn.Conv2d(4, 6, 3).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return made, optimizer_of(made)

    def one_step(made: nn.Module, optimizer: torch.optim.Optimizer, seed: int) -> None:
        draw = torch.Generator().manual_seed(seed)
        for parameter in made.parameters():
            parameter.grad = torch.empty_like(parameter).copy_(torch.randn(parameter.shape, generator=draw))
        optimizer.step()

    made, optimizer = parts(0)
    one_step(made, optimizer, 0)
    path = tmp_path / "checkpoint.safetensors"
    save_checkpoint(path, made, optimizer, FACTS)
    other, other_optimizer = parts(1)
    restore(read_checkpoint(path)[0], other, other_optimizer)
    for seed in (1, 2):
        one_step(made, optimizer, seed)
        one_step(other, other_optimizer, seed)
    assert torch.equal(torch.as_tensor(made.weight), torch.as_tensor(other.weight))
    assert other.weight.stride() == made.weight.stride()


def test_the_learning_rate_is_the_optimizer_s_own(saved: tuple[Path, nn.Module, torch.optim.Optimizer]) -> None:
    other = network()
    optimizer = torch.optim.AdamW(other.parameters(), 0.5)
    restore(read_checkpoint(saved[0])[0], other, optimizer)
    assert optimizer.param_groups[0]["lr"] == 0.5


def test_a_checkpoint_replaces_the_one_before_and_leaves_nothing_beside(
    saved: tuple[Path, nn.Module, torch.optim.Optimizer],
) -> None:
    path, made, optimizer = saved
    save_checkpoint(path, made, optimizer, {**FACTS, "step": 8})
    assert read_checkpoint(path)[1]["step"] == 8
    assert list(path.parent.iterdir()) == [path]


# ---- what is refused


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: None, r"file: no such checkpoint"),
        (Path.mkdir, "not a whole checkpoint"),
        (os.mkfifo, "it is a pipe, not a file"),
    ],
    ids=["nothing", "a folder", "a pipe"],
)
def test_what_is_no_file(tmp_path: Path, make: Callable[[Path], None], says: str) -> None:
    make(tmp_path / "file")
    with pytest.raises(TrainingError, match=says):
        read_checkpoint(tmp_path / "file")


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.99])
def test_a_file_that_was_cut(saved: tuple[Path, nn.Module, object], share: float) -> None:
    path = saved[0]
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(TrainingError, match=r"not a whole checkpoint .*delete it or take an earlier one"):
        read_checkpoint(path)


@pytest.mark.parametrize("metadata", [None, {"format": "pt"}, {"cognitivedrone": "no JSON"}])
def test_somebody_else_s_safetensors(tmp_path: Path, metadata: dict[str, str] | None) -> None:
    path = tmp_path / "other.safetensors"
    save_file({"weight": torch.zeros(2)}, path, metadata=metadata)
    with pytest.raises(TrainingError, match="but not a checkpoint of this project"):
        read_checkpoint(path)


@pytest.mark.parametrize("facts", [{"format": FORMAT + 1}, {}])
def test_another_format(saved: tuple[Path, nn.Module, object], facts: dict[str, int]) -> None:
    path = saved[0]
    save_file(load_file(path), path, metadata={"cognitivedrone": json.dumps(facts)})
    with pytest.raises(TrainingError, match=f"of format {facts.get('format')}; this version reads {FORMAT}"):
        read_checkpoint(path)


def test_another_network(saved: tuple[Path, nn.Module, object]) -> None:
    tensors, _ = read_checkpoint(saved[0])
    with pytest.raises(TrainingError, match=r"of another network: .*size mismatch for 2\.weight"):
        restore(tensors, network(width=5), None)
    with pytest.raises(TrainingError, match="of another network"):
        restore(tensors, nn.Linear(3, 4), None)
    del tensors["network.0.weight"]
    with pytest.raises(TrainingError, match="of another network"):
        restore(tensors, network(), None)


def test_a_changed_number_is_found(saved: tuple[Path, nn.Module, object]) -> None:
    path = saved[0]
    whole = path.read_bytes()
    for at in range(len(whole) - 1, 0, -(len(whole) // 50)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(TrainingError, match=r"not a whole checkpoint|no.* checkpoint of this project"):
            read_checkpoint(path)


def test_a_checkpoint_of_an_older_version_is_read(saved: tuple[Path, nn.Module, object]) -> None:
    path = saved[0]
    save_file(load_file(path), path, metadata={"cognitivedrone": json.dumps({"format": FORMAT, **FACTS})})
    assert read_checkpoint(path)[1] == {"format": FORMAT, **FACTS}


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        ({}, "step is missing"),
        ({"step": "x"}, "step must be a whole number"),
        ({"step": True}, "step must be a whole number"),
        ({"step": 1, "format": True}, "checkpoint of format True"),
    ],
)
def test_facts_of_another_form_are_told_in_one_sentence(tmp_path: Path, facts: dict[str, object], reason: str) -> None:
    path = tmp_path / "checkpoint.safetensors"
    save_checkpoint(path, network(), None, facts)
    with pytest.raises(TrainingError, match=reason):
        read_checkpoint(path)
