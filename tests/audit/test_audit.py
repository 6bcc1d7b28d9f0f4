"""Audits flown for real with pilots whose shortcuts are known, also in the order of missions."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.audit import run as run_module
from cognitivedrone.audit.catalogue import AUDITS, Filter, FilteredPolicy, FilteredReasoner
from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.audit.run import FEWEST_FLIGHTS, Row, audit, audit_table, folder_of, is_sound, render_audit
from cognitivedrone.audit.scenes import in_order
from cognitivedrone.benchmark.reports.tables import as_text
from cognitivedrone.benchmark.scores.scoring import wilson
from cognitivedrone.cli import main, scoring
from cognitivedrone.errors import RunError
from cognitivedrone.plan import PilotSpec, TaskSource
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.format import write_tasks
from cognitivedrone.tasks.missions import sub_goals
from cognitivedrone.tasks.suites import suite_from_files
from cognitivedrone.tasks.validate import validate_task
from cognitivedrone.types import StageResult
from cognitivedrone.world import places


def plan_of(tmp_path, *only, policy="oracle", reasoner="none", episodes=2):
    pilot = PilotSpec(policy, reasoner)
    return AuditPlan(
        pilot, TaskSource("open-v1:smoke"), episodes=episodes, only=only, workers=0, out=tmp_path / "audit"
    )


def test_a_pilot_that_knows_the_answer_is_found_out_by_the_missing_question(tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "FEWEST_FLIGHTS", 3)
    plan = plan_of(tmp_path, "no question", episodes=4)
    rows = audit(plan, progress=False)
    assert [row.variant for row in rows] == ["as it is", "blank", "random words", "random letters"]
    assert all(row.rate == 1.0 for row in rows)
    assert [row.sound for row in rows] == [True, False, False, False]
    document = json.loads((plan.out / "audit.json").read_text())
    assert document["policy"] == "oracle"
    assert len(document["rows"]) == len(rows)
    assert document["rows"][0]["outcomes"] == {"passed": 4}
    before = (plan.out / "baseline" / "episodes.jsonl").stat().st_mtime_ns
    assert audit(plan, progress=False) == rows  # nothing is flown again
    assert (plan.out / "baseline" / "episodes.jsonl").stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("expected", "right", "n", "sound"),
    [
        ("as before", 70, 100, True),  # before: 80
        ("as before", 69, 100, False),
        ("follows", 91, 100, True),  # the interval reaches 95 %
        ("follows", 88, 100, False),
        ("same choice", 91, 100, True),
        ("same choice", 88, 100, False),
        ("chance", 49, 100, True),  # the interval reaches 40 %
        ("chance", 50, 100, False),
        ("chance", 18, 100, True),
        ("chance", 17, 100, False),
    ],
)
def test_what_a_row_must_reach(expected, right, n, sound):
    assert is_sound(expected, right / n, wilson(right, n), 0.8) is sound


def stage(task_id, chosen, outcome="passed"):
    return StageResult(task_id, "reasoning", "food", 0, outcome, chosen, 5.0, 6.0, None, None, None)


def test_a_pilot_that_hovers_gives_nothing_away(monkeypatch):
    monkeypatch.setattr(run_module, "FEWEST_FLIGHTS", 1)
    (question,) = (each for each in AUDITS if each.name == "no question")
    row = run_module._row(question, question.variants[0], [stage("a", None, "timeout")], {})
    assert (row.chosen, row.outcomes, row.rate, row.sound) == ((0, 0, 0, 1), {"timeout": 1}, None, True)


def test_the_same_choice_is_that_of_the_plain_room_right_or_wrong():
    (another,) = (each for each in AUDITS if each.name == "another place")
    before = {"a": stage("a", 0), "b": stage("b", 1, "wrong_gate"), "c": stage("c", 2)}
    there = [stage("a", 0), stage("b", 1, "wrong_gate"), stage("c", 0), stage("not flown before", 0)]
    row = run_module._row(another, another.variants[0], there, before)
    assert (row.n, row.rate, row.baseline) == (3, 2 / 3, 2 / 3)


def test_places_are_flown_and_known_by_their_names(tmp_path):
    rows = audit(plan_of(tmp_path, "another place", "place alone", episodes=1), progress=False)
    assert [(row.audit, row.variant) for row in rows[1:]] == [
        ("another place", "forest"), ("another place", "warehouse"), ("another place", "city"),
        ("place alone", "blank"),
    ]  # fmt: skip
    assert [row.rate for row in rows] == [1.0] * 5
    run = json.loads((tmp_path / "audit" / "another-place-forest" / "run.json").read_text())
    assert (run["options"]["appearance"], run["options"]["place"]) == ("photo", "forest")
    kept = {variant.options["place"] for each in AUDITS for variant in each.variants if "place" in variant.options}
    assert kept <= {"kept", *places.names("kept")}


def test_options_and_cameras_reach_the_flight(tmp_path):
    pilot = {"policy": "colour_seeker", "reasoner": "oracle"}
    rows = audit(plan_of(tmp_path, "wind", "camera roll", **pilot, episodes=1), progress=False)
    assert [(row.audit, row.variant) for row in rows[1:]] == [
        ("wind", "1 m/s"), ("wind", "2 m/s"), ("wind", "4 m/s"),
        ("camera roll", "3 degrees"), ("camera roll", "6 degrees"), ("camera roll", "12 degrees"),
    ]  # fmt: skip
    run = json.loads((tmp_path / "audit" / "wind-4-m-s" / "run.json").read_text())
    assert run["options"]["wind_m_s"] == 4.0
    run = json.loads((tmp_path / "audit" / "camera-roll-12-degrees" / "run.json").read_text())
    assert run["policy"] == 'cognitivedrone.audit.catalogue:FilteredPolicy:"colour_seeker",roll_deg=12'
    assert "FilteredReasoner" in run["reasoner"]


def test_what_cannot_be_audited_is_reported(tmp_path):
    with pytest.raises(RunError, match="unknown audit 'winds'; did you mean 'wind'"):
        audit(plan_of(tmp_path, "winds"), progress=False)
    with pytest.raises(RunError, match="no task with three gates"):
        audit(AuditPlan(source=TaskSource("open-v1:race"), out=tmp_path), progress=False)
    assert str(folder_of(AuditPlan())) == "results/audit-open-v1-test-small-none"


def test_the_help_says_how_many_runs_all_audits_are():
    runs = 1 + sum(variant.mission is None for each in AUDITS for variant in each.variants)
    assert f"All audits are {runs} runs" in (scoring.audit.__doc__ or "")
    assert f"{runs * AuditPlan().episodes:,} by default" in (scoring.audit.__doc__ or "")


def test_a_filter_changes_what_it_says():
    rng = np.random.default_rng(0)
    image = np.kron(rng.integers(0, 256, (16, 16, 3)), np.ones((16, 16, 1))).astype(np.uint8)
    np.testing.assert_array_equal(Filter()(image), image)
    np.testing.assert_allclose(Filter(light=0.5)(image), image * 0.5 ** (1 / 2.2), atol=1)
    np.testing.assert_array_equal(Filter(shift_px=8)(image)[8:, 8:], image[:-8, :-8])
    turned = Filter(roll_deg=90)(image)
    assert np.abs(turned.astype(int)[4:-4, 4:-4] - np.rot90(image)[4:-4, 4:-4].astype(int)).mean() < 8
    assert turned.shape == image.shape
    assert turned.dtype == np.uint8


def test_a_filtered_pilot_is_its_pilot():
    policy = FilteredPolicy("oracle", light=0.5)
    assert policy.needs_ground_truth
    assert not policy.declines
    assert policy.present is None
    reasoner = FilteredReasoner("noisy-oracle:0.8")
    assert reasoner.needs_ground_truth
    policy.close()
    reasoner.close()


def test_the_table_and_the_page_say_what_is_not_sound():
    rows = [
        Row("baseline", "as it is", "as before", 40, 1.0, (0.9, 1.0), 1.0, 0, (20, 10, 10, 0), True, {"passed": 40}),
        Row("no question", "blank", "chance", 40, 1.0, (0.9, 1.0), 1.0, 0, (20, 10, 10, 0), False, {"passed": 40}),
        Row("no question", "random words", "chance", 0, None, None, None, 40, (0, 0, 0, 40), True, {"false_alarm": 40}),
        Row("wind", "4 m/s", "as before", 4, 1.0, (0.5, 1.0), 1.0, 0, (2, 1, 1, 0), None, {"passed": 4}),
    ]
    plan = AuditPlan(PilotSpec("<b>mine</b>", "oracle"))
    lines = [line.split() for line in as_text(audit_table(plan, rows)).splitlines()]
    assert ["no", "question"] in lines
    assert ["blank", "40", "100.0", "%", "90.0", "to", "100.0", "100.0", "%", "0", "NO"] in lines
    assert ["4", "m/s", "4", "100.0", "%", "50.0", "to", "100.0", "100.0", "%", "0", "too", "few"] in lines
    page = render_audit(plan, rows)
    assert "<b>mine" not in page
    assert "<title>&lt;b&gt;mine&lt;/b&gt;, audit on open-v1:test – CognitiveDrone</title>" in page
    assert "1 of 4 runs are not" in page
    assert f"1 of 4 runs have fewer than {FEWEST_FLIGHTS} flights" in page
    assert page.count("too few flights</span>") == 1
    assert AUDITS[0].question in page


def test_the_table_cuts_no_number_in_80_columns():
    names = [(each.name, variant.name) for each in AUDITS for variant in each.variants]
    rows = [
        Row(*name, "as before", 1000, 1.0, (0.999, 1.0), 1.0, 1000, (500, 400, 100, 0), None, {"passed": 1000})
        for name in [*names, ("another audit", "a variant with a name that does not fit")]
    ]
    text = as_text(audit_table(AuditPlan(), rows))
    assert "…" not in text
    assert text.count(" 1000  100.0 %  99.9 to 100.0  100.0 %      1000  too few") == len(rows)
    for each in AUDITS:
        assert [line.strip() for line in text.splitlines()].count(each.name) == 1


def test_the_command_prints_the_table_and_writes_the_page_and_too_few_flights_are_neither_sound_nor_not(
    tmp_path, capsys
):
    out = tmp_path / "audit"
    words = ["audit", "--policy", "oracle", "--suite", "open-v1:smoke", "--episodes", "1", "--only", "mirrored stage"]
    main([*words, "--workers", "0", "--out", str(out)])
    shown = capsys.readouterr()
    assert "mirrored stage" in shown.out
    assert "audit 1/2: baseline, as it is\n" in shown.err
    assert "audit 2/2: mirrored stage, mirrored\n" in shown.err
    assert (out / "audit.html").read_text().startswith("<!doctype html>")
    document = json.loads((out / "audit.json").read_text())
    assert [row["sound"] for row in document["rows"]] == [None, None]


MISSIONS = load_suite("open-v3:missions")


def both(track, seed=0):
    return [in_order(swapped=swapped)(np.random.default_rng(seed), track) for swapped in (False, True)]


def test_only_sentence_and_right_gates_change_places():
    found = [pair for pair in (both(track) for track in MISSIONS.tracks) if pair[0] is not None]
    assert len(found) > 100
    for number, (plain, swapped) in enumerate(found):
        assert [task.labels for task in plain] == [task.labels for task in swapped]
        assert [task.gates for task in plain] == [task.gates for task in swapped]
        for track in (plain, swapped):
            for task in track:
                validate_task(task, task.id)
            if number % 5 == 0:  # it takes long to read a sentence
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
