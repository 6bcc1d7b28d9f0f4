"""`evaluate` from scripts, pools and notebooks: the same score, paths as text, and errors in words of Python."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from cognitivedrone import evaluate
from cognitivedrone.benchmark.runs.runner import Interrupted
from cognitivedrone.errors import UsageError
from cognitivedrone.terminal.progress import progress_bar

CALL = """
from cognitivedrone import evaluate
evaluation = evaluate("oracle", "open-v1:smoke", episodes=1, workers=1, progress=False)
print("score", evaluation.summary.overall.passed, evaluation.results.episodes[0].stages[0].time_s)
"""


def scored(*command, **options):
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=300, check=False, **options
    )
    assert done.returncode == 0, done.stderr
    return next(line for line in done.stdout.splitlines() if line.startswith("score")), done.stderr


def test_standard_input_a_daemonic_worker_and_optimised_python_give_the_same_score(tmp_path):
    file = tmp_path / "script.py"
    file.write_text(f"if __name__ == '__main__':\n    {CALL.strip().replace(chr(10), chr(10) + '    ')}\n")
    optimised, _ = scored("-O", str(file))
    piped, said = scored("-", input=CALL)
    assert "flying in this process" in said
    pooled = tmp_path / "pooled.py"
    call = CALL.replace("print(", "return (").replace("\n", "\n    ")
    pooled.write_text(
        f"import multiprocessing\ndef fly(_):\n    {call}\n"
        "if __name__ == '__main__':\n    with multiprocessing.get_context('spawn').Pool(1) as pool:\n"
        "        print(*pool.map(fly, [0])[0])\n"
    )
    inside, said = scored(str(pooled))
    assert "daemonic worker" in said
    here = evaluate("oracle", "open-v1:smoke", episodes=1, workers=0, progress=False)
    plain = f"score {here.summary.overall.passed} {here.results.episodes[0].stages[0].time_s}"
    assert plain == optimised == piped == inside


def test_a_notebook_without_widgets_is_shown_no_bar_and_no_warning():
    with progress_bar(screen=Console(force_jupyter=True)) as bar:
        bar.add_task("flying", total=1)


def test_paths_may_be_text_and_wrong_types_are_a_sentence(tmp_path):
    evaluation = evaluate("oracle", episodes=1, workers=0, out=str(tmp_path / "x"), progress=False)
    assert json.loads((Path(tmp_path) / "x" / "results.json").read_text())
    assert evaluation.summary.overall.passed == 1
    for options, says in (
        ({"out": 3}, "--out is 3; it must be a path or None"),
        ({"workers": "2"}, "--workers is '2'; it must be a whole number or None"),
        ({"wind": "strong"}, "--wind is 'strong'; it must be a number"),
        ({"overwrite": "yes"}, "it must be True or False"),
        ({"seed": True}, "--seed is True; it must be a whole number"),
    ):
        with pytest.raises(UsageError, match=says):
            evaluate("oracle", **options)


@pytest.mark.parametrize("kept", [False, True])
def test_an_interrupted_call_promises_nothing_that_is_gone(tmp_path, kept):
    class Stops:
        def reset(self, context):
            signal.raise_signal(signal.SIGINT)

        def act(self, observation):
            raise NotImplementedError

    options = {"out": tmp_path / "run"} if kept else {}
    with pytest.raises(Interrupted) as stopped:
        evaluate(Stops(), episodes=1, progress=False, **options)
    assert "--resume" not in str(stopped.value)
    assert ("out=FOLDER" in str(stopped.value)) != kept


@pytest.mark.parametrize("name", ["random", "gymnasium"])
def test_a_file_that_hides_a_module_is_named(tmp_path, name):
    (tmp_path / f"{name}.py").write_text("x = 1\n")
    (tmp_path / "mine.py").write_text("class P:\n    def reset(self, c): ...\n    def act(self, o): ...\n")
    done = subprocess.run(
        [sys.executable, "-m", "cognitivedrone", "bench", "--policy", "mine:P", "--workers", "0", "--suite",
         "open-v1:smoke", "--episodes", "1", "--out", str(tmp_path / "o")],
        capture_output=True, text=True, timeout=120, check=False, env={"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin"},
    )  # fmt: skip
    assert done.returncode != 0
    assert f"{name}.py hides the module {name!r}" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
