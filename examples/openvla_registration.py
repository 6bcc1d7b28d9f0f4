r"""Fine-tune OpenVLA on an RLDS export: registers our data set with OpenVLA's data loader, then runs its own script.

OpenVLA (https://github.com/openvla/openvla) knows arms: its loader takes 7 numbers an action, the last a gripper. Ours
are 4 velocities, all of them normalised by their 1st and 99th percentile. Nothing of OpenVLA is changed on disk; the
number of action tokens follows from the statistics that it saves with the model.

Run in a checkout of OpenVLA, in its own environment:

    cognitivedrone data export STORE --to rlds --out OUT
    torchrun --standalone --nnodes 1 --nproc-per-node 1 openvla_registration.py vla-scripts/finetune.py \
        --vla_path openvla/openvla-7b --data_root_dir OUT --dataset_name cognitivedrone --lora_rank 32
"""

from __future__ import annotations

import importlib
import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

NAME = "cognitivedrone"
ACTION_SIZE = 4
"""vx, vy, vz in m/s and yaw rate in rad/s, heading frame."""
MATERIALIZE = "prismatic.vla.datasets.rlds.oxe.materialize"


def dataset_kwargs(
    data_root_dir: Path | str,
    load_camera_views: tuple[str, ...] = ("primary",),
    load_depth: bool = False,
    load_proprio: bool = True,
    load_language: bool = True,
    action_proprio_normalization_type: Any = "bounds_q99",
) -> dict[str, Any]:
    """What to call OpenVLA's `make_dataset_from_rlds` with for our data set; takes what its own factory takes."""
    if tuple(load_camera_views) != ("primary",) or load_depth:
        raise ValueError(f"{NAME} has one colour camera, 'primary'; load_camera_views is {load_camera_views}")
    kwargs: dict[str, Any] = {
        "name": NAME,
        "data_dir": str(data_root_dir),
        "image_obs_keys": {"primary": "image"},
        "standardize_fn": unchanged,
        # No component is an absolute command like a gripper's, and all are normalised.
        "absolute_action_mask": [False] * ACTION_SIZE,
        "action_normalization_mask": [True] * ACTION_SIZE,
        "action_proprio_normalization_type": action_proprio_normalization_type,
    }
    if load_proprio:
        kwargs["state_obs_keys"] = ["state"]
    if load_language:
        kwargs["language_key"] = "language_instruction"
    return kwargs


def unchanged(trajectory: dict[str, Any]) -> dict[str, Any]:
    """Our trajectories are in the form that OpenVLA standardises others to."""
    return trajectory


def register(materialize: ModuleType) -> None:
    """Let OpenVLA's module `materialize` know the data set `cognitivedrone`; all others stay as they are."""
    theirs = materialize.make_oxe_dataset_kwargs

    def make_oxe_dataset_kwargs(dataset_name: str, *args: Any, **kwargs: Any) -> dict[str, Any]:
        if dataset_name == NAME:
            return dataset_kwargs(*args, **kwargs)
        made: dict[str, Any] = theirs(dataset_name, *args, **kwargs)
        return made

    materialize.make_oxe_dataset_kwargs = make_oxe_dataset_kwargs  # type: ignore[attr-defined]


def main(script: str, *arguments: str) -> None:
    """Run OpenVLA's script with the data set registered."""
    register(importlib.import_module(MATERIALIZE))
    sys.argv = [script, *arguments]
    sys.path.insert(0, str(Path(script).parent))
    runpy.run_path(script, run_name="__main__")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(*sys.argv[1:])
