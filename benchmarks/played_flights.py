"""A small collection and a small benchmark run, flown once and then played back to the code that writes them."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from hashlib import sha256
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.benchmark.runs.runner import run as bench
from cognitivedrone.benchmark.scores.run_types import Rollout
from cognitivedrone.collect import collector
from cognitivedrone.collect.collector import Job, collect
from cognitivedrone.collect.config import CollectPlan
from cognitivedrone.collect.fleet import FlownEpisode
from cognitivedrone.collect.recipe import RECIPES
from cognitivedrone.plan import TaskSource

EPISODES = 6
PER_SHARD = 2
BENCH_EPISODES = 20
WHERE = "COGNITIVEDRONE_FAULTS"
"""Environment variable: the folder of recorded flights."""


def record_collection(folder: Path) -> None:
    """Fly the two collections that are played back."""
    jobs = {
        seed: Job(TaskSource("open-v1:train", seed=seed), replace(RECIPES["debug"], episodes=EPISODES), PER_SHARD)
        for seed in (0, 1)
    }
    for seed, job in jobs.items():
        dump(folder / f"collect-{seed}", {each.episode.index: each for each in job.open().fly(range(EPISODES))})


def record_run(folder: Path) -> None:
    """Fly the benchmark run that is played back."""
    runner = PilotRunner(resolve(_bench_config(folder)))
    dump(folder / "bench", {episode: _short_film(runner.fly(episode, film=True)) for episode in range(BENCH_EPISODES)})
    dump(folder / "renderer", runner.renderer)


def _short_film(flown: Rollout) -> Rollout:
    return replace(flown, film=(flown.film or [])[:3])


def play_back(job: Job, batches: Sequence[Sequence[int]]) -> Iterator[FlownEpisode]:
    """Fly nothing."""
    flights = load(Path(os.environ[WHERE]) / f"collect-{job.source.seed}")
    return (flights[index] for batch in batches for index in batch)


class PlayedRunner:
    """An episode runner that flies nothing."""

    def __init__(self, job: object, watch: object = None) -> None:
        folder = Path(os.environ[WHERE])
        self._flights: dict[int, Rollout] = load(folder / "bench")
        self.renderer: str = load(folder / "renderer")

    def fly(self, episode: int, *, film: bool) -> Rollout:
        flown = self._flights[episode]
        return flown if film else replace(flown, film=None)

    def close(self) -> None:
        pass


def collect_into(out: Path, play: Callable[..., Iterator[FlownEpisode]] = play_back, seed: int = 0) -> None:
    """A small collection, or what is left of it."""

    @contextmanager
    def pool_of(job: Job, config: CollectPlan, most: int) -> Iterator[Any]:
        yield SimpleNamespace(fly=lambda batches: ((flown, "") for flown in play(job, batches)))

    collector.pool_of = pool_of  # type: ignore[assignment]
    config = CollectPlan.of(
        out=out, recipe="debug", episodes=EPISODES, seed=seed, workers=1, resume=True, episodes_per_shard=PER_SHARD
    )
    collect(config, progress=False)


def collect_twice(out: Path) -> None:
    """A collection that is stopped by Ctrl-C in its second shard, and then continued."""

    def stopped(*arguments: Any) -> Iterator[FlownEpisode]:
        yield from islice(play_back(*arguments), PER_SHARD + 1)
        raise KeyboardInterrupt

    with suppress(KeyboardInterrupt):
        collect_into(out, stopped)
    collect_into(out)


def collect_over_damage(out: Path, whole: Path) -> None:
    """The resumption of a finished set that has lost a shard and its manifest."""
    if not out.exists():
        shutil.copytree(whole, out)
        (out / "shards/shard-00001.parquet").write_bytes(b"")
        (out / "manifest.json").unlink()
    collect_into(out)


def bench_into(out: Path) -> None:
    """A small benchmark run, or what is left of it."""
    bench(_bench_config(out), progress=False, runner=PlayedRunner)


def state(folder: Path) -> dict[str, str]:
    """The hash of every file of a folder, by name."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest() for path in files}


def run_state(folder: Path) -> dict[str, str]:
    """The same for a benchmark run, without the clock: timing, and the lines of the report that show it."""
    found = state(folder)
    for name in ("results.json", "report.html", "episodes.jsonl"):
        path = folder / name
        if not path.exists():
            continue
        text = path.read_text(encoding="utf-8")
        if name == "results.json":
            text = json.dumps({**json.loads(text), "timing": None, "platform": None})
        elif name == "report.html":
            text = "\n".join(line for line in text.splitlines() if "<dt>finished</dt>" not in line)
        else:
            records = [json.loads(line)["record"] for line in text.splitlines()]
            text = json.dumps([{**each, "trace": {**each["trace"], "decision_s": None}} for each in records])
        found[name] = sha256(text.encode()).hexdigest()
    return found


def _bench_config(out: Path, episodes: int = BENCH_EPISODES) -> Plan:
    return Plan.of(
        policy="colour_seeker",
        suite="open-v1:smoke",
        workers=1,
        episodes=episodes,
        out=out,
        resume=True,
        clips=2,
    )


def fly_all(job: Job, batches: Sequence[Sequence[int]]) -> Iterator[FlownEpisode]:
    """Fly in this process, which can be forked."""
    fleet = job.open()
    for batch in batches:
        yield from fleet.fly(batch)


def bench_for_real(out: Path) -> None:
    """A benchmark run of fewer episodes, flown."""
    bench(_bench_config(out, episodes=4), progress=False)


def _command_words(out: Path) -> list[str]:
    settings = f"--recipe debug --episodes {EPISODES} --episodes-per-shard {PER_SHARD} --workers 2 --resume"
    return [sys.executable, "-m", "cognitivedrone", "collect", "--out", str(out), *settings.split()]


def command(out: Path) -> None:
    subprocess.run(_command_words(out), check=True, capture_output=True)


def kill_command(out: Path, moment: float) -> None:
    with subprocess.Popen(
        _command_words(out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    ) as process:
        with suppress(subprocess.TimeoutExpired):
            process.wait(moment)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def unfinish(begun: Path) -> None:
    """Give an unfinished set the manifest of one: what a collection writes first."""

    def stopped(*_: Any) -> Iterator[FlownEpisode]:
        raise KeyboardInterrupt
        yield

    with suppress(KeyboardInterrupt):
        collect_into(begun.parent / "first", stopped)
    shutil.copy(begun.parent / "first/manifest.json", begun / "manifest.json")


def dump(path: Path, content: object) -> None:
    path.write_bytes(pickle.dumps(content))


def load(path: Path) -> Any:
    return pickle.loads(path.read_bytes())  # noqa: S301  (our own)
