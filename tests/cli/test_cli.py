"""The command in this process: what it passes on, and what it prints."""

import io
import json
import platform
import re
from contextlib import redirect_stdout
from functools import cache
from importlib import metadata

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

import cognitivedrone
from cognitivedrone import checkout
from cognitivedrone.benchmark.config import Plan, SweepPlan
from cognitivedrone.benchmark.runs.sweep import plan_of
from cognitivedrone.cli import FIRST, TARGETS, help_text, load, main
from cognitivedrone.files import digest_of_files
from cognitivedrone.plan import Scenario
from cognitivedrone.policies.small import Small
from cognitivedrone.tasks import load_suite, write_tasks
from cognitivedrone.tasks.suites import how_many, suite_of
from cognitivedrone.terminal.progress import progress_bar


def bench(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    main(["bench", "--suite", "open-v1:smoke", "--workers", "0", "--clips", "0", *map(str, arguments)])
    return capsys.readouterr().out


def mistake(capsys: pytest.CaptureFixture[str], *arguments: object, command: str = "bench") -> str:
    with pytest.raises(SystemExit) as stop:
        main([*command.split(), *map(str, arguments)])
    assert stop.value.code == 2
    output = capsys.readouterr().err
    assert output.startswith("cognitivedrone: ")
    assert output.count("\n") == 1
    return output


def test_a_model_file_is_flown_in_wind_and_told_of(capsys, tmp_path, tiny_model_file):
    policy = ("--policy", f"small:{tiny_model_file}", "--episodes", 1)
    arguments = (*policy, "--out", tmp_path)
    printed = bench(capsys, *arguments, "--wind", 1.5)
    assert "endings" in printed
    assert "gates flown at" in printed
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["options"]["wind_m_s"] == 1.5
    assert results["options"]["model"] == digest_of_files(*Small.file_of(tiny_model_file))
    assert "--wind 1.5" in results["platform"]["command"]
    report = (tmp_path / "report.html").read_text()
    assert "wind 1.5 m/s" in report
    assert results["options"]["model"] in report
    assert "options.wind_m_s is 1.5 there and 0.0 here" in mistake(
        capsys, "--suite", "open-v1:smoke", *arguments, "--resume"
    )
    bench(capsys, *policy, "--out", tmp_path / "calm")
    calm = json.loads((tmp_path / "calm" / "results.json").read_text())
    paths = [found["episodes"][0]["stages"][0]["path_m"] for found in (results, calm)]
    assert paths[0] != paths[1], "the wind is felt"


def test_plug_ins_are_listed_as_they_are_written(capsys):
    main(["list"])
    output = capsys.readouterr().out
    for written in ("small[:PATH]", "race[:PATH]", "replay:PATH", "hover", "MODULE:ATTRIBUTE:VALUE,option=value"):
        assert written in output
    for name in ("open-v1:hard", "colour_seeker", "math_board"):
        assert name in output
    assert "Stays where it is." in output
    assert "(--airframe): racer, iris" in output


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    main(list(arguments))
    return capsys.readouterr().out


def test_alone_it_teaches_what_to_try(capsys):
    output = printed(capsys)
    assert output == printed(capsys, "--help") == printed(capsys, "-h")
    for command, effect in FIRST:
        assert command.split()[0] in TARGETS
        assert f"cognitivedrone {command}" in output
        assert effect in output
    assert all(f"  {name}" in output for name in TARGETS)
    assert max(map(len, output.splitlines())) <= 80


@cache
def help_of(name: str) -> str:
    """The help of a command in 80 columns."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as shown:
        patch.setenv("COLUMNS", "80")
        with pytest.raises(SystemExit) as end:
            main([*name.split(), "--help"])
    assert end.value.code == 0
    return re.sub(" +\n", "\n", shown.getvalue())


WITH_TASKS = ("bench", "reason", "sweep", "collect", "view", "fly", "play", "sim", "gazebo export", "audit")


@pytest.mark.parametrize("name", TARGETS)
def test_every_command_has_a_function_and_its_own_help(name):
    assert callable(load(name))
    assert f"usage: cognitivedrone {name}" in help_of(name)
    assert "\n\n\n" not in help_of(name)


@pytest.mark.parametrize("name", TARGETS)
def test_every_command_that_takes_a_suite_takes_tasks_and_no_other_does(name):
    assert bool(re.search(r"^\W*--suite\b", help_of(name), re.MULTILINE)) == (name in WITH_TASKS)
    text = " ".join(help_of(name).replace("│", " ").split())
    assert ("--tasks" in text and "Task file, or folder of them" in text) == (name in WITH_TASKS)


def test_commands_that_share_a_word_are_helped_together(capsys):
    output = printed(capsys, "data")
    assert output == printed(capsys, "data", "--help")
    assert "data verify" in output
    assert "bench" not in output
    assert "try first" not in output
    assert help_text("gazebo").count("gazebo ") >= 3


def test_the_version_says_what_is_installed(capsys, monkeypatch):
    python, mujoco = platform.python_version(), metadata.version("mujoco")
    monkeypatch.setattr(checkout, "commit", lambda: "abc-dirty")
    assert printed(capsys, "--version") == (
        f"cognitivedrone {cognitivedrone.__version__} (git abc-dirty), Python {python}, MuJoCo {mujoco}\n"
    )
    monkeypatch.setattr(checkout, "commit", lambda: None)
    assert printed(capsys, "--version").startswith(f"cognitivedrone {cognitivedrone.__version__}, Python {python}")


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("benc", "unknown command 'benc'; did you mean 'bench'?"),
        ("data shw", "unknown command 'data shw'; did you mean 'show'?"),
        ("--verson", "unknown option '--verson'"),
    ],
)
def test_a_misspelt_command_is_reported_in_one_sentence(capsys, command, says):
    assert says in mistake(capsys, command=command)


@pytest.mark.parametrize(("command", "typo", "meant"), [("bench", "--suit", "--suite"), ("fly", "--seeed", "--seed")])
def test_a_misspelt_option_is_answered_with_those_of_its_command_alone(capsys, command, typo, meant):
    with pytest.raises(SystemExit) as end:
        main([command, typo, "1"])
    assert end.value.code == 2
    output = capsys.readouterr().err
    assert meant in output
    others = {name for name in TARGETS if name != command}
    assert not any(f"cognitivedrone {name}" in output for name in others)
    assert "[...]" not in output


@pytest.mark.parametrize(
    ("suite", "says"),
    [
        ("smoke", "unknown suite 'smoke'; did you mean 'open-v1:smoke'?"),
        ("test", "did you mean 'open-v1:test'?"),
        ("open-v1:tset", "did you mean 'open-v1:test'?"),
        ("Race", "did you mean 'open-v1:race'?"),
        ("animals", "'animals' is a family of tasks, not a suite; 'open-v1:test' holds such tasks"),
        ("counting", "'open-v1:hard' holds such tasks"),
        ("my/tasks.json", "there is no suite and no task file 'my/tasks.json'"),
        ("nonsense", "known: open-v1:hard"),
    ],
)
@pytest.mark.parametrize("command", ["bench", "reason", "view", "fly"])
def test_a_misspelt_suite_is_answered_with_the_near_one(capsys, tmp_path, monkeypatch, command, suite, says):
    monkeypatch.chdir(tmp_path)
    assert says in mistake(capsys, "--suite", suite, command=command)


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("bench --airframe dji", "unknown airframe 'dji'; known: iris, racer"),
        ("bench --airframe racr", "did you mean 'racer'?"),
        ("bench --workers 0 --policy smal", "did you mean 'small'?"),
        ("bench --workers 0 --reasoner orcale", "did you mean 'oracle'?"),
        ("collect --out x --recipe debugg", "did you mean 'debug'?"),
        ("gazebo export --out x --task y --version harmonc", "did you mean 'harmonic'?"),
        ("view --labels nowhere", "no label pack 'nowhere'"),
    ],
)
def test_an_unknown_name_is_a_sentence(capsys, tmp_path, monkeypatch, command, says):
    monkeypatch.chdir(tmp_path)
    assert says in mistake(capsys, command=command)


def stopped() -> None:
    raise KeyboardInterrupt


def stopped_while_loading() -> None:
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as stop:
        raise ImportError("initialization failed") from stop


@pytest.mark.parametrize("command", [stopped, stopped_while_loading])
def test_ctrl_c_without_words_says_that_it_stopped(capsys, monkeypatch, command):
    monkeypatch.setattr("cognitivedrone.cli.load", lambda _: command)
    with pytest.raises(SystemExit) as end:
        main(["list"])
    assert end.value.code == 130
    assert capsys.readouterr().err == "cognitivedrone: stopped\n"


@pytest.mark.parametrize("name", ["bench", "collect", "fly", "train", "serve"])
def test_help_shows_examples(name):
    assert "Examples:\n  cognitivedrone " in help_of(name)


@pytest.fixture
def own_tasks(tmp_path):
    tasks = [track[0] for track in load_suite("open-v1:test").tracks[:3]]
    write_tasks(tmp_path / "mine.json", tasks)
    return tmp_path / "mine.json"


def test_tasks_are_flown_asked_drawn_and_exported(capsys, tmp_path, own_tasks):
    first = load_suite("open-v1:test").tracks[0][0]
    sweep = plan_of(SweepPlan.of(out=tmp_path, tasks=own_tasks, labels=tmp_path), 0)
    assert (sweep.scenario.tasks, sweep.scenario.labels) == (own_tasks, tmp_path)
    for config in (Plan.of(tasks=own_tasks), Plan.of(suite=str(own_tasks)), sweep):
        assert suite_of(config.scenario).n_tasks == 3
    output = printed(capsys, "view", "--tasks", str(own_tasks), "--out", str(tmp_path / "view.png"))
    assert first.instruction in output
    out = tmp_path / "gazebo"
    output = printed(capsys, "gazebo", "export", "--tasks", str(own_tasks), "--task", first.id, "--out", str(out))
    assert first.instruction in output


def test_view_draws_a_task_and_says_in_words_who_is_right(capsys, tmp_path):
    output = printed(capsys, "view", "--episode", "0", "--out", str(tmp_path / "view.png"))
    assert "(right: gate 3, blond bob, glasses, pink sweater, smiling)" in output
    assert np.asarray(Image.open(tmp_path / "view.png")).std() > 20


def test_a_suite_without_an_end_says_how_much_of_it_is_flown(capsys, tmp_path):
    assert how_many(Scenario(), None) == ""
    assert how_many(Scenario(suite="open-v1:train", tasks=tmp_path), None) == ""
    assert "its first 300 tasks of seed 0 are flown, --episodes N" in how_many(Scenario(suite="open-v1:train"), None)
    assert len(suite_of(Scenario(suite="open-v1:train")).tracks) == 300
    main(["bench", "--suite", "open-v1:train", "--policy", "oracle", "--episodes", "1", "--workers", "0",
          "--clips", "0", "--out", str(tmp_path)])  # fmt: skip
    assert "its first 1 tasks of seed 0 are flown" in capsys.readouterr().out


def test_a_progress_bar_fits_into_80_columns_from_its_first_moment():
    out = io.StringIO()
    console = Console(file=out, width=80, force_terminal=True, color_system=None, legacy_windows=False)
    with progress_bar("speed", "rate", screen=console) as bar:
        task = bar.add_task("flying", total=8062, speed="starting", rate="")
        bar.refresh()
        bar.update(task, completed=8000, speed="1234.5/s", rate="choice accuracy 0.123456, " * 4)
        bar.refresh()
    lines = [line for line in out.getvalue().replace("\r", "\n").splitlines() if "flying" in line]
    assert any("starting" in line for line in lines)
    assert any("8000/8062" in line and "1234.5/s" in line and "…" in line for line in lines)
    assert max(len(line.rstrip("\x1b[2K")) for line in lines) <= 90  # with control characters


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (KeyError("lengths"), "KeyError: 'lengths'"),
        (RecursionError("maximum recursion depth exceeded"), "RecursionError: maximum"),
        (ValueError("one\ntwo \x1b[31m rtsp://me:secret@camera/"), "ValueError: one two"),
        (ImportError("initialization failed"), "ImportError: initialization failed"),
    ],
)
def test_an_error_that_nobody_expected_is_one_sentence_with_the_place_of_its_traceback(
    capsys, monkeypatch, tmp_path, error, told
):
    def broken():
        raise error

    monkeypatch.setattr("cognitivedrone.cli.load", lambda name: broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(SystemExit) as stop:
        main(["list"])
    assert stop.value.code == 1
    output = capsys.readouterr().err
    assert output.startswith("cognitivedrone: an error that nobody expected")
    assert told in output
    assert output.count("\n") == 1
    (written,) = tmp_path.iterdir()
    assert str(written) in output
    text = written.read_text()
    assert "in broken" in text
    assert written.stat().st_mode & 0o077 == 0
    assert not any(part in output + text for part in ("secret", "\x1b"))


def test_without_a_place_for_the_traceback_it_is_printed(capsys, monkeypatch, tmp_path):
    def broken():
        raise ArithmeticError("odd")

    monkeypatch.setattr("cognitivedrone.cli.load", lambda name: broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(SystemExit):
        main(["list"])
    assert "in broken" in capsys.readouterr().err
