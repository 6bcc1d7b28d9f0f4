"""Shards of a run, flown apart, are the run again once they are merged; anything else is refused in a sentence."""

import json
import shutil
from pathlib import Path
from typing import Any

import benchmark_fakes
import pytest
from benchmark_fakes import lasting

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs import records
from cognitivedrone.benchmark.runs.merge import merge
from cognitivedrone.benchmark.runs.records import read_records
from cognitivedrone.benchmark.runs.runner import command_of, run
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.errors import RunError
from cognitivedrone.tasks import load_suite, write_tasks

RUNNER = benchmark_fakes.FakeRunner


def fly(config: Plan, shard: str, runner: Any = RUNNER) -> Path:
    out = config.out.parent / f"part-{shard.replace('/', '-of-')}"
    run(config.changed(shard=shard, out=out), progress=False, runner=runner)
    return out


@pytest.fixture
def parts(config):
    return [fly(config, f"{number}/3") for number in (1, 2, 3)]


def test_merged_shards_are_the_undivided_run(config, parts, tmp_path):
    run(config, progress=False, runner=RUNNER)
    merged = merge([parts[2], parts[0], parts[1]], tmp_path / "merged")
    assert lasting(tmp_path / "merged") == lasting(config.out)
    assert read_results(tmp_path / "merged") == merged
    traces = [read_records(folder) for folder in (tmp_path / "merged", config.out)]
    assert [(traces[0][e].trace.path == traces[1][e].trace.path).all() for e in range(20)] == [True] * 20
    page, whole = ((folder / "report.html").read_text() for folder in (tmp_path / "merged", config.out))
    instruction = next(line for line in whole.splitlines() if "wrong gate" in line and "<tr><td" in line)
    assert instruction in page
    assert merged.platform["command"] == command_of(config)
    assert (merged.timing.workers, merged.timing.episodes_flown) == (3, 20)


def test_a_merged_run_goes_on_as_the_undivided_one(config, parts, tmp_path):
    merge(parts, tmp_path / "merged")
    again = config.changed(out=tmp_path / "merged", resume=True)
    assert run(again, progress=False, runner=benchmark_fakes.UnlabelledRunner).timing.episodes_flown == 20


def test_a_shard_is_every_nth_episode(config, parts):
    assert [sorted(read_records(part)) for part in parts] == [[*range(first, 20, 3)] for first in range(3)]
    results = read_results(parts[1])
    assert results.run.option("shard") == "2/3"
    assert [episode.episode for episode in results.episodes] == [1, 4, 7, 10, 13, 16, 19]
    assert "--shard 2/3" in results.platform["command"]


def test_a_killed_shard_is_resumed_as_that_shard(config):
    with pytest.raises(KeyboardInterrupt, match="after 1 of 6 episodes"):
        fly(config, "3/3", benchmark_fakes.InterruptedRunner)
    out = config.out.parent / "part-3-of-3"
    with pytest.raises(RunError, match=r"part-3-of-3 is not finished; continue it"):
        merge([out], config.out)
    with pytest.raises(RunError, match=r"options\.shard is '3/3' there and '2/3' here"):
        run(config.changed(shard="2/3", out=out, resume=True), progress=False, runner=RUNNER)
    assert run(config.changed(shard="3/3", out=out, resume=True), progress=False, runner=RUNNER).timing.workers == 1


def test_tasks_of_a_file_merge_without_it(config, tmp_path):
    write_tasks(tmp_path / "mine.json", [track[0] for track in load_suite("open-v1:train", size=6).tracks])
    config = config.changed(tasks=tmp_path / "mine.json", episodes=None)
    parts = [fly(config, f"{number}/2") for number in (1, 2)]
    (tmp_path / "mine.json").unlink()
    assert merge(parts, tmp_path / "merged").summary().overall.n == 6


def damaged(parts: list[Path]) -> list[Path]:
    records = parts[1] / "episodes.jsonl"
    records.write_text("".join(records.read_text().splitlines(keepends=True)[:-1]))
    return parts


def renamed(parts: list[Path]) -> list[Path]:
    """Two shards that claim each other's number."""
    for part, old, new in ((parts[1], "2/3", "3/3"), (parts[2], "3/3", "2/3")):
        for name in ("run.json", "results.json"):
            file = part / name
            file.write_text(file.read_text().replace(f'"shard": "{old}"', f'"shard": "{new}"'))
    return parts


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (lambda parts: [], "there is nothing to merge"),
        (lambda parts: parts[:1], "these shards are missing: 2/3, 3/3; fly them"),
        (lambda parts: [*parts, shutil.copytree(parts[1], parts[1].parent / "copy")], "are both shard 2/3"),
        (lambda parts: [*parts, parts[0].parent / "nowhere"], "nowhere cannot be read .*give the --out folder"),
        (damaged, "part-2-of-3: its records are not the episodes of its results"),
        (renamed, "line 1 is of another run"),
    ],
)
def test_what_is_not_every_shard_once_is_refused(parts, given, says, tmp_path):
    with pytest.raises(RunError, match=says):
        merge(given(parts), tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


@pytest.mark.parametrize(
    ("change", "shard", "says"),
    [
        ({"wind": 0.5}, "3/3", r"part-3-of-3 is a shard of another run: options\.wind_m_s is 0\.5 in .*-3 and 0\.0 in"),
        ({"policy": "other"}, "3/3", "shard of another run: policy is 'other' in"),
        ({"rule": "within_1m"}, "3/3", "shows the rule within_1m first"),
        ({}, "3/4", r"part-1-of-3 is shard 1/3 and .*part-3-of-4 is shard 3/4"),
    ],
)
def test_a_shard_of_another_run_is_refused(config, tmp_path, change, shard, says):
    parts = [fly(config, "1/3"), fly(config, "2/3"), fly(config.changed(**change), shard)]
    with pytest.raises(RunError, match=says):
        merge(parts, tmp_path / "merged")


def test_a_whole_run_is_no_shard_and_the_shards_stay(config, parts, tmp_path):
    run(config, progress=False, runner=RUNNER)
    with pytest.raises(RunError, match="is not a shard: it was flown without --shard"):
        merge([config.out], tmp_path / "merged")
    with pytest.raises(RunError, match="already contains a run; give --overwrite"):
        merge(parts, config.out)
    with pytest.raises(RunError, match="is one of the shards"):
        merge(parts, parts[0], overwrite=True)
    assert merge(parts, config.out, overwrite=True).timing.episodes_flown == 20


def test_links_among_the_errors_of_a_shard_are_left_out(config, parts, tmp_path):
    (tmp_path / "keys").mkdir()
    secret = tmp_path / "keys" / "episode-0001.txt"
    secret.write_text("private")
    (parts[1] / "errors").symlink_to(secret.parent)
    errors = parts[0] / "errors"
    errors.mkdir(exist_ok=True)
    (errors / "episode-0001.txt").symlink_to(secret)
    (errors / "episode-0004.txt").write_text("Traceback")
    (errors / "notes.txt").write_text("something else")
    merge(parts, tmp_path / "merged")
    assert [path.name for path in sorted((tmp_path / "merged" / "errors").iterdir())] == ["episode-0004.txt"]


def test_a_shard_of_an_endless_suite_that_says_it_is_huge_is_not_drawn(config, parts, tmp_path):
    for part in parts:
        kept = read_records(part)
        for name in ("results.json", "run.json"):
            document = json.loads((part / name).read_text())
            document["suite"] |= {"name": "open-v1:train", "size": 10**12}
            (part / name).write_text(json.dumps(document))
        digest = records.digest_of_run(read_results(part).run)
        lines = [records._line(records.dumps(record), digest) for record in kept.values()]
        (part / records.EPISODES_FILE).write_bytes(b"".join(lines))
    assert merge(parts, tmp_path / "merged").run.suite.size == 10**12
