"""What is named on the command line or lies in a folder of others: no pipe, device or sparse file hangs a reader."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from cognitivedrone.benchmark.measurements import read_measurement
from cognitivedrone.benchmark.runs.records import read_records
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.benchmark.submission_file import read_submission
from cognitivedrone.control.latency import parse_delays
from cognitivedrone.data.manifest import read_json, sha256_of
from cognitivedrone.data.shards import ShardFile
from cognitivedrone.data.store import Store
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.models.onnx_file import check_model_file
from cognitivedrone.models.openvla.checkpoint import inspect, read_header
from cognitivedrone.policies import policy_files
from cognitivedrone.policies.lerobot import read_config
from cognitivedrone.reasoners import reasoner_files
from cognitivedrone.reasoners.prompt import load_prompt
from cognitivedrone.reasoners.replay import read_answers
from cognitivedrone.serving.access import token_of
from cognitivedrone.tasks.format import read_tasks
from cognitivedrone.tasks.knowledge.tables import read_rows

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "answers": ("answers.jsonl", read_answers),
    "digest of answers": ("answers.jsonl", lambda file: reasoner_files(f"replay:{file}")),
    "digest of a model": ("model.onnx", lambda file: policy_files(f"small:{file}")),
    "latencies": ("times", lambda file: parse_delays(f"policy={file}")),
    "lerobot": ("config.json", lambda file: read_config(file.parent)),
    "lerobot weights": ("model.safetensors", read_header),
    "manifest": ("manifest.json", lambda file: Store.open(file.parent)),
    "measurement": ("measurement.json", read_measurement),
    "model": ("model.onnx", check_model_file),
    "openvla": ("config.json", lambda file: inspect(file.parent)),
    "prompt": ("prompt.txt", load_prompt),
    "facts": ("facts.csv", lambda file: read_rows(file, ("name",))),
    "records": ("episodes.jsonl", lambda file: read_records(file.parent)),
    "results": ("results.json", read_results),
    "shard": ("shard-00000.parquet", ShardFile),
    "shard's hash": ("shard-00000.parquet", sha256_of),
    "store's json": ("statistics.json", read_json),
    "submission": ("submission.json", read_submission),
    "tasks": ("tasks.json", read_tasks),
    "token": ("token", lambda file: token_of("127.0.0.1", file)),
}


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("make", [os.mkfifo, sparse, Path.mkdir, lambda path: path.symlink_to("/dev/zero")],
                         ids=["pipe", "sparse", "folder", "device"])  # fmt: skip
def test_it_is_refused_at_once_in_a_sentence(tmp_path: Path, reader: str, make: Callable[[Path], object]) -> None:
    name, read = READERS[reader]
    (tmp_path / "folder").mkdir()
    for other in ("model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json"):
        (tmp_path / "folder" / other).write_text("{}")
    path = tmp_path / "folder" / name
    path.unlink(missing_ok=True)
    make(path)
    with pytest.raises(CognitiveDroneError) as refused:
        read(path)
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)
