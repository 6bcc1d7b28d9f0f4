"""The audit of order: the same scenes, the sentence the other way round."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from cognitivedrone.audit import run as run_module
from cognitivedrone.audit.catalogue import AUDITS
from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.audit.run import audit
from cognitivedrone.audit.scenes import in_order
from cognitivedrone.plan import PilotSpec, TaskSource
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.format import write_tasks
from cognitivedrone.tasks.missions import sub_goals
from cognitivedrone.tasks.suites import suite_from_files
from cognitivedrone.tasks.validate import validate_task

MISSIONS = load_suite("open-v3:missions")


def both(track, seed=0):
    return [in_order(swapped=swapped)(np.random.default_rng(seed), track) for swapped in (False, True)]


def test_only_sentence_and_right_gates_change_places():
    found = [pair for pair in (both(track) for track in MISSIONS.tracks) if pair[0] is not None]
    assert len(found) > 100
    for plain, swapped in found:
        assert [task.labels for task in plain] == [task.labels for task in swapped]
        assert [task.gates for task in plain] == [task.gates for task in swapped]
        for track in (plain, swapped):
            for task in track:
                validate_task(task, task.id)
            assert [goal.kind for goal in sub_goals(track[0].mission)] == ["fly", "fly"]
        rights = [[task.labels[task.target] for task in track] for track in (plain, swapped)]
        assert rights[0] == rights[1][::-1]
        assert rights[0][0] != rights[0][1]
        assert plain[0].mission != swapped[0].mission


def test_the_page_says_how_many_runs_missions_are():
    variants = [variant for each in AUDITS for variant in each.variants]
    runs = 1 + sum(variant.change is None for variant in variants)
    page = (Path(__file__).parents[2] / "docs" / "audit.md").read_text()
    assert f"those of missions {runs};" in page


def test_a_mission_is_a_track_of_a_task_file(tmp_path):
    tracks = MISSIONS.tracks[:12]
    assert all(one[0].mission != two[0].mission for one, two in pairwise(MISSIONS.tracks))
    write_tasks(tmp_path / "mine.json", [task for track in tracks for task in track])
    assert suite_from_files(tmp_path / "mine.json").tracks == tracks


def test_a_landing_ends_a_mission_of_a_task_file(tmp_path):
    track = MISSIONS.tracks[5]
    again = tuple(replace(task, id=f"again/{number}") for number, task in enumerate(track))
    write_tasks(tmp_path / "mine.json", [*track, *again])
    assert suite_from_files(tmp_path / "mine.json").tracks == (track, again)


def test_the_order_is_flown_in_missions_and_nothing_that_is_for_single_tasks(tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "FEWEST_FLIGHTS", 1)
    plan = AuditPlan(
        PilotSpec("oracle", "none"), TaskSource("open-v3:missions"), episodes=1,
        only=("order swapped", "mirrored stage"), workers=0, out=tmp_path / "audit",
    )  # fmt: skip
    rows = audit(plan, progress=False)
    assert [(row.audit, row.variant) for row in rows[1:]] == [
        ("order swapped", "in order"), ("order swapped", "the other way round")
    ]  # fmt: skip
    assert [(row.n, row.rate, row.sound) for row in rows] == [(2, 1.0, True)] * 3
    first = suite_from_files(plan.out / "order-swapped-in-order.json").tracks
    assert len(first) == 1
    assert len(first[0]) == 2
