"""LeRobot's own training on an export, and the flights of its checkpoint under `lerobot-eval`, `bench` and `serve`.

The training is far too short to pass a gate: it shows that the commands fit together, and nothing of a model.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from harness_flights import SERVE, SUITE, bench, compared, ends, flight, listening, run, versions_of

COLLECT = ("cognitivedrone", "collect", "--episodes", "20", "--seed", "3")
TRAIN = ("--policy.type=act", "--policy.chunk_size=8", "--steps=200", "--batch_size=2")
SMALL = (
    "--policy.n_action_steps=8",
    "--policy.dim_model=64",
    "--policy.n_heads=4",
    "--policy.dim_feedforward=128",
    "--policy.n_encoder_layers=1",
    "--policy.n_vae_encoder_layers=1",
    "--policy.optimizer_lr=1e-4",
    "--policy.pretrained_backbone_weights=null",
    "--policy.device=cpu",
    "--policy.push_to_hub=false",
    "--num_workers=0",
    "--log_freq=10",
    "--save_freq=200",
    "--seed=0",
)
"""Shortens the training, and keeps it from the model hub."""
FLIGHTS = 4
EVAL = ("lerobot-eval", "--env.type=cognitivedrone", f"--env.suite={SUITE}", "--seed=0")
EVAL_COUNT = (f"--eval.n_episodes={FLIGHTS}", "--eval.batch_size=1")
COUNT = ("--episodes", str(FLIGHTS))


def rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Measured with an ACT that is trained first."""
    facts = {"versions": versions_of("lerobot", "torch")}
    checkpoint = folder / "act" / "checkpoints" / "last" / "pretrained_model"
    yield {
        "what": f"`lerobot-train {' '.join(TRAIN)}` on an export of `{' '.join(COLLECT)}`",
        **facts,
        **_train(folder),
    }

    results = folder / "results.jsonl"
    run(*EVAL, *EVAL_COUNT, *_plugin(), f"--policy.path={checkpoint}", "--policy.device=cpu",
        f"--env.results={results}", f"--output_dir={folder / 'eval'}")  # fmt: skip
    lines = map(json.loads, results.read_text(encoding="utf-8").splitlines())
    theirs = [flight(line["episode"], line["stages"]) for line in lines]
    policy = f"lerobot:{checkpoint},device=cpu"
    ours = bench(folder / "bench", "--policy", policy, *COUNT)
    shown = " ".join([*EVAL, *EVAL_COUNT, *_plugin(), "--policy.path=CHECKPOINT"])
    yield {"what": f"`{shown}`", **facts, **compared(theirs, ours), "remarks": ends(theirs)}

    with listening(folder / "serve.log", *SERVE, "--policy", policy) as address:
        served = bench(folder / "served", "--policy", f"remote:ws://{address}", *COUNT)
    shown = f"cognitivedrone bench --policy remote:ws://... {' '.join(COUNT)}"
    what = f"`{shown}` against `cognitivedrone serve --policy lerobot:CHECKPOINT`"
    yield {"what": what, **facts, **compared(served, ours), "remarks": ends(served)}


def _train(folder: Path) -> dict[str, Any]:
    run(*COLLECT, "--out", str(folder / "flights"))
    export = folder / "export"
    run("cognitivedrone", "data", "export", str(folder / "flights"), "--to", "lerobot", "--out", str(export))
    said = run(
        "lerobot-train",
        "--dataset.repo_id=local/drone",
        f"--dataset.root={export}",
        f"--output_dir={folder / 'act'}",
        *TRAIN,
        *SMALL,
    )
    losses = [float(loss) for loss in re.findall(r"\bloss:([\d.]+)", said)]
    learnt = int(re.findall(r"\bnum_learnable_params=(\d+)", said)[0])
    return {"remarks": f"{learnt / 1e6:.1f} million parameters; loss {losses[0]:.1f} to {losses[-1]:.1f}"}


def _plugin() -> tuple[str, ...]:
    """LeRobot before 0.6 does not look for plug-ins of environments itself."""
    major, minor = map(int, version("lerobot").split(".")[:2])
    return ("--env.discover_packages_path=lerobot_env_cognitivedrone",) if (major, minor) < (0, 6) else ()
