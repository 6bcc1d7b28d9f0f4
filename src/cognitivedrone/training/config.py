"""The plans of `train` and `train-openvla`; the docstrings of the fields are their help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from cognitivedrone.plan import Options
from cognitivedrone.ranges import Count, Processes, Seed


@dataclass(frozen=True, slots=True)
class TrainPlan(Options):
    """Train a small model, or teach a trained one your own pictures and words."""

    out: Path
    """Folder of the run: checkpoint, curves.png, TensorBoard logs and, at the end, the model files."""
    recipe: str = "small"
    """teach, which teaches a trained pilot the pictures in --labels; reader, which reads panels; small, the policy,
    which flies with a reader; race or debug, other policies; language and flight, which train a policy's language
    or its flying further; places, which trains flying further in photographed places too; obstacles, the eye that
    sees what is in the way; selector, the small reasoner."""
    data: Path | None = None
    """A data set made by `collect`, used instead of flights made during training."""
    start: Path | None = None
    """Trained weights to start from: a checkpoint, a model file, the folder of a taught pilot, or "small" for the
    packaged ones, the default."""
    labels: Path | None = None
    """A folder of pictures such as my-labels/birds/robin.jpg, for recipe teach; one a concept is enough."""
    tasks: Path | None = None
    """A task file, or a folder of them, whose sentences are taught as well."""
    steps: Count | None = None
    """Steps, instead of the recipe's: fewer to try something, more where there is time."""
    seed: Seed = 0
    """Random seed."""
    resume: bool = False
    """Continue from the checkpoint in the folder."""
    processes: Processes = field(default=1, metadata={"command": "never"})
    """Processes that share each batch: the number of CPU cores, or of GPUs."""
    threads: Processes = 1
    """CPU threads per process."""


@dataclass(frozen=True, slots=True)
class FineTunePlan(Options):
    """Fine-tune OpenVLA-7B."""

    base: Path
    """Folder of the base checkpoint: config.json, tokenizer.json, *.safetensors."""
    data: Path
    """A data set made by `collect` or `data import`."""
    out: Path
    """Folder of the run: checkpoint, metrics.jsonl, curves.png, TensorBoard logs and, at the end, merged/."""
    recipe: str = "paper"
    """paper, race or debug."""
    seed: Seed = 0
    """Random seed."""
    resume: bool = False
    """Continue from the checkpoint in the folder."""
    micro_batch: Count | None = None
    """Samples at once on each GPU, by default as many as are fastest in its free memory; fewer need less."""
    shard: bool = False
    """Shard the weights over the GPUs instead of copying them to each."""
    key: str = "cognitivedrone"
    """Name of the action statistics in the checkpoint."""
    merge: bool = False
    """Do not train; merge the adapters of the folder's checkpoint."""
