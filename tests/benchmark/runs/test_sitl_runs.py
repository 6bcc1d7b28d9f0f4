"""The benchmark on ArduCopter: a played one in every test run, the real one where it is at hand."""

import json
from dataclasses import replace
from typing import cast

import benchmark_fakes
import pytest
from arducopters import REAL, needs_arducopter, played_arducopter
from rich.console import Group

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports.tables import results_table
from cognitivedrone.benchmark.runs.runner import command_of, run
from cognitivedrone.benchmark.scores.results import read_results, results_from_json, results_to_json
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.vehicles.contract import LinkReport


@pytest.fixture
def sitl(tmp_path) -> Plan:
    return Plan.of(
        policy="colour_seeker", reasoner="oracle", suite="open-v1:smoke", episodes=1, workers=0, clips=0,
        link="sitl", airframe="iris", out=tmp_path / "run",
    )  # fmt: skip


def test_a_task_is_flown_on_another_autopilot_and_the_run_tells_so(sitl, tmp_path, monkeypatch):
    pytest.importorskip("pymavlink")
    monkeypatch.setenv("ARDUCOPTER", str(played_arducopter(tmp_path)))
    results = run(sitl, progress=False)
    (stage,) = results.episodes[0].stages
    assert stage.outcome == "passed"
    assert stage.path_m > 3
    link = results.timing.link
    # A flight of that long at 400 frames a second, and the take-off before it.
    assert link.frames > 400 * stage.time_s
    assert (link.lost, link.restarts) == (0, 0)
    assert results.run.option("link") == "sitl"
    assert len(results.run.option("autopilot")) == 64
    assert "--link sitl" in command_of(sitl)
    assert read_results(sitl.out) == results
    document = json.loads((sitl.out / "results.json").read_text())
    assert document["timing"]["link"] == {"frames": link.frames, "lost": 0, "restarts": 0}


def test_files_without_a_link_are_of_our_own_autopilot(config):
    run(config, progress=False, runner=benchmark_fakes.FakeRunner)
    document = json.loads((config.out / "results.json").read_text())
    assert not {"link", "autopilot"} & document["options"].keys()
    assert "link" not in document["timing"]
    assert results_from_json(document, "here").run.option("link") == "sim"


def test_the_reason_of_every_restart_is_in_the_results_and_the_table(config):
    link = LinkReport(1200, 2, 3, ("fell silent", "the mode became LAND", "fell silent"))
    results = run(config, progress=False, runner=benchmark_fakes.FakeRunner)
    timing = replace(results.timing, link=link)
    again = results_from_json(json.loads(json.dumps(results_to_json(replace(results, timing=timing)))), "here")
    assert again.timing.link == link
    table = [str(row) for row in cast(Group, results_table(again)).renderables]
    started = "started anew 3 times: fell silent (2 times); the mode became LAND"
    assert f"ArduCopter: 1200 frames of physics, 2 lost; {started}" in table


@pytest.mark.parametrize(
    ("change", "binary", "says"),
    [
        ({}, "", r"needs an ArduCopter binary: give --sitl PATH or set ARDUCOPTER to its path; docs/vehicles\.md"),
        ({}, "pyproject.toml", "is not a program that can be run: give --sitl PATH or set ARDUCOPTER"),
        ({"airframe": "iriss"}, "/bin/true", "did you mean 'iris'"),
    ],
)
def test_what_cannot_be_flown_is_reported_before_anything_is_written(sitl, monkeypatch, change, binary, says):
    monkeypatch.setenv("ARDUCOPTER", binary)
    with pytest.raises(CognitiveDroneError, match=says):
        run(sitl.changed(**change), progress=False)
    assert not sitl.out.exists()


@needs_arducopter
def test_a_real_arducopter_flies_a_few_tasks_without_a_lost_frame(sitl):
    results = run(sitl.changed(episodes=3, airframe="racer"), progress=False)
    assert [stage.outcome for episode in results.episodes for stage in episode.stages] == ["passed"] * 3
    assert (results.timing.link.lost, results.timing.link.restarts) == (0, 0)
    assert REAL
