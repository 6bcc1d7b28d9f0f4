"""What the operating system refuses is one sentence, and what was flown before is kept."""

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import benchmark_fakes
import pytest
from benchmark_fakes import lasting

from cognitivedrone.benchmark.reasoning.reason import ReasonPlan, score_reasoner
from cognitivedrone.benchmark.runs.records import read_records
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.runs.sweep import SweepPlan, sweep
from cognitivedrone.cli import main
from cognitivedrone.errors import RunError
from cognitivedrone.reasoners.replay import read_answers

RUNNER = benchmark_fakes.FakeRunner


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """A disk that is full, to this process: no file grows beyond that many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def test_a_full_disk_ends_a_run_in_one_sentence_and_keeps_what_was_flown(config, tmp_path):
    whole = config.changed(out=tmp_path / "whole")
    run(whole, progress=False, runner=RUNNER)
    full = config.changed(out=tmp_path / "full", workers=1)
    size = (whole.out / "episodes.jsonl").stat().st_size
    with (
        files_of_at_most(size // 2),
        pytest.raises(
            RunError, match=r"cannot write .*episodes\.jsonl: File too large; free disk space.* --resume"
        ) as told,
    ):
        run(full, progress=False, runner=RUNNER)
    assert "\n" not in str(told.value)
    kept = len(read_records(full.out))
    assert 0 < kept < 20
    assert {path.name for path in full.out.iterdir()} == {"run.json", "episodes.jsonl"}
    results = run(replace(full, resume=True), progress=False, runner=RUNNER)
    assert results.timing.episodes_flown == 20 - kept
    assert lasting(full.out) == lasting(whole.out)


def test_a_report_that_does_not_fit_leaves_nothing_half_written(config, tmp_path):
    first = config.changed(out=tmp_path / "first")
    run(first, progress=False, runner=RUNNER)
    second = config.changed(out=tmp_path / "second")
    with (
        files_of_at_most((first.out / "report.html").stat().st_size - 1),
        pytest.raises(RunError, match=r"cannot write .*report\.html: File too large"),
    ):
        run(second, progress=False, runner=RUNNER)
    assert len(read_records(second.out)) == 20
    assert {path.name for path in second.out.iterdir()} == {"run.json", "episodes.jsonl"}
    assert run(replace(second, resume=True), progress=False, runner=RUNNER).timing.episodes_flown == 0


@pytest.fixture(params=["a file", "below a file", "below a device", "where nothing can be"])
def impossible(request, tmp_path) -> Path:
    """A folder that cannot be."""
    (tmp_path / "file").write_text("x")
    places = {"a file": tmp_path / "file", "below a file": tmp_path / "file" / "out"}
    return (places | {"below a device": Path("/dev/full/out"), "where nothing can be": Path("/proc/out")})[
        request.param
    ]


def test_a_place_that_cannot_be_written_is_one_sentence(config, impossible):
    asks = (
        lambda: run(config.changed(out=impossible), progress=False, runner=RUNNER),
        lambda: sweep(SweepPlan.of(out=impossible, policy="hover", suite="open-v1:smoke", ms=(0,), episodes=1)),
        lambda: score_reasoner(ReasonPlan.of(suite="open-v1:smoke", episodes=1, out=impossible), progress=False),
    )
    for ask in asks:
        with pytest.raises(RunError) as told:
            ask()
        assert str(impossible) in str(told.value)
        assert "\n" not in str(told.value)


def test_answers_that_do_not_fit_end_in_one_sentence(tmp_path):
    config = ReasonPlan.of(suite="open-v1:smoke", episodes=4, out=tmp_path / "out")
    with files_of_at_most(1000), pytest.raises(RunError, match=r"cannot write .*reason\.jsonl: File too large") as told:
        score_reasoner(config, progress=False)
    assert "\n" not in str(told.value)
    assert len(read_answers(tmp_path / "out" / "reason.jsonl")) == 1


def test_what_nobody_foresaw_of_the_system_is_one_sentence_too(monkeypatch, capsys):
    def refuse() -> None:
        raise PermissionError(13, "Permission denied", "/some/[bold]\x1b place")

    monkeypatch.setattr("cognitivedrone.benchmark.reports.catalogue.catalogue", refuse)
    with pytest.raises(SystemExit, match="2"):
        main(["list"])
    reported = capsys.readouterr().err
    assert reported.startswith("cognitivedrone: /some/[bold]\\x1b place: Permission denied; ")


@pytest.mark.parametrize(("sink", "code"), [("/dev/full", 2), ("a closed pipe", 1)])
def test_output_that_nobody_takes_is_no_traceback(sink, code):
    command = [sys.executable, "-m", "cognitivedrone", "--help"]
    if sink == "a closed pipe":
        reader, writer = os.pipe()
        os.close(reader)
        output = os.fdopen(writer, "wb")
    else:
        output = os.fdopen(os.open(sink, os.O_WRONLY), "wb")
    with output:
        done = subprocess.run(command, stdout=output, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == code
    assert done.stderr.count("\n") == (1 if code == 2 else 0)
    assert "Traceback" not in done.stderr
