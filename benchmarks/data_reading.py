"""Random frames a second from a store, as training reads them.

Run: python benchmarks/data_reading.py [STORE] [--out results/data_reading.json]

Prints medians over repetitions of batches of 64 random steps (frame decoded, action, state, instruction), processor
time a frame, and the ratio to decoding alone, from memory and in one thread; of a given store, also the rate of two
processes at once. Without a store, a small one of rendered-looking frames is made for each encoding.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.data.episode import Conditions, Encoding, Episode, decode_image, encode_image
from cognitivedrone.data.store import Store
from cognitivedrone.data.store_writer import StoreWriter
from cognitivedrone.tasks import train_task

BATCH = 64
REPEATS = 25
EPISODES = 256
LENGTH = 45
ENCODINGS: tuple[Encoding, ...] = ("jpeg", "png", "webp")


def frame(rng: np.random.Generator) -> np.ndarray:
    """(256, 256, 3) a horizon, gates and panels, roughly as large in bytes as a real frame."""
    picture = Image.new("RGB", (256, 256), (178, 190, 205))
    draw = ImageDraw.Draw(picture)
    draw.rectangle((0, 150, 256, 256), fill=(240, 240, 240))
    for color in ((255, 0, 0), (0, 255, 0), (0, 30, 255)):
        x, y = rng.integers(10, 180, 2).tolist()
        draw.ellipse((x, y, x + 60, y + 60), outline=color, width=5)
        draw.rectangle((x + 5, y - 60, x + 55, y - 10), fill=(255, 255, 255))
        draw.text((x + 12, y - 52), chr(int(rng.integers(65, 91))), fill=(0, 0, 0), font_size=34)
    return np.asarray(picture)


def made_store(path: Path, encoding: Encoding) -> Store:
    rng = np.random.default_rng(0)
    images = [encode_image(frame(rng), encoding) for _ in range(64)]
    writer = StoreWriter(path, {"name": "benchmark"}, "open-v1:train", "0" * 64, 0, episodes_per_shard=64)
    for number in range(EPISODES // 64):
        indices = range(64 * number, 64 * (number + 1))
        writer.write_shard(number, [made_episode(index, images, encoding, rng) for index in indices], {})
    writer.finish()
    return Store.open(path)


def made_episode(index: int, images: Sequence[bytes], encoding: Encoding, rng: np.random.Generator) -> Episode:
    return Episode(
        index=index,
        suite="open-v1:train",
        task=train_task(index),
        conditions=Conditions(0, "x500", "plain", (-1.0, 0.0, 0.75), 0.0, (0.0, 0.0, 0.0)),
        encoding=encoding,
        images=tuple(images[k] for k in rng.integers(0, len(images), LENGTH)),
        action=rng.normal(size=(LENGTH, 4)).astype(np.float32),
        sent=rng.normal(size=(LENGTH, 4)).astype(np.float32),
        velocity=rng.normal(size=(LENGTH, 3)).astype(np.float32),
        height=rng.normal(size=LENGTH).astype(np.float32),
        yaw_rate=rng.normal(size=LENGTH).astype(np.float32),
        position=rng.normal(size=(LENGTH, 3)),
        quaternion=rng.normal(size=(LENGTH, 4)),
        final_position=rng.normal(size=3),
    )


def rate(work: Callable[[], object]) -> float:
    """Frames a second, the median of `REPEATS` batches."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return BATCH / statistics.median(times)


def measure(store: Store) -> list[dict[str, object]]:
    """One row for each number of threads."""
    rows: list[dict[str, object]] = []
    rng = np.random.default_rng(1)
    first = store.episode(store.indices()[0])
    drawn = rng.choice(store.indices(), min(len(store), 50), replace=False).tolist()
    kilobytes = float(np.mean([len(image) for index in drawn for image in store.episode(index).images])) / 1000
    of_store = {"encoding": first.encoding, "kb_per_frame": round(kilobytes, 1), "episodes": len(store)}
    one_frame = [first.images[0]] * BATCH
    bare = rate(lambda: [decode_image(image) for image in one_frame])
    for threads in (1, 2):
        store.steps([0], threads)  # reads the numbers once
        before = time.process_time()
        got = rate(lambda threads=threads: store.steps(rng.integers(0, store.n_steps, BATCH), threads))  # type: ignore[misc]
        cpu = 1e3 * (time.process_time() - before) / (REPEATS * BATCH)
        print(
            f"| {first.encoding} | {kilobytes:.1f} | {len(store):,} | {threads} | {got:,.0f} | {cpu:.2f} "
            f"| {got / bare:.2f} |"
        )
        readers = f"{threads} thread{'s' * (threads > 1)}"
        measured = {"frames_per_s": round(got), "cpu_ms": round(cpu, 3), "over_decoding": round(got / bare, 2)}
        rows.append({"readers": readers, **of_store, **measured})
    return rows


def read_batches(path: Path, seed: int) -> tuple[float, float]:
    """When a process that has the store open began and ended to read `2 * REPEATS` batches, on the machine's clock."""
    store = Store.open(path)
    store.steps([0])
    rng = np.random.default_rng(seed)
    start = time.perf_counter()
    for _ in range(2 * REPEATS):
        store.steps(rng.integers(0, store.n_steps, BATCH))
    return start, time.perf_counter()


def measure_processes(path: Path, processes: int = 2) -> dict[str, object]:
    """As data loaders of training frameworks read: each process for itself."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        times = list(pool.map(read_batches, [path] * processes, range(processes)))
    seconds = max(end for _, end in times) - min(start for start, _ in times)
    got = processes * 2 * REPEATS * BATCH / seconds
    print(f"{processes} processes of one thread: {got:,.0f} random frames/s")
    return {"readers": f"{processes} processes", "frames_per_s": round(got)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("store", nargs="?", type=Path)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    given = parser.parse_args()
    print("| encoding | KB a frame | episodes | threads | random frames/s | CPU ms a frame | over bare decoding |")
    print("|---|---|---|---|---|---|---|")
    rows: list[dict[str, object]] = []
    if given.store is not None:
        rows = [*measure(Store.open(given.store)), measure_processes(given.store)]
    else:
        for encoding in ENCODINGS:
            with tempfile.TemporaryDirectory() as folder:
                rows += measure(made_store(Path(folder) / "store", encoding))
    keep(given.out, "Random frames read from a data set", rows, seed=0)


if __name__ == "__main__":
    main()
