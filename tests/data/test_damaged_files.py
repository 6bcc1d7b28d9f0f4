"""A file of any format, damaged anywhere, is read or refused in one sentence."""

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from factory import make_episode
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_stores import write_store
from PIL import Image

from cognitivedrone.data.formats import export, import_
from cognitivedrone.data.store import Store
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.labels.images import read_image
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.tasks import load_suite, task_to_json
from cognitivedrone.tasks.format import read_tasks

FORMATS = ("lerobot", "rlds", "mcap", "published")
READERS: dict[str, Callable[[Path], object]] = {
    "store": lambda folder: [*Store.open(folder).labelled()],
    "model": lambda folder: SmallModel.load(folder / "tiny.onnx"),
    "tasks": lambda folder: read_tasks(folder / "tasks.json"),
    "pictures": lambda folder: [read_image(file) for file in folder.iterdir()],
}
CHANGES: dict[str, Callable[[bytearray, int, int], bytes]] = {
    "flip": lambda content, at, n: bytes([*content[:at], content[at] ^ 1 << n % 8, *content[at + 1 :]]),
    "ones": lambda content, at, n: bytes([*content[:at], *[255] * n, *content[at + n :]]),
    "remove": lambda content, at, n: bytes([*content[:at], *content[at + n :]]),
    "repeat": lambda content, at, n: bytes([*content[: at + n], *content[at:]]),
    "cut": lambda content, at, n: bytes(content[:at]),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory, tiny_model_file: Path) -> Path:
    """A folder of every kind."""
    folder = tmp_path_factory.mktemp("sound")
    flights = [make_episode(index, 2, encoding="png") for index in range(2)]
    for form in FORMATS:
        export([("train", flights[0]), ("val", flights[1])], form, folder / form)
    write_store(folder / "store", flights)
    for kind in ("model", "tasks", "pictures"):
        (folder / kind).mkdir()
    shutil.copy(tiny_model_file, folder / "model" / "tiny.onnx")
    tasks = [task_to_json(task) for track in load_suite("open-v1:smoke").tracks[:2] for task in track]
    (folder / "tasks" / "tasks.json").write_text(json.dumps(tasks))
    for suffix in ("png", "jpg", "webp"):
        Image.radial_gradient("L").resize((32, 24)).convert("RGB").save(folder / "pictures" / f"a.{suffix}")
    return folder


@pytest.mark.parametrize("kind", [*FORMATS, *READERS])
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_a_damaged_file_is_read_or_refused_in_one_sentence(sound: Path, tmp_path: Path, kind: str, data: st.DataObject):
    shutil.rmtree(tmp_path / kind, ignore_errors=True)
    shutil.copytree(sound / kind, tmp_path / kind)
    file = data.draw(st.sampled_from(sorted(path for path in (tmp_path / kind).rglob("*") if path.is_file())))
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        if content:
            at = data.draw(st.integers(0, len(content) - 1))
            content[:] = CHANGES[data.draw(st.sampled_from([*CHANGES]))](content, at, data.draw(st.integers(1, 64)))
    file.write_bytes(content)
    with contextlib.suppress(CognitiveDroneError):
        _ = [*import_(tmp_path / kind, kind)] if kind in FORMATS else READERS[kind](tmp_path / kind)
