import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import benchmark_fakes
import pytest
from benchmark_fakes import lasting

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.records import read_records
from cognitivedrone.benchmark.runs.runner import Interrupted, out_of, run
from cognitivedrone.errors import CognitiveDroneError, MissingExtra, RunError
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.suites import chain

RUNNER = benchmark_fakes.FakeRunner


def in_new_process(config: Plan, runner: str, workers: int) -> subprocess.CompletedProcess:
    """A run in a process, and a process group, of its own."""
    script = f"""
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a test run in the background is started deaf to it
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from pathlib import Path
import benchmark_fakes
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.runner import run
if __name__ == "__main__":
    config = Plan.of(policy="fake", suite="open-v1:train", episodes=20, clips=0, workers={workers},
                       out=Path({str(config.out)!r}))
    try:
        run(config, progress=False, runner=benchmark_fakes.{runner})
    except KeyboardInterrupt as stop:
        print(stop)
        sys.exit(130)
"""
    file = config.out.parent / "script.py"
    file.write_text(script)
    return subprocess.run(
        [sys.executable, str(file)], capture_output=True, text=True, start_new_session=True, timeout=60
    )


def test_the_number_of_workers_changes_nothing(config, tmp_path):
    alone = config.changed(out=tmp_path / "alone", clips=3)
    team = config.changed(out=tmp_path / "team", clips=3, workers=2)
    run(alone, progress=False, runner=RUNNER)
    results = run(team, progress=False, runner=RUNNER)
    assert [episode.episode for episode in results.episodes] == list(range(20))
    assert results.timing.workers == 2
    assert lasting(tmp_path / "alone") == lasting(tmp_path / "team")


def test_a_killed_run_goes_on_and_ends_as_if_nothing_had_happened(config, tmp_path):
    killed = in_new_process(config, "DyingRunner", workers=0)
    assert killed.returncode == -signal.SIGKILL
    assert sorted(read_records(config.out)) == [0, 1, 2, 3, 4]
    assert not (config.out / "results.json").exists()
    results = run(config.changed(resume=True), progress=False, runner=RUNNER)
    assert results.timing.episodes_flown == 15
    run(config.changed(out=tmp_path / "whole"), progress=False, runner=RUNNER)
    assert lasting(config.out) == lasting(tmp_path / "whole")


def test_a_finished_run_is_not_flown_again(config):
    first = run(config, progress=False, runner=RUNNER)
    assert run(config.changed(resume=True), progress=False, runner=benchmark_fakes.UnlabelledRunner) == first


def test_another_rule_on_resume_gives_its_own_report_without_flying(config):
    through = run(config, progress=False, runner=RUNNER)
    within = run(config.changed(resume=True, rule="within_1m"), progress=False, runner=RUNNER)
    assert within.timing.episodes_flown == 0
    assert within.episodes == through.episodes
    assert within.summary().overall.passed > through.summary().overall.passed
    assert "the published rule" in (config.out / "report.html").read_text()


def test_ctrl_c_keeps_what_is_flown_and_says_how_to_go_on(config):
    with pytest.raises(Interrupted, match=r"stopped after 5 of 20 episodes.*--resume") as stop:
        run(config, progress=False, runner=benchmark_fakes.InterruptedRunner)
    assert isinstance(stop.value, KeyboardInterrupt)
    assert sorted(read_records(config.out)) == [0, 1, 2, 3, 4]


def test_ctrl_c_with_workers_ends_them_quietly(config):
    stopped = in_new_process(config, "GroupInterruptedRunner", workers=2)
    assert stopped.returncode == 130
    assert "--resume" in stopped.stdout
    assert not stopped.stderr.strip()  # older versions of rich end the bar's line
    results = run(config.changed(resume=True), progress=False, runner=RUNNER)
    assert results.summary().overall.n == 20


@pytest.mark.parametrize(
    ("change", "runner", "says"),
    [
        ({"workers": 1}, "DyingRunner", r"episode 5 \(open-v1:train/0-5\) was killed by SIGKILL.*--resume"),
        ({"workers": 1}, "LeavingRunner", r"the worker of episode 5 .* ended with exit code 0; continue with --resume"),
        ({"workers": 1}, "BuggyRunner", r"episode 5 .* failed: ZeroDivisionError: a bug in a policy.*error\.txt"),
        (
            {"fail_fast": True},
            "RaisingRunner",
            r"episode 5: the reasoner raised an exception; its traceback is in .*0005\.txt",
        ),
    ],
)
def test_what_ends_a_run_is_reported_with_its_episode_and_the_rest_is_kept(config, change, runner, says):
    with pytest.raises(RunError, match=says):
        run(config.changed(**change), progress=False, runner=getattr(benchmark_fakes, runner))
    kept = set(read_records(config.out))
    assert {0, 1, 2, 3} <= kept
    assert 5 not in kept
    assert kept == {0, 1, 2, 3, 4} or "workers" in change
    assert runner != "BuggyRunner" or "benchmark_fakes.py" in (config.out / "error.txt").read_text()
    assert not (config.out / "results.json").exists()
    assert run(config.changed(resume=True), progress=False, runner=RUNNER).summary().overall.n == 20


@pytest.mark.parametrize(
    ("runner", "says", "trace", "workers"),
    [
        ("HangingRunner", "took longer than 1 s", "benchmark_fakes.py", 2),
        ("QuittingRunner", "ended with exit code 0 during a call of policy or reasoner", "exit code 0", 1),
        ("CrashingRunner", "was killed by SIGSEGV during a call", "Segmentation fault", 1),
    ],
)
def test_a_worker_that_a_policy_takes_down_costs_one_episode(config, runner, says, trace, workers):
    config = config.changed(workers=workers, decision_timeout=1.0)
    results = run(config, progress=False, runner=getattr(benchmark_fakes, runner))
    (failed,) = (episode for episode in results.episodes if episode.message)
    assert failed.episode == 5
    assert [stage.outcome for stage in failed.stages] == ["policy_error"]
    assert says in failed.message
    assert [file.name for file in (config.out / "errors").iterdir()] == ["episode-0005.txt"]
    assert trace in (config.out / "errors" / "episode-0005.txt").read_text()
    assert results.summary().overall.outcomes["policy_error"] == 1
    # What the others flew is what they fly without it.
    whole = run(config.changed(workers=0, out=config.out / "whole"), progress=False, runner=RUNNER)
    assert [e for e in results.episodes if e.episode != 5] == [e for e in whole.episodes if e.episode != 5]


def test_a_pilot_that_cannot_be_made_costs_no_earlier_run(config):
    run(config, progress=False, runner=RUNNER)
    before = lasting(config.out)
    with pytest.raises(CognitiveDroneError, match="zebr"):
        run(config.changed(overwrite=True), progress=False, runner=benchmark_fakes.UnlabelledRunner)
    assert lasting(config.out) == before


def test_overwriting_takes_old_tracebacks_away(config):
    run(config, progress=False, runner=benchmark_fakes.RaisingRunner)
    assert (config.out / "errors").exists()
    run(config.changed(overwrite=True), progress=False, runner=RUNNER)
    assert not (config.out / "errors").exists()


@pytest.mark.parametrize(
    ("workers", "runner", "says"),
    [
        (1, "StillbornRunner", "a worker ended with exit code 3 before it was ready; bench --workers 0"),
        (0, "UnlabelledRunner", r"^label 'zebr' is not in the pack; did you mean 'zebra'\?$"),
        (1, "UnlabelledRunner", r"^label 'zebr' is not in the pack; did you mean 'zebra'\?$"),
    ],
)
def test_a_worker_that_cannot_start_is_reported_in_its_own_words(config, workers, runner, says):
    with pytest.raises(CognitiveDroneError, match=says):
        run(config.changed(workers=workers), progress=False, runner=getattr(benchmark_fakes, runner))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"labels": Path("nowhere")}, "--labels nowhere is not a folder"),
        ({"executor": "ray"}, "--workers 0 flies in this process; leave out --executor ray"),
        ({"executor": "ray", "workers": 2, "cpus_per_worker": 0}, "--cpus-per-worker is 0"),
        ({"resume": True, "overwrite": True}, "contradict each other"),
        ({"latency": "soon"}, "cannot read 'soon'"),
        ({"shard": "21/21"}, "--shard 21/21 has no episode"),
        *(
            ({"shard": text}, "--shard is .*; give i/n")
            for text in ("0/3", "4/3", "2", "2/", "1/0", "a/b", "-1/3", "1/2/3", "02/8", "1/10000000")
        ),
        ({"gpus_per_worker": 1.0}, "--cpus-per-worker and --gpus-per-worker are for --executor ray"),
        ({"executor": "ray", "workers": None, "link": "gazebo", "airframe": "iris"}, "flies the one vehicle"),
    ],
)
def test_impossible_options_are_refused_before_anything_is_written(config, wrong, message):
    with pytest.raises(CognitiveDroneError, match=message):
        run(config.changed(**wrong), progress=False, runner=RUNNER)
    assert not config.out.exists()


def test_without_ray_the_extra_is_named_before_anything_is_written(config, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtra, match=r"cognitivedrone\[ray\]"):
        run(config.changed(executor="ray", workers=2), progress=False, runner=RUNNER)
    assert not config.out.exists()


@pytest.mark.parametrize(("option", "changed"), [("labels", "toy/cat.png"), ("model", "eyes.onnx")])
def test_other_labels_or_another_model_in_the_same_file_are_another_run(config, tmp_path, option, changed):
    (tmp_path / "toy").mkdir()
    for name in ("toy/cat.png", "model.onnx", "eyes.onnx"):
        (tmp_path / name).write_bytes(b"first")
    flown = config.changed(
        **({"labels": tmp_path} if option == "labels" else {"policy": f"small:{tmp_path}/model.onnx"})
    )
    run(flown, progress=False, runner=RUNNER)
    (tmp_path / changed).write_bytes(b"second")
    with pytest.raises(RunError, match=rf"options\.{option} is"):
        run(replace(flown, resume=True), progress=False, runner=RUNNER)


def test_the_progress_bar_counts_to_the_end(config, capsys):
    run(config, progress=True, runner=RUNNER)
    shown = capsys.readouterr().err
    assert "20/20" in shown
    assert "passed" in shown


def test_single_tasks_are_chained_in_order():
    suite = load_suite("open-v1:train", size=12)
    chained = chain(suite)
    assert [len(track) for track in chained.tracks] == [5, 5, 2]
    assert [task for track in chained.tracks for task in track] == [task for track in suite.tracks for task in track]
    assert chain(chained) == replace(chained, tracks=chained.tracks)


def test_a_run_on_tracks_counts_the_stages_that_were_not_reached(config):
    results = run(config.changed(track=True), progress=False, runner=RUNNER)
    assert len(results.episodes) == 4
    summary = results.summary()
    assert summary.overall.n == 20
    assert summary.overall.outcomes["not_reached"] > 0
    assert summary.episodes == 4


@pytest.mark.parametrize(
    ("options", "folder"),
    [
        ({"policy": "my.module:Mine", "reasoner": "oracle"}, "results/open-v1-test-my.module-Mine-oracle"),
        ({"shard": "2/8"}, "results/open-v1-test-small-none-shard-2-of-8"),
    ],
)
def test_the_folder_is_named_after_suite_pilot_and_shard(options, folder):
    assert out_of(Plan.of(**options)) == Path(folder)


def test_workers_do_not_outlive_a_run(config):
    run(config.changed(workers=2), progress=False, runner=benchmark_fakes.NamedRunner)
    renderer = json.loads((config.out / "results.json").read_text())["renderer"]
    pids = [int(name.split()[-1]) for name in renderer.split(" and ")]
    assert pids
    assert os.getpid() not in pids
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
