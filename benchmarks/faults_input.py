"""What is let in: mutated task files and damaged weight files, each of which must be found before anything flies.

Run: python benchmarks/faults_input.py [--tasks 1000] [--weights 100] [--seed 0]

A task file is mutated in its JSON (keys and values) or in its bytes. It is either rejected with one sentence, by the
loader or by the check of its labels, or what would fly is exactly what the file says: every field is compared with an
independent reading of it, every panel is drawn, and the flight begins. A weight file is a packaged one, or one
that `describe` wrote, with bits, bytes, blocks or its description changed; it is found where it is refused at load.
"""

from __future__ import annotations

import argparse
import copy
import json
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from rich.table import Table

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import CognitiveDroneError, PolicyError
from cognitivedrone.labels import load_pack
from cognitivedrone.models.eyes.picture_classifier import PictureClassifier
from cognitivedrone.models.eyes.sight import EyesModel
from cognitivedrone.models.mind import Mind
from cognitivedrone.models.small_file import SmallModel, describe, read_description
from cognitivedrone.models.words.concepts import ConceptsModel
from cognitivedrone.models.words.selector_file import GateSelectorModel
from cognitivedrone.models.words.text_encoder import TextEncoderModel
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite, load_suite, task_to_json
from cognitivedrone.terminal import console

WEIGHTS = Path(sys.modules["cognitivedrone.models"].__path__[0]) / "weights"
Rng = np.random.Generator
Json = dict[str, Any]
Mutation: TypeAlias = Callable[[Rng, list[Json]], bytes]

VALUES: tuple[Any, ...] = (
    None, True, 0, 4, -1, 2**70, 1.5, float("nan"), "", " ", "x" * 5000, [], {}, [[]], "\ud800", "a\x1b[31mb", "a\x00b",
    "a\nb", "\u202ereversed", "\u200b", "[/f] [bold]", "../../etc/passwd", "/etc/passwd", "CON", "1", "red", "big",
    "animal/cat@noto", "animal/../../x", "no/such@label", "sum/1+1@inter", "several/animal/cat=99",
)  # fmt: skip
"""What a value is replaced by."""


# ---- task files


def task_files(count: int, seed: int, folder: Path) -> dict[str, Counter[str]]:
    """How mutated task files ended, by the kind of the mutation."""
    simulator = Simulator(1)
    track_runner = TrackRunner(simulator.world(0), load_pack(), TrackConfig())
    found: dict[str, Counter[str]] = {}
    sound = _sound_files()
    for number in range(count):
        rng = np.random.default_rng([1, seed, number])
        mutate = MUTATIONS[number % len(MUTATIONS)]
        path = folder / "mutated.json"
        path.write_bytes(mutated(rng, mutate, sound))
        found.setdefault(mutate.__name__.strip("_"), Counter())[judge_tasks(path, track_runner)] += 1
    simulator.close()
    return found


def mutated(rng: Rng, mutate: Mutation, sound: list[list[Json]]) -> bytes:
    """One of the sound files, changed: a mutation that happens to change nothing is drawn again."""
    while True:
        file = sound[rng.integers(len(sound))]
        content = mutate(rng, copy.deepcopy(file))
        if content != _coded(file):
            return content


def judge_tasks(path: Path, track_runner: TrackRunner) -> str:
    """`rejected`, `same meaning`, or what is wrong: `misread`, `not one sentence` or `error in flight`."""
    config = Plan.of(policy="hover", tasks=path)
    try:
        suite = resolve(config).suite
    except CognitiveDroneError as error:
        return "not one sentence" if "\n" in str(error) or not str(error).isprintable() else "rejected"
    except Exception as error:
        return f"traceback: {type(error).__name__}"
    try:
        same = _means_the_same(json.loads(path.read_bytes()), suite)
    except (LookupError, TypeError):
        same = False  # what cannot be read was not read as it says
    if not same:
        return "misread"
    try:
        for episode, track in enumerate(suite.tracks):
            track_runner.begin(track, episode_rng(suite.digest, episode, 0))
            track_runner.world.frame()
    except Exception as error:
        return f"error in flight: {type(error).__name__}"
    return "same meaning"


def _means_the_same(content: list[Json], suite: Suite) -> bool:
    """Whether the tasks say what the file says, read without the package's own reader."""
    for obj, (task,) in zip(content, suite.tracks, strict=True):
        gates = obj["gates"]
        if isinstance(gates, list):
            gates = {str(gate["gate"]): gate for gate in gates}
        looks = [(gates[number]["size"], gates[number]["shape"], gates[number]["color"]) for number in "123"]
        said = [obj["prompt"], obj["prompt_simpler"], obj["options"], obj["correct"], obj["background"], looks]
        right = None if task.target is None else task.target + 1
        read = [task.instruction, task.directive, list(task.options), right, task.background]
        if [*read, [(gate.size, gate.shape, gate.color) for gate in task.gates]] != said:
            return False
        for key, value in (
            ("labels", list(task.labels)),
            ("board", task.board),
            ("category", task.category),
            ("family", task.family),
            ("id", task.id),
        ):
            if obj.get(key, value) not in (value, None):
                return False
        sum_ = obj.get("task")
        if sum_ is not None and f"sum/{sum_['d1']}{sum_['operator']}{sum_['d2']}@" not in f"{task.board}":
            return False
        if obj.get("only") is not None and obj["only"] - 1 != task.only:
            return False
    return len(content) == len(suite.tracks)


def _sound_files() -> list[list[Json]]:
    """Task files in the published layout, with gates as a dict and as a list."""
    tasks = [task_to_json(task) for name in ("smoke", "hard") for track in load_suite(f"open-v1:{name}").tracks
             for task in track]  # fmt: skip
    files = [tasks[first : first + 3] for first in range(0, len(tasks) - 2, 3)]
    for file in files[::2]:
        for task in file:
            task["gates"] = [{"gate": number, **gate} for number, gate in task["gates"].items()]
    return files


def _places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every value in a JSON document."""
    if at:
        yield at
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        yield from _places(part, (*at, key))


def _picked(rng: Rng, file: list[Json]) -> tuple[Any, Any]:
    """A container of the document, and the key of one of its values."""
    places = list(_places(file))
    *way, key = places[rng.integers(len(places))]
    holder: Any = file
    for step in way:
        holder = holder[step]
    return holder, key


def _coded(file: Any) -> bytes:
    return json.dumps(file, ensure_ascii=True).encode()


def _other_value(rng: Rng, file: list[Json]) -> bytes:
    holder, key = _picked(rng, file)
    holder[key] = VALUES[rng.integers(len(VALUES))]
    return _coded(file)


def _value_of_another(rng: Rng, file: list[Json]) -> bytes:
    (holder, key), (other, place) = _picked(rng, file), _picked(rng, file)
    holder[key] = copy.deepcopy(other[place])
    return _coded(file)


def _taken_out(rng: Rng, file: list[Json]) -> bytes:
    holder, key = _picked(rng, file)
    del holder[key]
    return _coded(file)


def _twice(rng: Rng, file: list[Json]) -> bytes:
    """A value twice in its list, or a key twice in its object."""
    holder, key = _picked(rng, file)
    if isinstance(holder, list):
        holder.insert(key, copy.deepcopy(holder[key]))
        return _coded(file)
    mark = "a key that is not there"
    holder[mark] = VALUES[rng.integers(len(VALUES))]
    return _coded(file).replace(json.dumps(mark).encode(), json.dumps(key).encode())


def _renamed(rng: Rng, file: list[Json]) -> bytes:
    holder, key = _picked(rng, file)
    if isinstance(holder, dict):
        holder[f"{key}\x1b" if rng.random() < 0.5 else str(key).title()] = holder.pop(key)
    return _coded(file)


def _letter_put_in(rng: Rng, file: list[Json]) -> bytes:
    """A character that no terminal should get, within a text."""
    texts = [place for place in _places(file) if isinstance(_at(file, place), str)]
    *way, key = texts[rng.integers(len(texts))]
    holder = _at(file, tuple(way))
    where = rng.integers(len(holder[key]) + 1)
    letter = ("\x00", "\x1b", "\r", "\n", "\x9b", "\u202e", "\u2066", "\ud83d", "\ufeff", "[/]", "/", "..")
    holder[key] = holder[key][:where] + letter[rng.integers(len(letter))] + holder[key][where:]
    return _coded(file)


def _at(file: Any, place: tuple[Any, ...]) -> Any:
    for step in place:
        file = file[step]
    return file


def _bits(rng: Rng, file: list[Json]) -> bytes:
    content = bytearray(_coded(file))
    for at in rng.integers(len(content), size=rng.integers(1, 4)):
        content[at] ^= 1 << rng.integers(8)
    return bytes(content)


def _bytes(rng: Rng, file: list[Json]) -> bytes:
    content = bytearray(_coded(file))
    at = rng.integers(len(content))
    content[at:at] = rng.bytes(int(rng.integers(1, 5)))
    return bytes(content)


def _cut(rng: Rng, file: list[Json]) -> bytes:
    content = _coded(file)
    start, stop = sorted(rng.integers(len(content) + 1, size=2))
    return content[:start] if rng.random() < 0.5 else content[:start] + content[stop:]


MUTATIONS: tuple[Mutation, ...] = (
    _other_value, _other_value, _value_of_another, _taken_out, _twice, _renamed, _letter_put_in, _bits, _bytes, _cut,
)  # fmt: skip


# ---- weight files


def weight_files(count: int, seed: int, folder: Path) -> dict[str, Counter[str]]:
    """How damaged weight files ended, by the kind of the damage."""
    loaders: dict[Path, Callable[[Path], object]] = {
        WEIGHTS / "small" / "model.onnx": read_description,
        WEIGHTS / "race" / "model.onnx": read_description,
        WEIGHTS / "small" / "eyes.onnx": EyesModel.load,
        WEIGHTS / "small" / "gate_selector.onnx": GateSelectorModel.load,
        WEIGHTS / "picture_classifier.onnx": PictureClassifier.load,
        WEIGHTS / "concepts.onnx": ConceptsModel.load,
        WEIGHTS / "small" / "language.onnx": Mind.load,
        WEIGHTS / "text_encoder.onnx": TextEncoderModel.load,
        _written_anew(folder / "written.onnx"): SmallModel.load,
    }
    sources = list(loaders)
    found: dict[str, Counter[str]] = {}
    for number in range(count):
        rng = np.random.default_rng([2, seed, number])
        source = sources[number % len(sources)]
        damage = DAMAGES[number // len(sources) % len(DAMAGES)]
        content = source.read_bytes()
        damaged = damage(rng, content)
        if damaged == content:
            raise RuntimeError(f"{damage.__name__} left {source.name} as it was")
        path = folder / f"damaged-{source.name}"
        path.write_bytes(damaged)
        found.setdefault(damage.__name__.strip("_"), Counter())[judge_weights(path, loaders[source])] += 1
    return found


def judge_weights(path: Path, load: Callable[[Path], object]) -> str:
    """`found`, or what is wrong: `flown`, `not one sentence` or a traceback."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            load(path)
    except PolicyError as error:
        return "not one sentence" if "\n" in str(error) else "found"
    except Exception as error:
        return f"traceback: {type(error).__name__}"
    return "flown"


def _written_anew(path: Path) -> Path:
    """The packaged racing policy as this version writes it, with a checksum of its own."""
    for name in ("model.onnx", "eyes.onnx"):
        (path if name == "model.onnx" else path.with_name(name)).write_bytes((WEIGHTS / "race" / name).read_bytes())
    describe(path, read_description(path))
    return path


def _one_bit(rng: Rng, content: bytes) -> bytes:
    changed = bytearray(content)
    changed[rng.integers(len(changed))] ^= 1 << rng.integers(8)
    return bytes(changed)


def _some_bytes(rng: Rng, content: bytes) -> bytes:
    changed = bytearray(content)
    for at in rng.integers(len(changed), size=20):
        changed[at] ^= int(rng.integers(1, 256))
    return bytes(changed)


def _one_bit_of_the_description(rng: Rng, content: bytes) -> bytes:
    changed = bytearray(content)
    start = content.rindex(b'{"format"')
    changed[rng.integers(start, len(changed))] ^= 1 << rng.integers(7)
    return bytes(changed)


def _one_bit_of_the_graph(rng: Rng, content: bytes) -> bytes:
    changed = bytearray(content)
    changed[rng.integers(10_000)] ^= 1 << rng.integers(8)
    return bytes(changed)


def _cut_short(rng: Rng, content: bytes) -> bytes:
    return content[: rng.integers(len(content))]


def _without_description(rng: Rng, content: bytes) -> bytes:
    return content[: content.rindex(b'{"format"')]


def _description_of_another(rng: Rng, content: bytes) -> bytes:
    import onnx

    model, other = onnx.load_from_string(content), onnx.load(str(WEIGHTS / "race" / "model.onnx"))
    if {entry.key: entry.value for entry in model.metadata_props} == {e.key: e.value for e in other.metadata_props}:
        other = onnx.load(str(WEIGHTS / "small" / "model.onnx"))
    onnx.helper.set_model_props(model, {entry.key: entry.value for entry in other.metadata_props})
    coded: bytes = model.SerializeToString()
    return coded


def _zeroed(rng: Rng, content: bytes) -> bytes:
    at = int(rng.integers(len(content) - 4096))
    while not any(content[at : at + 4096]):  # a table that is mostly zero
        at = int(rng.integers(len(content) - 4096))
    return content[:at] + bytes(4096) + content[at + 4096 :]


def _blocks_swapped(rng: Rng, content: bytes) -> bytes:
    a = b = 0
    while content[a : a + 4096] == content[b : b + 4096]:
        a, b = sorted(int(at) * 4096 for at in rng.choice(len(content) // 4096, size=2, replace=False))
    return content[:a] + content[b : b + 4096] + content[a + 4096 : b] + content[a : a + 4096] + content[b + 4096 :]


def _more_at_the_end(rng: Rng, content: bytes) -> bytes:
    return content + rng.bytes(int(rng.integers(1, 1000)))


DAMAGES: tuple[Callable[[Rng, bytes], bytes], ...] = (
    _one_bit, _some_bytes, _one_bit_of_the_description, _one_bit_of_the_graph, _cut_short, _without_description,
    _description_of_another, _zeroed, _blocks_swapped, _more_at_the_end,
)  # fmt: skip


# ---- the table


def table(title: str, found: dict[str, Counter[str]]) -> Table:
    """A row a kind of fault, a column a kind of end."""
    ends = sorted({end for counts in found.values() for end in counts})
    drawn = Table("fault", "n", *ends, title=title, title_justify="left")
    for name, counts in found.items():
        drawn.add_row(name.replace("_", " "), str(counts.total()), *(str(counts[end] or "") for end in ends))
    total = sum(found.values(), Counter[str]())
    drawn.add_section()
    drawn.add_row("all", str(total.total()), *(str(total[end]) for end in ends))
    return drawn


def bad(found: dict[str, Counter[str]], good: set[str]) -> int:
    """How many ended as they must not."""
    return sum(count for counts in found.values() for end, count in counts.items() if end not in good)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", type=int, default=1000)
    parser.add_argument("--weights", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tasks = task_files(options.tasks, options.seed, Path(folder))
        weights = weight_files(options.weights, options.seed, Path(folder))
    screen = console()
    screen.print(table("mutated task files", tasks))
    screen.print(table("damaged weight files", weights))
    if bad(tasks, {"rejected", "same meaning"}) or bad(weights, {"found"}):
        sys.exit(1)


if __name__ == "__main__":
    main()
