"""An audit flown for real with pilots whose shortcuts are known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cognitivedrone.audit.catalogue import AUDITS
from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.audit.filters import Filter, FilteredPolicy, FilteredReasoner
from cognitivedrone.audit.report import audit_table, render_audit
from cognitivedrone.audit.run import Row, audit, folder_of
from cognitivedrone.benchmark.tables import as_text
from cognitivedrone.cli import main
from cognitivedrone.errors import RunError
from cognitivedrone.plan import PilotSpec, TaskSource


def plan_of(tmp_path, *only, policy="oracle", reasoner="none", episodes=2):
    pilot = PilotSpec(policy, reasoner)
    return AuditPlan(
        pilot, TaskSource("open-v1:smoke"), episodes=episodes, only=only, workers=0, out=tmp_path / "audit"
    )


def test_a_pilot_that_knows_the_answer_is_found_out_by_the_missing_question(tmp_path):
    plan = plan_of(tmp_path, "no question", episodes=6)
    rows = audit(plan, progress=False)
    assert [row.variant for row in rows] == ["as it is", "blank", "random words", "random letters"]
    assert all(row.rate == 1.0 for row in rows)
    assert [row.sound for row in rows] == [True, False, False, False]
    document = json.loads((plan.out / "audit.json").read_text())
    assert document["policy"] == "oracle"
    assert len(document["rows"]) == len(rows)
    before = (plan.out / "baseline" / "episodes.jsonl").stat().st_mtime_ns
    assert audit(plan, progress=False) == rows  # nothing is flown again
    assert (plan.out / "baseline" / "episodes.jsonl").stat().st_mtime_ns == before


def test_a_pilot_that_hovers_gives_nothing_away(tmp_path):
    rows = audit(plan_of(tmp_path, "no question", policy="hover", episodes=1), progress=False)
    assert all(row.chosen == (0, 0, 0, 1) for row in rows)
    assert all(row.sound for row in rows)
    assert rows[1].rate is None


def test_options_and_cameras_reach_the_flight(tmp_path):
    rows = audit(plan_of(tmp_path, "wind", "camera roll", policy="colour_seeker", reasoner="oracle"), progress=False)
    assert [(row.audit, row.variant) for row in rows[1:]] == [
        ("wind", "1 m/s"), ("wind", "2 m/s"), ("wind", "4 m/s"),
        ("camera roll", "3 degrees"), ("camera roll", "6 degrees"), ("camera roll", "12 degrees"),
    ]  # fmt: skip
    run = json.loads((tmp_path / "audit" / "wind-4-m-s" / "run.json").read_text())
    assert run["options"]["wind_m_s"] == 4.0
    run = json.loads((tmp_path / "audit" / "camera-roll-12-degrees" / "run.json").read_text())
    assert run["policy"] == 'cognitivedrone.audit.filters:FilteredPolicy:"colour_seeker",roll_deg=12'
    assert "FilteredReasoner" in run["reasoner"]


def test_what_cannot_be_audited_is_said(tmp_path):
    with pytest.raises(RunError, match="unknown audit 'winds'; did you mean 'wind'"):
        audit(plan_of(tmp_path, "winds"), progress=False)
    with pytest.raises(RunError, match="no task with three gates"):
        audit(AuditPlan(source=TaskSource("open-v1:race"), out=tmp_path), progress=False)
    assert str(folder_of(AuditPlan())) == "results/audit-open-v1-test-small-none"


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
        Row("baseline", "as it is", "as before", 4, 1.0, (0.5, 1.0), 1.0, 0, (2, 1, 1, 0), sound=True),
        Row("no question", "blank", "chance", 4, 1.0, (0.5, 1.0), 1.0, 0, (2, 1, 1, 0), sound=False),
        Row("no question", "random words", "chance", 0, None, None, None, 4, (0, 0, 0, 4), sound=True),
    ]
    plan = AuditPlan(PilotSpec("<b>mine</b>", "oracle"))
    assert "NO" in as_text(audit_table(plan, rows), width=120)
    page = render_audit(plan, rows)
    assert "<b>mine" not in page
    assert "1 of 3 runs are not" in page
    assert AUDITS[0].question in page


def test_the_command_prints_the_table_and_writes_the_page(tmp_path, capsys):
    out = tmp_path / "audit"
    main(
        [
            "audit",
            "--policy",
            "oracle",
            "--suite",
            "open-v1:smoke",
            "--episodes",
            "1",
            "--only",
            "mirrored stage",
            "--workers",
            "0",
            "--out",
            str(out),
        ],
    )
    assert "mirrored stage" in capsys.readouterr().out
    assert (out / "audit.html").read_text().startswith("<!doctype html>")
