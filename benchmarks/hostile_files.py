"""Hostile files of every format that is read: damaged, of wrong types, bombs, links and devices in place of files.

Run: python benchmarks/hostile_files.py [--mutants 20] [--pictures 20000] [--only KIND ...] [--out FILE]

A file holds if it is read, or refused in one printable sentence, within 60 s and 1 GiB of memory more; and if nothing
of it runs, and no file outside its folder is opened or overwritten. Prints a table; exit code 1 if anything fell.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import json
import os
import resource
import shutil
import signal
import struct
import sys
import tempfile
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import ExifTags, Image

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.cli import main as command
from cognitivedrone.data.formats import export, import_
from cognitivedrone.data.store import Store
from cognitivedrone.data.summary import summary
from cognitivedrone.data.verify import verify
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.labels.images import read_image
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.tasks import load_suite, task_to_json
from cognitivedrone.tasks.format import read_tasks

LONGEST_S = 60
MEMORY = 2**30
"""Bytes that a file may take beyond what the process has."""
SECRET = b"what is outside must not be read"
Reader: TypeAlias = Callable[[Path], object]
Change: TypeAlias = Callable[[Path], object]
WEIGHTS = Path(sys.modules["cognitivedrone.models"].__path__[0]) / "weights"


@dataclass(frozen=True)
class Attack:
    """One hostile file, or folder."""

    kind: str
    name: str
    run: Callable[[Path], str]
    """In a folder of its own; returns why the package fell, in a sentence, or an empty text if it held."""

    def held(self) -> bool:
        """Run it in a temporary folder."""
        with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
            return not outcome(self, Path(folder))


def outcome(attack: Attack, folder: Path) -> str:
    """Why the package fell, or an empty text."""
    secret = folder / "secret"
    secret.write_bytes(SECRET)
    (work := folder / "work").mkdir()
    try:
        with limits():
            fell = attack.run(work)
    except MemoryError:
        fell = f"more than {MEMORY:,} bytes of memory"
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        fell = f"{type(error).__name__}: {str(error)[:100]!r} ({Path(last.filename).name}, line {last.lineno})"
    return fell or ("" if secret.read_bytes() == SECRET else "a file outside was overwritten")


def apart(attack: Attack, folder: Path) -> str:
    """`outcome` in a process of its own, so that one that crashes falls alone."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        with open(writer, "w") as answer:  # noqa: PTH123 - of a descriptor
            answer.write(outcome(attack, folder))
        os._exit(0)
    os.close(writer)
    with open(reader) as answer:  # noqa: PTH123
        why = answer.read()
    _, status = os.waitpid(child, 0)
    return why or (f"its process ended with status {status}" if status else "")


class TooLong(BaseException):
    """It keeps the program busy."""


@contextlib.contextmanager
def limits() -> Iterator[None]:
    """Time and memory of one attack."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise TooLong(f"busy for more than {LONGEST_S} s")

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before, (soft, hard) = signal.signal(signal.SIGALRM, stop), resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))
    signal.alarm(LONGEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGALRM, before)


def read(reader: Reader, path: Path) -> str:
    """Why reading a file fells the package; an empty text if it is read, or refused in one sentence."""
    try:
        with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            reader(path)
    except CognitiveDroneError as error:
        text = str(error)
        if "\n" in text or len(text) > 3000:
            return f"not one sentence: {text[:80]!r}"
        return "the secret was told" if SECRET.decode() in text else ""
    return ""


# ---- what is read


@functools.cache
def sound() -> Path:
    """A small data set in every format, a model, tasks."""
    folder = Path(tempfile.mkdtemp(prefix="hostile-sound-"))
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        command(["collect", "--recipe", "debug", "--episodes", "2", "--out", str(folder / "store")])
    store = Store.open(folder / "store")
    for form in ("lerobot", "rlds", "mcap", "published"):
        export(store.labelled(), form, folder / form)
    (folder / "model").mkdir()
    shutil.copy(WEIGHTS / "small.onnx", folder / "model" / "small.onnx")
    tasks = [task_to_json(task) for track in load_suite("open-v1:smoke").tracks[:4] for task in track]
    (folder / "tasks").mkdir()
    (folder / "tasks" / "tasks.json").write_text(json.dumps(tasks))
    return folder


def _store(path: Path) -> None:
    problems = verify(path)
    summary(path)
    for _ in Store.open(path).labelled():
        pass
    if not problems:
        return


def _imported(path: Path, form: str) -> None:
    for _ in import_(path, form):
        pass


def _written(path: Path, text: str) -> None:
    path.write_text(text)


READERS: Mapping[str, Reader] = {
    "store": _store,
    **{form: functools.partial(_imported, form=form) for form in ("lerobot", "rlds", "mcap", "published")},
    "model": lambda path: SmallModel.load(path / "small.onnx"),
    "tasks": lambda path: read_tasks(path / "tasks.json"),
}


# ---- damage that any file can have


def _damages() -> Mapping[str, Change]:
    def cut(share: float) -> Change:
        return lambda path: path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])

    def link(target: str) -> Change:
        def change(path: Path) -> None:
            path.unlink()
            path.symlink_to(target)

        return change

    def instead(make: Change) -> Change:
        def change(path: Path) -> None:
            path.unlink()
            make(path)

        return change

    def sparse(path: Path) -> None:
        os.truncate(path, 300 * 2**30)

    return {
        "empty": lambda path: path.write_bytes(b""),
        "cut to a quarter": cut(0.25),
        "cut to a half": cut(0.5),
        "cut by a little": cut(0.99),
        "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
        "no UTF-8": lambda path: path.write_bytes(b"\xff\xfe\x00" * 1000),
        "twice": lambda path: path.write_bytes(2 * path.read_bytes()),
        "300 GiB of nothing behind it": sparse,
        "a pipe": instead(os.mkfifo),
        "a folder": instead(Path.mkdir),
        "absent": Path.unlink,
        "a device": link("/dev/zero"),
        "a link to itself": lambda path: link(path.name)(path),
        "a link to what is secret": lambda path: link(os.path.relpath(sound_secret(path), path.parent))(path),
    }


def sound_secret(path: Path) -> Path:
    """The secret beside an attack's folder; written there by who runs the attack without one."""
    found = next((parent / "secret" for parent in path.parents if (parent / "secret").exists()), None)
    if found is None:
        found = path.parents[2] / "secret"
        found.write_bytes(SECRET)
    return found


def _damaged(kind: str, file: str, change: Change) -> Callable[[Path], str]:
    def run(folder: Path) -> str:
        shutil.copytree(sound() / kind, folder / kind)
        change(folder / kind / file)
        return read(READERS[kind], folder / kind)

    return run


def _mutated(kind: str, file: str, seed: int) -> Callable[[Path], str]:
    return _damaged(kind, file, functools.partial(mutate, rng=np.random.default_rng([seed, zlib.crc32(file.encode())])))


def mutate(path: Path, rng: np.random.Generator) -> None:
    """Change bits, bytes or blocks of a file; one of four ways."""
    content = bytearray(path.read_bytes())
    way = rng.integers(4)
    for _ in range(rng.integers(1, 9)):
        at = int(rng.integers(max(len(content), 1)))
        if way == 0:
            content[at] ^= 1 << int(rng.integers(8))
        elif way == 1:
            content[at : at + 4] = rng.choice([0, 255, 127, 128], 4).astype(np.uint8).tobytes()
        elif way == 2:
            del content[at : at + int(rng.integers(1, 64))]
        else:
            other = int(rng.integers(max(len(content), 1)))
            content[at:at] = content[other : other + int(rng.integers(1, 64))]
    path.write_bytes(content)


# ---- files that are made to harm


def _json(kind: str, file: str) -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Every value of a JSON file replaced by others."""
    values: tuple[Any, ...] = (
        None, True, -1, 10**400, 1e308, "", "../../secret", "/etc/passwd", [], {}, [[]], "\ud800",
    )  # fmt: skip

    def places(value: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        if way:
            yield way
        inner = value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(value, list) else ()
        for key, part in inner:
            yield from places(part, (*way, key))

    document = json.loads((sound() / kind / file).read_text())
    for number, way in enumerate(places(document)):
        for value in values[number % 3 :: 3]:

            def change(path: Path, way: tuple[Any, ...] = way, value: Any = value) -> None:
                whole = json.loads(path.read_text())
                part = whole
                for key in way[:-1]:
                    part = part[key]
                part[way[-1]] = value
                path.write_text(json.dumps(whole))

            yield f"{file}: {'.'.join(map(str, way))[:60]} is {str(value)[:20]!a}", _damaged(kind, file, change)
    for name, content in {
        "brackets": "[" * 200_000,
        "a huge number": '{"a": ' + "9" * 10_000 + "}",
        "NaN": '{"a": NaN}',
        "null": "null",
        "a list": "[]",
    }.items():
        yield f"{file}: {name}", _damaged(kind, file, functools.partial(_written, text=content))


def _parquet(kind: str, file: str) -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Parquet files of other columns, types and sizes."""

    def rewritten(change: Callable[[pa.Table], pa.Table]) -> Change:
        return lambda path: pq.write_table(change(pq.read_table(path)), path)

    names = pq.read_schema(sound() / kind / file).names
    for name in names:

        def without(table: pa.Table, name: str = name) -> pa.Table:
            return table.drop_columns([name])

        def typed(array: pa.Array, name: str = name) -> Callable[[pa.Table], pa.Table]:
            def change(table: pa.Table) -> pa.Table:
                values = pa.chunked_array([array]).take(pa.array([0] * len(table)))
                return table.set_column(table.column_names.index(name), name, values)

            return change

        yield f"{file}: no column {name}", _damaged(kind, file, rewritten(without))
        for what, array in {
            "of text": pa.array(["../../secret"]),
            "of nulls": pa.nulls(1),
            "of huge numbers": pa.array([2**62]),
            "of negative numbers": pa.array([-(2**62)]),
            "of empty lists": pa.array([[]], pa.list_(pa.float32())),
            "of structs": pa.array([{"bytes": None, "path": "../../secret"}]),
            "of NaN": pa.array([float("nan")]),
        }.items():
            yield f"{file}: column {name} {what}", _damaged(kind, file, rewritten(typed(array)))
    yield f"{file}: no rows", _damaged(kind, file, rewritten(lambda table: table.slice(0, 0)))

    def bomb(path: Path) -> None:
        table = pq.read_table(path)
        text = pa.DictionaryArray.from_arrays(pa.array([0] * len(table), pa.int32()), pa.array(["x" * 2**27]))
        pq.write_table(table.append_column("more", text), path, compression="zstd", store_schema=False)

    yield f"{file}: a bomb of many GiB", _damaged(kind, file, bomb)


def _tfrecords() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Records that declare sizes of their own."""
    file = next(path.name for path in (sound() / "rlds").rglob("*.tfrecord*"))
    where = str(next((sound() / "rlds").rglob("*.tfrecord*")).parent.relative_to(sound() / "rlds") / file)
    for length in (2**63, 2**40, 2**31, 0, 1):
        for checked in (True, False):

            def change(path: Path, length: int = length, checked: bool = checked) -> None:
                head = struct.pack("<Q", length)
                crc = struct.pack("<I", masked_crc32c(head) if checked else 0)
                path.write_bytes(head + crc + path.read_bytes()[12:])

            yield (
                f"a record of {length} bytes, {'with' if checked else 'without'} checksum",
                _damaged("rlds", where, change),
            )
    for name, body in {
        "a field of 2^60 bytes": b"\x0a" + b"\xff" * 8 + b"\x0f",
        "an endless number": b"\x08" + b"\xff" * 4000,
        "groups in groups": b"\x0b" * 100_000,
        "messages in messages": b"\x0a\x7f" * 60_000,
    }.items():

        def replace(path: Path, body: bytes = body) -> None:
            head = struct.pack("<Q", len(body))
            path.write_bytes(
                head + struct.pack("<I", masked_crc32c(head)) + body + struct.pack("<I", masked_crc32c(body))
            )

        yield name, _damaged("rlds", where, replace)


def masked_crc32c(data: bytes) -> int:
    """The checksum of a TFRecord."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    crc ^= 0xFFFFFFFF
    return ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF


def _bags() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """MCAP files and the YAML beside them."""
    yaml = next((sound() / "mcap").rglob("metadata.yaml")).relative_to(sound() / "mcap")
    bag = next((sound() / "mcap").rglob("*.mcap")).relative_to(sound() / "mcap")
    texts = {
        "code": "!!python/object/apply:os.system ['touch OWNED']",
        "laughs": "a: &a [x,x,x,x,x,x,x,x,x]\n"
        + "\n".join(f"{chr(98 + n)}: &{chr(98 + n)} [{','.join(['*' + chr(97 + n)] * 9)}]" for n in range(9)),
        "brackets": "[" * 100_000,
        "numbers": "rosbag2_bagfile_information: 7",
    }
    for name, text in texts.items():
        yield f"metadata.yaml: {name}", _damaged("mcap", str(yaml), functools.partial(_written, text=text))

    def renamed(path: Path, name: str) -> None:
        path.write_text(path.read_text().replace(bag.name, name))

    for name in ("../../../secret", "/etc/passwd", "..", ""):
        change = functools.partial(renamed, name=name)
        yield f"metadata.yaml: names {name!r}", _damaged("mcap", str(yaml), change)
    for at, number in ((9, 2**63), (9, 2**40), (30, 2**62), (200, 2**62)):

        def sized(path: Path, at: int = at, number: int = number) -> None:
            content = bytearray(path.read_bytes())
            content[at : at + 8] = struct.pack("<Q", number)
            path.write_bytes(content)

        yield f"{bag.name}: {number} at byte {at}", _damaged("mcap", str(bag), sized)


def _tensors() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Safetensors files as checkpoints."""
    from cognitivedrone.training.trainer.checkpoint import read_checkpoint

    header: Any = {"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}
    changed: dict[str, Any] = {
        "a huge shape": {"a": {"dtype": "F32", "shape": [2**40, 2**20], "data_offsets": [0, 8]}},
        "an overflowing shape": {"a": {"dtype": "F32", "shape": [2**63, 2], "data_offsets": [0, 8]}},
        "a negative shape": {"a": {"dtype": "F32", "shape": [-2], "data_offsets": [0, 8]}},
        "offsets beyond the end": {"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 2**40]}},
        "offsets backwards": {"a": {"dtype": "F32", "shape": [2], "data_offsets": [8, 0]}},
        "an unknown type": {"a": {"dtype": "F31", "shape": [2], "data_offsets": [0, 8]}},
        "numbers for text": {"__metadata__": {"cognitivedrone": 7}, **header},
        "metadata of brackets": {"__metadata__": {"cognitivedrone": "[" * 100_000}, **header},
        "other metadata": {"__metadata__": {"cognitivedrone": '{"a": 1}'}, **header},
        "no metadata": header,
        "a path as name": {"../../secret": header["a"]},
        "nothing": {},
    }
    contents = {name: _safetensors(json.dumps(each).encode()) for name, each in changed.items()}
    contents |= {
        f"a header of {length} bytes": struct.pack("<Q", length) + b"{}" for length in (2**63, 2**40, 2**27, 0, 1, 2)
    }
    contents |= {"brackets": _safetensors(b"[" * 200_000), "no UTF-8": _safetensors(b"\xff" * 99), "empty": b""}
    readers: Mapping[str, Reader] = {"checkpoint": read_checkpoint}
    for what, reader in readers.items():
        for name, content in contents.items():

            def run(folder: Path, content: bytes = content, reader: Reader = reader) -> str:
                (folder / "file.safetensors").write_bytes(content)
                return read(reader, folder / "file.safetensors")

            yield f"{what}: {name}", run


def _safetensors(header: bytes) -> bytes:
    return struct.pack("<Q", len(header)) + header + bytes(8)


def _onnx() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """ONNX files that name other files, or sizes of their own."""
    import onnx

    def external(location: str, length: int) -> Change:
        def change(path: Path) -> None:
            model = onnx.load(str(path))
            tensor = model.graph.initializer[0]
            tensor.ClearField("raw_data")
            tensor.data_location = onnx.TensorProto.EXTERNAL
            for key, value in (("location", location), ("offset", "0"), ("length", str(length))):
                entry = tensor.external_data.add()
                entry.key, entry.value = key, value
            path.write_bytes(model.SerializeToString())

        return change

    for location in ("../../secret", "/etc/passwd", "/dev/zero", "small.onnx"):
        for length in (32, 2**40):
            yield f"weights in {location}, {length} bytes", _damaged("model", "small.onnx", external(location, length))

    def shaped(path: Path) -> None:
        model = onnx.load(str(path))
        model.graph.initializer[0].dims[:] = [2**31, 2**31]
        path.write_bytes(model.SerializeToString())

    def described(table: str) -> Change:
        def change(path: Path) -> None:
            model = onnx.load(str(path))
            for entry in model.metadata_props:
                entry.value = table
            path.write_bytes(model.SerializeToString())

        return change

    yield "a tensor of 2^62 numbers", _damaged("model", "small.onnx", shaped)
    for name, table in {"brackets": "[" * 200_000, "a number": "7", "nothing": "", "an object": "{}"}.items():
        yield f"a description of {name}", _damaged("model", "small.onnx", described(table))


def _commands() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """`collect` and `train` with input that they must refuse."""

    def run_with(*words: str, make: Change = lambda folder: None) -> Callable[[Path], str]:
        def run(folder: Path) -> str:
            make(folder)
            here, out, err = Path.cwd(), io.StringIO(), io.StringIO()
            os.chdir(folder)
            code: Any = 0
            try:
                with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                    command([*words])
            except SystemExit as end:
                code = end.code
            finally:
                os.chdir(here)
            if code != 2 or "Traceback" in err.getvalue():
                return f"exit code {code}: {err.getvalue()[-150:]!r}"
            return ""

        return run

    def other(folder: Path) -> None:
        (folder / "there").mkdir()
        (folder / "there" / "thesis.txt").write_text("mine")
        (folder / "file").write_text("[]")
        (folder / "link").symlink_to("nowhere")
        (folder / "labels").mkdir()

    collects: dict[str, tuple[str, ...]] = {
        "no episodes": ("--episodes", "0"),
        "negative episodes": ("--episodes", "-1"),
        "too many episodes": ("--suite", "open-v1:smoke", "--episodes", "100"),
        "a test suite": ("--suite", "open-v2:words"),
        "an unknown suite": ("--suite", "open-v9:x"),
        "an unknown recipe": ("--recipe", "nothing"),
        "an unknown policy": ("--policy", "nobody"),
        "beta above 1": ("--policy", "hover", "--beta", "2"),
        "beta NaN": ("--policy", "hover", "--beta", "nan"),
        "tasks that are none": ("--tasks", "file"),
        "tasks that are a broken link": ("--tasks", "link"),
        "labels without images": ("--labels", "labels"),
        "labels that are a file": ("--labels", "file"),
        "negative workers": ("--workers", "-3"),
        "a negative seed": ("--seed", "-1"),
    }
    for name, words in collects.items():
        short = () if "--episodes" in words else ("--episodes", "1")
        recipe = () if "--recipe" in words else ("--recipe", "debug")
        yield f"collect: {name}", run_with("collect", *recipe, *short, *words, "--out", "new", make=other)
    for out in ("there", "file", "link/deeper", "/dev/null", "/proc/new"):
        words = ("collect", "--recipe", "debug", "--episodes", "1", "--out", out)
        yield f"collect: --out {out}", run_with(*words, make=other)
    trains: dict[str, tuple[str, ...]] = {
        "an unknown recipe": ("--recipe", "nothing"),
        "negative steps": ("--recipe", "debug", "--steps", "-1"),
        "data that are none": ("--recipe", "debug", "--data", "there"),
        "a start that is none": ("--recipe", "debug", "--start", "file"),
        "a recipe without data": ("--recipe", "reader", "--data", "there"),
        "a file as --out": ("--recipe", "debug", "--out", "file"),
    }
    for name, words in trains.items():
        out_words = () if "--out" in words else ("--out", "new")
        yield f"train: {name}", run_with("train", *words, *out_words, make=other)


# ---- pictures


def pictures(count: int, seed: int) -> Counter[str]:
    """How mutated label images ended; an entry other than `read` and `refused` is a fall."""
    found: Counter[str] = Counter()
    originals = [*_pictures()]
    with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
        for number in range(count):
            rng = np.random.default_rng([seed, number])
            suffix, content = originals[number % len(originals)]
            path = Path(folder) / f"picture{suffix}"
            path.write_bytes(content)
            mutate(path, rng)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    read_image(path)
                found["read"] += 1
            except CognitiveDroneError:
                found["refused"] += 1
            except Exception as error:
                found[f"{type(error).__name__}: {str(error)[:60]}"] += 1
    return found


def _pictures() -> Iterator[tuple[str, bytes]]:
    """Small images with EXIF in each format."""
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    exif[ExifTags.Base.XResolution] = 72.0
    exif[ExifTags.Base.ImageDescription] = "a cat"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.UserComment] = b"ASCII\0\0\0cat"
    picture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (12, 16, 3), np.uint8))
    for suffix, options in ((".png", {}), (".jpg", {}), (".webp", {}), (".webp", {"lossless": True})):
        content = io.BytesIO()
        picture.save(content, {".png": "PNG", ".jpg": "JPEG", ".webp": "WEBP"}[suffix], exif=exif, **options)
        yield suffix, content.getvalue()
    content = io.BytesIO()
    picture.convert("P").save(content, "PNG", transparency=3, exif=exif)
    yield ".png", content.getvalue()


def attacks(mutants: int = 5, seed: int = 0) -> list[Attack]:
    """All of them, with so many random mutants of every file."""
    found: list[Attack] = []
    for kind in READERS:
        files = sorted(str(path.relative_to(sound() / kind)) for path in (sound() / kind).rglob("*") if path.is_file())
        if kind == "published":  # many pictures are alike
            files = [file for file in files if not file.endswith(".jpg")] + [f for f in files if f.endswith(".jpg")][:1]
        if kind == "mcap":
            files = files[:2]
        for file in files:
            found += [Attack(kind, f"{file}: {name}", _damaged(kind, file, how)) for name, how in _damages().items()]
            found += [Attack(kind, f"{file}: mutant {n}", _mutated(kind, file, seed + n)) for n in range(mutants)]
            if file.endswith(".json"):
                found += [Attack(kind, name, run) for name, run in _json(kind, file)]
            if file.endswith(".parquet"):
                found += [Attack(kind, name, run) for name, run in _parquet(kind, file)]
    made = {"rlds": _tfrecords, "mcap": _bags, "safetensors": _tensors, "model": _onnx, "collect and train": _commands}
    for kind, make in made.items():
        found += [Attack(kind, name, run) for name, run in make()]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--mutants", type=int, default=20, help="random ones of every file")
    parser.add_argument("--pictures", type=int, default=20000, help="mutated label images")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=[], metavar="KIND")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    tried: Counter[str] = Counter()
    fell: Counter[str] = Counter()
    for attack in attacks(options.mutants, options.seed):
        if options.only and attack.kind not in options.only:
            continue
        tried[attack.kind] += 1
        with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
            if why := apart(attack, Path(folder)):
                fell[attack.kind] += 1
                print(f"FELL  {attack.kind}: {attack.name[:100]!r}: {why}", flush=True)
    if not options.only or "pictures" in options.only:
        found = pictures(options.pictures, options.seed)
        tried["pictures"] = found.total()
        fell["pictures"] = found.total() - found["read"] - found["refused"]
        for how in found.keys() - {"read", "refused"}:
            print(f"FELL  pictures: {how} ({found[how]} times)")
    rows = [{"kind": kind, "attacks": n, "held": n - fell[kind], "fell": fell[kind]} for kind, n in tried.items()]
    print(f"{'kind':20} attacks   held   fell")
    for row in rows:
        print(f"{row['kind']:20} {row['attacks']:7}{row['held']:7}{row['fell']:7}")
    print(f"{'all':20} {tried.total():7}{tried.total() - fell.total():7}{fell.total():7}")
    keep(options.out, "Hostile files, and what held", rows, seed=options.seed)
    sys.exit(1 if fell.total() else 0)


if __name__ == "__main__":
    main()
