"""Files are opened by `cognitivedrone.files` alone, and no pipe, device or sparse file hangs a reader of any kind."""

import ast
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import cognitivedrone
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

SOURCE = Path(cognitivedrone.__file__).parent
ALLOWED: dict[str, frozenset[str]] = {
    name: frozenset(calls.split(", "))
    for name, calls in {
        # The one place.
        "files/__init__.py": "open, os.open, os.unlink, shutil.rmtree, temporary.unlink, path.unlink, whole.unlink",
        # Devices of the system, under names that nobody outside gives.
        "cli/__init__.py": "os.open",
        "cli/streams.py": "os.open, open",
        "system/__init__.py": "(root / 'proc/cpuinfo').read_text, (root / 'proc/device-tree/model').read_text, "
        "os.open, path.rmdir",  # a folder that is synced, and one that another takes the place of
        "training/trainer/training_task.py": "processor.read_text",
        "rollout/cards.py": "file.read_text",
        "vehicles/gazebo/bindings.py": "os.fdopen",  # of a pipe of its own
        "vehicles/mavlink/guard/process.py": "open",  # of an inherited file
        "system/interrupts.py": "os.open",
        # Locks of folders, and temporary folders of names that nobody foresees.
        "files/locks.py": "os.open, folder.rmdir, file.unlink",
        "files/temporary.py": "os.open, shutil.rmtree, beginning.rename, beginning.unlink, (folder / _OWNER).unlink",
        "benchmark/runs/records.py": "path.rmdir",
        # Files of this package, or of one that is installed beside it.
        "errors.py": "this.read_text",
        "data/formats/__init__.py": "file.read_text",
        "labels/extended.py": "(_FOLDER / name / 'manifest.json').read_bytes, zipfile.ZipFile",
        "labels/shipped.py": "(self._folder / 'manifest.json').read_bytes, Image.open",
        "play/server.py": "found.read_bytes",
        "training/language/wordings.py": "entry.read_text",
        "training/reasoner/classifier.py": "torch.load",
        "training/reasoner/selector_files.py": "(_folder() / 'tokenizer.json').read_bytes, load_file",
        # In a temporary folder of its own, of a name that nobody foresees.
        "rollout/process_pool.py": "crash_file.open, worker.crash_file.read_text",
        "training/processes.py": "written.write_text, file.read_text",
        "vehicles/gazebo/worlds/export.py": "path.read_text",
        # In memory.
        "training/perception/photographic.py": "PillowImage.open",
        # Shards, which are written beside their place, or checked before they are read.
        "data/shards.py": "pq.ParquetWriter, pq.ParquetFile",
        # Libraries that open files by their names: written beside, in a new folder, or checked
        # before they are read.
        "apps/log.py": "pq.write_table, av.open",
        "data/formats/lerobot.py": "pq.write_table, pq.ParquetWriter, pq.read_table, pq.read_schema, pq.read_metadata",
        "data/formats/lerobot_files.py": "av.open",
        "film/movie.py": "av.open",
        "models/onnx_file.py": "onnx.load, onnx.save, path.open",
        "models/openvla/weights.py": "safe_open, save_file",
        "training/small_vla/graph.py": "onnx.load, onnx.save",
        "training/trainer/eight_bits.py": "onnx.load, onnx.load",
        "training/trainer/checkpoint.py": "safe_open, save_file, figure.savefig",
        "vehicles/camera.py": "av.open",
    }.items()
}
"""What modules open by themselves, and why that is safe there."""

METHODS = frozenset(
    {"read_text", "read_bytes", "write_text", "write_bytes", "unlink", "rmdir", "rename", "touch", "savefig"}
)
"""Methods of paths, whatever they are called on."""
FUNCTIONS = frozenset(
    {"open", "os.open", "os.fdopen", "io.open", "io.FileIO", "os.remove", "os.unlink", "os.rename", "os.replace",
     "os.rmdir", "os.truncate", "shutil.rmtree", "shutil.copyfile", "shutil.copy", "shutil.copy2", "shutil.copytree",
     "shutil.move", "tempfile.mktemp", "tempfile.mkstemp", "np.load", "np.save", "np.savez", "np.fromfile",
     "np.loadtxt", "np.memmap", "torch.load", "torch.save"}
)  # fmt: skip
OF_LIBRARIES = frozenset(
    {"av.open", "pq.ParquetFile", "pq.ParquetWriter", "pq.read_table", "pq.read_schema", "pq.read_metadata",
     "pq.write_table", "safe_open", "save_file", "load_file", "onnx.load", "onnx.save", "zipfile.ZipFile",
     "Tokenizer.from_file", "tarfile.open"}
)  # fmt: skip
"""Functions of libraries that open what they are given by its name."""
PICTURES = frozenset({"Image", "PillowImage", "Pictures"})


def opened(source: str) -> Iterator[tuple[int, str]]:
    """Lines of calls that open, write or remove a file by its name, with what is called."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and (name := _suspect(node)):
            yield node.lineno, name


LAST = {name.rpartition(".")[2] for name in FUNCTIONS | OF_LIBRARIES | METHODS}


def _suspect(call: ast.Call) -> str:
    last = getattr(call.func, "attr", getattr(call.func, "id", ""))
    if last not in LAST:  # the whole name takes time
        return ""
    name = ast.unparse(call.func)
    if name in FUNCTIONS or name in OF_LIBRARIES:
        return name
    if isinstance(call.func, ast.Attribute) and last in METHODS:
        return "" if "resources.files(" in name else name  # a file of the package
    if last == "open" and name.rpartition(".")[0] in PICTURES:  # what is in memory has no name
        of = call.args[0]
        return "" if isinstance(of, ast.Call) and ast.unparse(of.func) in ("BytesIO", "io.BytesIO") else name
    if last == "open" and any(_is_mode(each) for each in (*call.args, *(each.value for each in call.keywords))):
        return name
    return ""


def _is_mode(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and set(node.value) <= set("rwaxbt+")


def test_only_one_module_opens_what_is_named_from_outside() -> None:
    found = {
        path.relative_to(SOURCE).as_posix(): list(opened(path.read_text(encoding="utf-8")))
        for path in sorted(SOURCE.rglob("*.py"))
    }
    others = [
        f"{name}:{line}: {call}"
        for name, calls in found.items()
        for line, call in calls
        if call not in ALLOWED.get(name, ())
    ]
    assert not others, "use cognitivedrone.files for what is named from outside:\n" + "\n".join(others)
    idle = {name: calls - {call for _, call in found.get(name, ())} for name, calls in ALLOWED.items()}
    assert not any(idle.values()), "these are not called any more; take them off the list"


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
