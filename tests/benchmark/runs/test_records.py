import errno
import fcntl
import json
import os
import zlib
from dataclasses import replace

import pytest
from benchmark_fakes import FakeRunner

from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.benchmark.runs.records import EPISODES_FILE, RunFolder, digest_of_run, read_records
from cognitivedrone.benchmark.scores.results import dumps
from cognitivedrone.errors import RunError


@pytest.fixture
def facts(config):
    return resolve(config).facts


@pytest.fixture
def flown(config):
    runner = FakeRunner(resolve(config))
    return [runner.fly(episode, film=False) for episode in range(4)]


@pytest.fixture
def folder(tmp_path, facts, flown):
    """A run folder with four episodes."""
    path = tmp_path / "records"
    with RunFolder(path, facts) as opened:
        for one in flown:
            opened.append(one, "imagination")
    return path


def test_what_is_read_is_what_was_flown(folder, flown):
    records = read_records(folder)
    assert [records[k].result for k in range(4)] == [one.result for one in flown]
    for k, one in enumerate(flown):
        assert records[k].trace.stages == one.trace.stages
        assert records[k].trace.path == pytest.approx(one.trace.path, abs=6e-4)
        assert records[k].trace.path.shape == one.trace.path.shape


@pytest.mark.parametrize("cut", [1, 20, 400])
def test_a_line_cut_short_by_a_kill_is_dropped_and_the_file_goes_on_soundly(folder, facts, flown, cut):
    file = folder / EPISODES_FILE
    file.write_bytes(file.read_bytes()[:-cut])
    assert sorted(read_records(folder)) == [0, 1, 2]
    with RunFolder(folder, facts, resume=True) as opened:
        assert sorted(opened.records) == [0, 1, 2]
        opened.append(flown[3], "imagination")
    assert sorted(read_records(folder)) == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda line: line["record"]["result"]["stages"][0].update(time_s=1.0), "line 2 does not match its checksum"),
        (lambda line: line.pop("run"), "line 2 .*does not say of which run it is"),
    ],
)
def test_a_line_that_was_changed_or_names_no_run_is_refused(folder, facts, change, says):
    file = folder / EPISODES_FILE
    lines = file.read_text().splitlines(keepends=True)
    line = json.loads(lines[1])
    change(line)
    file.write_text("".join([lines[0], json.dumps(line) + "\n", *lines[2:]]))
    with pytest.raises(RunError, match=rf"episodes\.jsonl {says}"):
        RunFolder(folder, facts, resume=True)


@pytest.mark.parametrize(
    ("resume", "change", "says"),
    [
        (False, {}, "already contains a run; give --resume"),
        (True, {"policy": "other"}, "policy is 'fake' there and 'other' here"),
        (True, {"options": {"seed": 1}}, r"options\.seed is 0 there and 1 here"),
    ],
)
def test_a_run_is_not_overwritten_unasked_and_resume_refuses_another(folder, facts, resume, change, says):
    before = (folder / EPISODES_FILE).read_bytes()
    change = change | {name: facts.options | change[name] for name in ("options",) if name in change}
    with pytest.raises(RunError, match=says):
        RunFolder(folder, replace(facts, **change), resume=resume)
    assert (folder / EPISODES_FILE).read_bytes() == before


def test_overwrite_starts_anew(folder, facts):
    (folder / "results.json").write_text("old")
    with RunFolder(folder, replace(facts, policy="other"), overwrite=True) as opened:
        assert opened.records == {}
    assert not (folder / "results.json").exists()
    assert json.loads((folder / "run.json").read_text())["policy"] == "other"


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_of_other_things_is_left_alone(tmp_path, facts, overwrite):
    (tmp_path / "report.html").write_text("my own report")
    with pytest.raises(RunError, match="is not empty and contains no run"):
        RunFolder(tmp_path, facts, overwrite=overwrite)
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]


def test_two_runs_do_not_write_to_one_folder(folder, facts, config):
    flown = FakeRunner(resolve(config)).fly(4, film=False)
    late = RunFolder(folder, facts, resume=True)
    with RunFolder(folder, facts, resume=True) as first:
        with pytest.raises(RunError, match="another run is writing"):
            late.__enter__()
        first.append(flown, "imagination")
    with pytest.raises(RunError, match="another run is writing"):  # to what was read before
        late.__enter__()


@pytest.mark.parametrize("name", [EPISODES_FILE, "run.json", "results.json", "results.json.tmp", "errors"])
def test_nothing_is_written_through_a_link_in_the_folder(folder, facts, tmp_path, name):
    other = tmp_path / "other"
    other.write_text("precious")
    (folder / name).unlink(missing_ok=True)
    (folder / "run.json").touch()
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(other)
    for resume in (True, False):
        with pytest.raises(RunError, match="contains the link"):
            RunFolder(folder, facts, resume=resume, overwrite=not resume)
    assert other.read_text() == "precious"


@pytest.mark.parametrize("content", ["[" * 100_000, '{"suite": NaN}', '{"a": 1, "a": 2}', "\x00", "7"])
def test_a_damaged_run_file_is_one_sentence(folder, facts, content):
    (folder / "run.json").write_text(content)
    with pytest.raises(RunError, match=r"cannot be read|contains another run"):
        RunFolder(folder, facts, resume=True)
    with pytest.raises(RunError, match=r"run\.json"):
        read_records(folder)
    (folder / EPISODES_FILE).write_text(content + "\n")
    with pytest.raises(RunError, match=r"line 1 is not a record"):
        read_records(folder, facts)


@pytest.mark.parametrize("options", [{"resume": True}, {"overwrite": True}])
def test_records_with_another_name_elsewhere_are_not_changed_there(folder, facts, tmp_path, options):
    other = tmp_path / "other"
    other.hardlink_to(folder / EPISODES_FILE)
    before = other.read_bytes()
    with pytest.raises(RunError, match="a hard link"), RunFolder(folder, facts, **options):
        pass
    assert other.read_bytes() == before


def test_what_a_killed_run_left_does_not_keep_a_new_one_from_its_folder(tmp_path, facts):
    path = tmp_path / "new"
    path.mkdir()
    (path / ".run.json.0123456789abcdef.tmp").write_text("{")
    with RunFolder(path, facts):
        assert sorted(entry.name for entry in path.iterdir()) == [EPISODES_FILE, "run.json"]


def rewritten(folder, number, change):
    """Change a record, with a checksum that is right."""
    file = folder / EPISODES_FILE
    lines = file.read_text().splitlines(keepends=True)
    document = json.loads(lines[number])
    change(document["record"]["result"])
    run, body = document["run"], dumps(document["record"])
    lines[number] = f'{{"crc32":"{zlib.crc32(f"{run} {body}".encode()):08x}","run":"{run}","record":{body}}}\n'
    file.write_text("".join(lines))


def test_a_line_of_another_run_is_refused(folder, facts, flown, tmp_path):
    other = replace(facts, options={**facts.options, "wind_m_s": 2.0})
    assert digest_of_run(other) != digest_of_run(facts)
    with RunFolder(tmp_path / "other", other) as opened:
        opened.append(flown[3], "imagination")
    lines = (folder / EPISODES_FILE).read_text().splitlines(keepends=True)
    pasted = (tmp_path / "other" / EPISODES_FILE).read_text()
    (folder / EPISODES_FILE).write_text("".join(lines[:3]) + pasted)
    for read in (lambda: RunFolder(folder, facts, resume=True), lambda: read_records(folder)):
        with pytest.raises(RunError, match=r"line 4 is of another run"):
            read()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda result: result.update(seed=7), "its seed is 7, and the run's 0"),
        (lambda result: result.update(episode=99), "the suite has the episodes 0 to"),
        (lambda result: result["stages"][0].update(target=99), "its target is 99"),
        (lambda result: result["stages"][0].update(task_id="else"), "its task_id is 'else'"),
        (lambda result: result["stages"][0].update(category="racing"), "its category is 'racing'"),
        (lambda result: result["stages"][0].update(family="else"), "its family is 'else'"),
        (lambda result: result["stages"][0].update(chosen=99), "with the gate 99"),
        (lambda result: result["stages"][0].update(outcome="passed", chosen=None), "cannot have ended as passed"),
        (lambda result: result.update(stages=[]), "it has 0 stages, and its track 1"),
        (lambda result: result["stages"].append(result["stages"][0]), "it has 2 stages, and its track 1"),
    ],
)
def test_a_record_that_does_not_fit_the_suite_is_refused_even_with_its_checksum(folder, config, change, reason):
    job = resolve(config)
    tracks = job.suite.tracks
    with RunFolder(folder, job.facts, tracks=tracks, resume=True) as opened:
        assert len(opened.records) == 4
    rewritten(folder, 2, change)
    before = (folder / EPISODES_FILE).read_bytes()
    with pytest.raises(RunError, match=reason):
        RunFolder(folder, job.facts, tracks=tracks, resume=True)
    assert (folder / EPISODES_FILE).read_bytes() == before


def test_a_file_system_without_locks_is_named_and_nothing_is_left_there(tmp_path, facts, folder, monkeypatch):
    def missing(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", missing)
    no_locks = r"the file system there has no locks .*; give a folder on a local disk"
    with pytest.raises(RunError, match=no_locks), RunFolder(tmp_path / "new", facts):
        pass
    assert not (tmp_path / "new").exists()
    before = (folder / EPISODES_FILE).read_bytes()
    with pytest.raises(RunError, match="has no locks"), RunFolder(folder, facts, resume=True):
        pass
    assert (folder / EPISODES_FILE).read_bytes() == before
