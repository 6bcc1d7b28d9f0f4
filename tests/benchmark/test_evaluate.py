"""Scoring from a script or a notebook."""

import subprocess
import sys
from pathlib import Path

import pytest
import user_pilots

from cognitivedrone import evaluate
from cognitivedrone.benchmark.scores.results import read_results
from cognitivedrone.errors import RunError
from cognitivedrone.reasoners.oracle import Oracle
from cognitivedrone.tasks import load_suite, write_tasks


def score(policy, **options):
    return evaluate(policy, episodes=1, progress=False, **options)


def test_an_object_a_class_and_a_name_fly_alike_and_the_table_is_text_of_eighty_columns():
    by_object = score(user_pilots.Straight(1.0))
    by_function = score(lambda: user_pilots.Straight(1.0))
    by_name = score("user_pilots:Straight:1.0", workers=0)
    assert by_object.results.episodes == by_function.results.episodes == by_name.results.episodes
    assert by_object.summary.overall.n == 1
    assert by_object.results.run.policy == "user_pilots.Straight"
    assert by_object.results.platform["command"] == "evaluate(user_pilots.Straight, 'open-v1:smoke', episodes=1)"
    assert by_name.results.run.policy == "user_pilots:Straight:1.0"
    table = by_name.table()
    assert "overall" in table
    assert max(len(line) for line in table.splitlines()) <= 80


def test_a_class_of_a_module_flies_in_other_processes(tmp_path):
    evaluation = score(user_pilots.Straight, workers=1, out=tmp_path / "run")
    assert evaluation.results.timing.workers == 1
    assert evaluation.results.run.policy == "user_pilots:Straight"
    assert read_results(tmp_path / "run") == evaluation.results


def test_a_reasoner_may_be_an_object_too():
    gold = score("colour_seeker", reasoner=Oracle())
    assert gold.summary.overall.passed == 1
    assert gold.summary.overall.reasoner.gate == 1.0


def test_what_is_made_is_closed_and_an_object_of_the_users_is_not():
    class Closing(user_pilots.Straight):  # type: ignore[misc]
        closed = 0

        def close(self):
            Closing.closed += 1

    evaluate(Closing(), episodes=1, progress=False)
    assert Closing.closed == 0
    evaluate(Closing, episodes=1, progress=False)
    assert Closing.closed == 1


def test_objects_stay_in_one_process_and_that_is_reported(capsys):
    evaluate(user_pilots.Straight(), episodes=1)
    output = "flying in one process, because the policy is an object; pass a class of a module to use more cores\n"
    assert output in capsys.readouterr().err
    with pytest.raises(RunError, match="workers=2, but the policy is an object; pass a class of a module to use more"):
        score(user_pilots.Straight(), workers=2)
    with pytest.raises(RunError, match="but the policy's function is defined where no other process can"):
        score(lambda: user_pilots.Straight(), workers=2)
    with pytest.raises(RunError, match="the policy is an object and the reasoner is an object; pass a class of a mod"):
        score(user_pilots.Straight(), reasoner=Oracle(), workers=2)


def test_a_task_file_is_a_suite(tmp_path):
    write_tasks(tmp_path / "mine.json", [task for (task,) in load_suite("open-v1:smoke").tracks[:2]])
    assert evaluate("oracle", tmp_path / "mine.json", workers=0, progress=False).summary.overall.n == 2


def test_a_script_of_three_lines_scores_its_own_class(tmp_path):
    """Defined in the script itself, without a guard around the call."""
    script = tmp_path / "score.py"
    script.write_text(
        Path(user_pilots.__file__).read_text()
        + "\nfrom cognitivedrone import evaluate\n"
        + "results = evaluate(Straight(), suite='open-v1:smoke', episodes=1)\n"
        + "print(results)\n"
        + "print(evaluate(Straight, episodes=1).summary.overall.n)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "overall" in done.stdout
    assert done.stdout.splitlines()[-1] == "1"
    why = "because the policy's class is defined in the script itself; put it into a module to use more cores"
    assert f"flying in one process, {why}\n" in done.stderr
