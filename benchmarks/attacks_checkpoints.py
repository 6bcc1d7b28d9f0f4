"""Attacks by checkpoints of LeRobot, of OpenVLA and of trainings that are resumed."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from attack_tools import MARK, SMOKE, Attack, each, refused_in, taken, told
from attacks_files import ODD


def attacks() -> list[Attack]:
    """All of them."""
    return [
        *each("checkpoints of LeRobot", dict(_lerobot())),
        *each("checkpoints of OpenVLA", dict(_openvla())),
        *each("states of optimisers", dict(_optimisers())),
    ]


def _lerobot() -> Iterator[tuple[str, Callable[[Path], str]]]:
    image = {"type": "VISUAL", "shape": [3, 256, 256]}
    ours = {"input_features": {"observation.images.front": image}, "output_features": {"action": {"shape": [4]}}}
    contents: dict[str, bytes] = {f"config.json: {name}": content for name, content in ODD.items()}
    shapes: dict[str, Any] = {
        "a shape that is a number": 7, "a shape of text": "(4,)", "a shape of lists": [[4]], "a shape of 10^9": [10**9],
    }  # fmt: skip
    for name, shape in shapes.items():
        changed = ours | {"output_features": {"action": {"shape": shape}}}
        contents[f"config.json: {name}"] = json.dumps(changed).encode()
    contents["config.json: a type that is code"] = json.dumps(ours | {"type": f"os:system:touch {MARK}"}).encode()
    contents["config.json: a feature named by an escape"] = json.dumps(
        ours | {"input_features": {"\x1b[2J" * 9: {"shape": [1]}}}
    ).encode()
    contents["config.json: 40 MB"] = b'{"x": "' + b"a" * 40_000_000 + b'"}'

    def write(folder: Path, content: bytes) -> None:
        (folder / "ck").mkdir()
        for file in ("model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json"):
            (folder / "ck" / file).write_bytes(b"{}")
        (folder / "ck" / "config.json").write_bytes(content)

    words = ("bench", *SMOKE, "--policy", "lerobot:ck")
    for name, content in contents.items():
        yield name, refused_in(lambda folder, content=content: write(folder, content), *words)
    yield "a pickle in place of the weights", refused_in(_pickled, *words)


def _pickled(folder: Path) -> None:
    """A checkpoint of pickles alone, which would run code if it were opened."""
    (folder / "ck").mkdir()
    for file in ("config.json", "pytorch_model.bin", "policy_preprocessor.json", "policy_postprocessor.json"):
        (folder / "ck" / file).write_bytes(f"cos\nsystem\n(S'touch {MARK}'\ntR.".encode())


def _openvla() -> Iterator[tuple[str, Callable[[Path], str]]]:
    words = ("train-openvla", "--base", "base", "--data", "set", "--out", "run")
    for name, content in ODD.items():

        def write(folder: Path, content: bytes = content) -> None:
            (folder / "base").mkdir()
            (folder / "base" / "config.json").write_bytes(content)
            (folder / "base" / "tokenizer.json").write_bytes(content)
            (folder / "base" / "model.safetensors").write_bytes(content)

        yield f"train-openvla: {name}", refused_in(write, *words)
        yield f"openvla: {name}", refused_in(write, "bench", *SMOKE, "--policy", "openvla:base")
    yield "train-openvla: a pickle", refused_in(lambda folder: _pickled(folder), *words[:2], "ck", *words[3:])
    yield "train-openvla: nothing there", refused_in(lambda _folder: None, *words)


def _optimisers() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """A checkpoint whose checksum is right and whose optimiser's state is not."""
    import torch
    from safetensors.torch import load_file, save_file

    from cognitivedrone.models.checksum import BLANK, seal
    from cognitivedrone.training.trainer.checkpoint import (
        FORMAT,
        read_checkpoint,
        restore,
        save_checkpoint,
        step_of,
    )

    def parts() -> tuple[torch.nn.Module, torch.optim.Optimizer]:
        network = torch.nn.Linear(3, 2)
        optimizer = torch.optim.AdamW(network.parameters(), 0.01)
        network(torch.ones(1, 3)).sum().backward()
        optimizer.step()
        return network, optimizer

    def resumed(change: Callable[[dict[str, Any], dict[str, Any]], object]) -> Callable[[Path], object]:
        def act(folder: Path) -> object:
            path = folder / "checkpoint.safetensors"
            facts: dict[str, Any] = {"step": 1, "recipe": {"name": "debug"}, "seed": 0}
            save_checkpoint(path, *parts(), facts)
            tensors = load_file(path)
            change(tensors, facts)
            about = json.dumps({"format": FORMAT, **facts})
            save_file(tensors, path, metadata={"cognitivedrone": about, "checksum": BLANK})
            seal(path)
            network, optimizer = parts()
            found, read = read_checkpoint(path)
            step = step_of(read, 10)
            restore(found, network, optimizer)
            optimizer.step()
            return step

        return act

    huge, minus = torch.full((2, 3), float("inf")), -torch.ones(2, 3)
    changes: dict[str, Callable[[dict[str, Any], dict[str, Any]], object]] = {
        "moments that are infinite": lambda t, _: t.update({"optimizer.0.exp_avg": huge}),
        "moments that are no numbers": lambda t, _: t.update({"optimizer.0.exp_avg": huge * 0}),
        "squares below 0": lambda t, _: t.update({"optimizer.0.exp_avg_sq": minus}),
        "a step below 0": lambda t, _: t.update({"optimizer.0.step": torch.tensor(-5.0)}),
        "moments of another shape": lambda t, _: t.update({"optimizer.0.exp_avg": torch.ones(3)}),
        "moments that would be spread": lambda t, _: t.update({"optimizer.0.exp_avg": torch.ones(1)}),
        "moments of integers": lambda t, _: t.update({"optimizer.0.exp_avg": torch.ones(2, 3).int()}),
        "no squares": lambda t, _: t.pop("optimizer.0.exp_avg_sq"),
        "a moment too many": lambda t, _: t.update({"optimizer.0.momentum_buffer": torch.ones(2, 3)}),
        "a moment named by an escape": lambda t, _: t.update({"optimizer.0.\x1b[2J": torch.ones(2, 3)}),
        "a weight that there is not": lambda t, _: t.update({"optimizer.99.step": torch.tensor(1.0)}),
        "a weight below 0": lambda t, _: t.update({"optimizer.-1.step": torch.tensor(1.0)}),
        "a weight of 5,000 digits": lambda t, _: t.update({f"optimizer.{'9' * 5000}.step": torch.tensor(1.0)}),
        "a weight that is a word": lambda t, _: t.update({"optimizer.x.step": torch.tensor(1.0)}),
        "a name cut short": lambda t, _: t.update({"optimizer.0": torch.tensor(1.0)}),
        "weights of another shape": lambda t, _: t.update({"network.weight": torch.ones(9, 9)}),
        "no step": lambda _, facts: facts.pop("step"),
        "a step that is text": lambda _, facts: facts.update(step="1"),
        "a step past the last": lambda _, facts: facts.update(step=10**12),
        "a step before the first": lambda _, facts: facts.update(step=-1),
        "a step that is true": lambda _, facts: facts.update(step=True),
    }
    for name, change in changes.items():
        yield f"checkpoint: {name}", told(resumed(change))
    yield "checkpoint: as it was", taken(resumed(lambda _, __: None))
