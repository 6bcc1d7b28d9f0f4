"""The tables of README and docs are made from committed files: pages, markers, descriptions and files fit together."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmark"))

import benchmark_fakes
import keep_results
import render_tables
import table_kinds
from doc_tables import TABLES
from table_kinds import NOT_MEASURED, Store, Table, cell

from cognitivedrone.audit.run import AUDIT_FILE
from cognitivedrone.benchmark.config import Plan, ReasonPlan
from cognitivedrone.benchmark.measurements import Measurement, read_measurement, write_measurement
from cognitivedrone.benchmark.reasoning.reason import score_reasoner
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.submission import read_submission
from cognitivedrone.plan import Scenario

ROOT = Path(__file__).resolve().parents[2]
MADE = Measurement(
    "Gates", "python gates.py", "a chip, 3 cores", "2026-03-04", "0123456789abcdef", 0, {},
    ({"gate": "red", "ms": 1.25},),
)  # fmt: skip
GATES = {"gates": table_kinds.rows_of("gates", {"gate": "{gate}", "time": "{ms:.1f} ms"})}
PAGE = "# Gates\n\n<!-- table: gates -->\n<!-- end -->\n"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A small project with one table, rendered."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("# Nothing\n")
    write_measurement(tmp_path / "results" / "gates.json", MADE)
    page = tmp_path / "docs" / "gates.md"
    page.write_text(render_tables.rendered(PAGE, Store(tmp_path), GATES))
    return tmp_path


def test_the_pages_show_the_committed_files() -> None:
    assert render_tables.problems(ROOT) == []


def test_every_file_that_a_table_needs_is_there_or_comes_out_of_the_script() -> None:
    store = Store(ROOT)
    for describe in TABLES.values():
        describe(store)
    script = "".join((ROOT / "runs" / f"{name}.sh").read_text() for name in ("reproduce", "measure"))
    made = {*re.findall(r"^ *(?:measure|bench) (\w+) ", script, flags=re.MULTILINE)}
    made |= {"reasoner_alone", "r1_latency"} & {*re.findall(r"results/(\w+)\.json", script)}
    made |= {f"recorded_{flights}" for flights in re.search(r"sets=\((.*?)\)", script)[1].split()}
    made |= {f"audit_{pilot}" for pilot in re.findall(r"/audit/(\w+)", script)}
    there = {path.stem for path in (ROOT / "results").glob("*.json")}
    assert store.asked <= made | there
    for benchmark in re.findall(r"^ *measure \w+ (\w+)", script, flags=re.MULTILINE):
        assert "--out" in (ROOT / "benchmarks" / f"{benchmark}.py").read_text(), benchmark


def test_cases_that_were_flown_often_are_counted(root: Path) -> None:
    def flown(name: str, good: bool, down: float | None, end: str) -> dict[str, Any]:
        return {"name": name, "good": good, "down_s": down, "end": end}

    rows = (flown("a", True, 2.0, "landed"), flown("b", True, None, "refused: x"), flown("a", False, 5.0, "landed"))
    write_measurement(root / "results" / "old.json", replace(MADE, rows=rows))
    table = table_kinds.repeated({"old": "4.6", "new": "4.7"})(Store(root))
    assert table.heads[2:] == ["4.6: as it must", "4.6: motors stopped", "4.7: as it must", "4.7: motors stopped"]
    assert table.rows == [
        ["a", "landed", "1 of 2", "3.5, 5.0 s", NOT_MEASURED, ""],
        ["b", "refused", "1 of 1", "–", NOT_MEASURED, ""],
    ]


def test_a_table_names_its_file_command_machine_day_and_commit(root: Path) -> None:
    text = (root / "docs" / "gates.md").read_text()
    assert "| gate | time |\n|---|---|\n| red | 1.2 ms |\n" in text
    assert "`results/gates.json`: `python gates.py`, a chip, 3 cores, 2026-03-04, commit 0123456789." in text
    assert render_tables.problems(root, GATES) == []
    assert render_tables.rendered(text, Store(root), GATES) == text


@pytest.mark.parametrize("where", ["file", "page"])
def test_a_changed_figure_is_found(root: Path, where: str) -> None:
    page = root / "docs" / "gates.md"
    if where == "file":
        write_measurement(root / "results" / "gates.json", replace(MADE, rows=({"gate": "red", "ms": 1.5},)))
    else:
        page.write_text(page.read_text().replace("1.2 ms", "0.2 ms"))
    assert [found for found in render_tables.problems(root, GATES) if "gates.md does not show" in found]


def test_what_is_left_over_is_found(root: Path) -> None:
    write_measurement(root / "results" / "old.json", MADE)
    assert render_tables.problems(root, GATES) == ["results/old.json is in no table"]
    more = {**GATES, "unused": lambda _: Table([])}
    assert "no page has a marker for the table 'unused'" in render_tables.problems(root, more)
    page = root / "docs" / "gates.md"
    page.write_text(PAGE.replace("gates -->", "others -->"))
    assert any("'others', which nothing describes" in found for found in render_tables.problems(root, GATES))
    page.write_text(PAGE.replace("<!-- end -->", ""))
    assert any("no `<!-- end -->` closes" in found for found in render_tables.problems(root, GATES))


def test_a_file_that_is_missing_is_an_error(root: Path) -> None:
    (root / "results" / "gates.json").unlink()
    with pytest.raises(Exception, match=r"gates\.json cannot be read"):
        render_tables.problems(root, GATES)


@pytest.mark.parametrize(
    ("template", "row", "shown"),
    [
        ("{ms:.1f} ms", {"ms": 2}, "2.0 ms"),
        ("{ms:.1f} ms", {}, ""),
        ("{ms:.1f}", {"ms": None}, "–"),
        ("{ms:.0f}", {"ms": [1.2, None, "none"]}, "1, –, none"),
        ("{part:.1%}", {"part": 0.125}, "12.5 %"),
        ("{n:,}", {"n": 8062}, "8,062"),
    ],
)
def test_cells(template: str, row: dict, shown: str) -> None:
    assert cell(template, row) == shown


def test_a_suite_with_conditions_of_its_own_is_shown_under_these() -> None:
    """`open-v3:wild` is flown in wind: what a run calls `wind_m_s`."""
    assert table_kinds.own_options("open-v3:wild") == {"appearance": "varied", "wind_m_s": 2.0}
    assert table_kinds.own_options("open-v3:places") == {"appearance": "photo", "place": "kept"}
    assert table_kinds.own_options("open-v1:test") == {}
    table, runs = TABLES["opened-last"](Store(ROOT)), read_submission(ROOT / "results" / "small.json").runs
    (wild,) = (made for made in runs if made.run.suite.name == "open-v3:wild")
    (row,) = (row for row in table.rows if row[0].startswith("**`small`**"))
    assert row[table.heads.index("`open-v3:wild`")].startswith(f"{100 * wild.overall.rate:.1f} (")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders as the script leaves them: made-up flights of a whole suite, and a part of one."""
    out = tmp_path_factory.mktemp("reproduce")
    runs: dict[str, dict[str, Any]] = {
        "open-v1-test": {},
        "open-v1-test+wind": {"wind": 0.5},
        "open-v1-hard": {"episodes": 2},
    }
    for name, options in runs.items():
        plan = Plan.of(
            policy="fake", suite=name.partition("+")[0].replace("v1-", "v1:"), workers=0, clips=0,
            out=out / "scores" / "small" / name, **options,
        )  # fmt: skip
        run(plan, progress=False, runner=benchmark_fakes.FakeRunner)
    audit = out / "audit" / "small"
    audit.mkdir(parents=True)
    (audit / "baseline").symlink_to(out / "scores" / "small" / "open-v1-test")
    row = {"audit": "wind", "variant": "4 m/s", "expected": "as before", "n": 8, "rate": 0.25, "sound": False}
    row |= {"declined": 0, "chosen": [1, 2, 3, 2]}
    document = {"policy": "fake", "reasoner": "none", "episodes": 8, "suite": {"name": "open-v1:test"}, "seed": 0}
    fewer = row | {"variant": "2 m/s", "sound": None, "outcomes": {"passed": 2, "missed": 6}}
    (audit / AUDIT_FILE).write_text(json.dumps({**document, "rows": [row, fewer]}))
    for name, steps in {"flight": 20, "stopped": 10}.items():
        training = out / name
        training.mkdir()
        (training / "recipe.json").write_text(json.dumps({"recipe": {"name": "flight", "steps": 20}, "seed": 0}))
        rounds = [{"step": step, "steps_per_s": step / 20} for step in range(10, steps + 1, 10)]
        (training / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rounds))
    answers = out / "reason" / "open-v1-test"
    score_reasoner(
        ReasonPlan(Scenario(suite="open-v1:test"), "noisy-oracle:accuracy=0.5", episodes=4, out=answers), progress=False
    )
    return out


def test_runs_of_other_weights_stay_beside_the_new_ones(out: Path, tmp_path: Path) -> None:
    pages = tmp_path / "pages"
    pages.mkdir()
    for _ in range(2):
        keep_results.main(out, tmp_path / "results", pages)
        assert not (pages / "small_before.json").exists()
    former = json.loads((pages / "small.json").read_text())
    elsewhere = json.loads(json.dumps(former["runs"][0]))
    elsewhere["run"]["options"]["airframe"] = "iris"
    (pages / "small.json").write_text(json.dumps({**former, "runs": [*former["runs"], elsewhere]}))
    keep_results.main(out, tmp_path / "results", pages)  # of the same weights, what was not flown again stays
    assert json.loads((pages / "small.json").read_text())["runs"] == [*former["runs"], elsewhere]
    former["runs"][0]["run"]["options"]["model"] = "of before"
    (pages / "small.json").write_text(json.dumps(former))
    keep_results.main(out, tmp_path / "results", pages)
    assert json.loads((pages / "small_before.json").read_text()) == former
    assert (pages / "small.json").read_bytes() == (tmp_path / "results" / "small.json").read_bytes()


def test_runs_become_files_and_tables(out: Path, tmp_path: Path, capsys) -> None:
    keep_results.main(out, tmp_path / "results")
    output = capsys.readouterr().out
    assert "2 episodes only" in output
    assert "stopped is not finished: 10 of 20 steps" in output
    submission = read_submission(tmp_path / "results" / "small.json")
    assert [made.run.option("wind_m_s") for made in submission.runs] == [0.0, 0.5]
    (training,) = read_measurement(tmp_path / "results" / "training_times.json").rows
    assert training == {"run": "flight", "recipe": "flight", "steps": 20, "steps_per_s": 0.67, "minutes": 0.5}
    (alone,) = read_measurement(tmp_path / "results" / "reasoner_alone.json").rows
    assert (alone["suite"], alone["n"], alone["confidences"]) == ("open-v1:test", 4, 4)
    assert 0 <= alone["calibration_error"] <= 1

    store = Store(tmp_path)
    plain = submission.runs[0].overall
    headline = TABLES["headline"](store)
    small = next(row for row in headline.rows if row[0].startswith("**`small`**"))
    place = headline.heads.index("`open-v1:test`")
    assert small[place].startswith(f"{100 * plain.rate:.1f} (")
    assert {*small[1:place], *small[place + 1 :]} == {NOT_MEASURED}
    flags = [row[0] for row in TABLES["scores"](store).rows]
    assert flags == ["`--suite open-v1:test`", "`--suite open-v1:test --wind 0.5`"]
    elsewhere = {row[0]: row[1] for row in TABLES["small-elsewhere"](store).rows}
    assert elsewhere["`--wind 0.5`"] == f"{submission.runs[1].overall.passed} of 300"
    assert elsewhere["`--appearance varied`"] == NOT_MEASURED
    worth = {row[0]: row[-2:] for row in TABLES["r1"](store).rows}
    assert worth["`open-v1:test`"] == [
        f"{alone['right'] / 4:.1%}".replace("%", " %"),
        f"{alone['calibration_error']:.1%}".replace("%", " %"),
    ]
    families = {row[0]: row[1] for row in TABLES["small-families"](store).rows}
    assert families["attributes"].endswith(" of 50")
    assert sum(int(text.split(" of ")[0]) for text in families.values()) == plain.passed
    paper = {row[0]: row[1:] for row in TABLES["paper"](store).rows}
    assert sum(name.endswith("published") for name in paper) == 3
    assert paper["CognitiveDrone, ours on `open-v1:test`"][-1].startswith(f"{100 * submission.runs[0].mean:.1f} (")
    assert set(paper["RaceVLA, ours on `open-v2:words`"]) == {NOT_MEASURED}
    kept = read_measurement(tmp_path / "results" / "audit_small.json").rows
    assert [each.get("outcomes") for each in kept] == [None, {"passed": 2, "missed": 6}]
    audited, fewer = TABLES["audits"](store).rows
    assert fewer[3].endswith(", too few flights")
    assert audited[:3] == ["wind", "4 m/s", ""]
    assert audited[3].startswith("25.0 (")
    assert "not as a sound pilot" in audited[3]
