"""Files of results from the folders of runs: what `runs/reproduce.sh` flew becomes RESULTS/*.json.

Run: python scripts/keep_results.py OUT RESULTS [PAGES]

Each folder OUT/scores/PILOT with its runs becomes the submission RESULTS/PILOT.json, OUT/reason/* becomes
RESULTS/reasoner_alone.json, and OUT/audit/PILOT becomes RESULTS/audit_PILOT.json; RESULTS/training_times.json has the
times of the training runs in OUT. Partial runs are left out, and named.

With PAGES, the folder of the files that pages show, they are copied there. Runs of other weights than the new ones stay
there as PILOT_before.json: pages show them, marked, where there is no newer run. Runs of the same weights that were not
flown again stay where they are.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

from cognitivedrone.audit.catalogue import AUDITS
from cognitivedrone.audit.run import AUDIT_FILE
from cognitivedrone.benchmark.measurements import Measurement, measurement, write_measurement
from cognitivedrone.benchmark.reasoning.reason import SUMMARY_FILE
from cognitivedrone.benchmark.scores.results import RESULTS_FILE, dumps, read_results
from cognitivedrone.benchmark.submission import submission_of, write_submission
from cognitivedrone.errors import RunError

BY = "CognitiveDrone"
WEIGHTS = ("model", "reasoner_model")


def main(out: Path, results: Path, pages: Path | None = None) -> None:
    """Write the files."""
    for folder in sorted((out / "scores").glob("*")):
        keep_pilot(sorted(path.parent for path in folder.glob(f"*/{RESULTS_FILE}")), results / f"{folder.name}.json")
    keep_trainings(sorted(out.glob("*/metrics.jsonl")), results / "training_times.json")
    keep_reasoner(sorted((out / "reason").glob(f"*/{SUMMARY_FILE}")), results / "reasoner_alone.json")
    for path in sorted((out / "audit").glob(f"*/{AUDIT_FILE}")):
        keep_audit(path, results / f"audit_{path.parent.name}.json")
    for path in sorted(results.glob("*.json")) if pages else []:
        shown = pages / path.name
        if not (shown.is_file() and weights_of(path)):
            shutil.copyfile(path, shown)
        elif weights_of(shown) - weights_of(path):
            if len(not_again(shown, path)) >= len(not_again(before := pages / f"{path.stem}_before.json", path)):
                shown.replace(before)
            shutil.copyfile(path, shown)
        else:
            document = json.loads(path.read_text(encoding="utf-8"))
            document["runs"] += not_again(shown, path)
            shown.write_text(dumps(document) + "\n", encoding="utf-8")


def not_again(former: Path, new: Path) -> list[dict[str, Any]]:
    """The runs of a former file that the new one does not hold."""
    flown = [flown_as(run) for run in runs_in(new)]
    return [run for run in runs_in(former) if flown_as(run) not in flown]


def runs_in(path: Path) -> list[dict[str, Any]]:
    """The runs of a submission; none of any other file, or where there is none."""
    runs: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8")).get("runs", []) if path.is_file() else []
    return runs


def flown_as(run: dict[str, Any]) -> tuple[Any, ...]:
    """What a run flew, but for the weights."""
    options = {name: value for name, value in run["run"]["options"].items() if name not in WEIGHTS}
    return run["run"]["suite"], options


def weights_of(path: Path) -> set[tuple[str | None, ...]]:
    """The weights that a submission's runs flew with, by their hashes; none of any other file."""
    return {tuple(each["run"]["options"].get(name) for name in WEIGHTS) for each in runs_in(path)}


def keep_pilot(folders: list[Path], path: Path) -> None:
    """A submission of the whole runs of a pilot."""
    whole = []
    for folder in folders:
        try:
            submission_of([folder], path.stem, BY)
        except RunError as error:
            print(error)
        else:
            whole.append(folder)
    if whole:
        write_submission(path, submission_of(whole, path.stem, BY))
        print(path)


def keep_reasoner(paths: list[Path], path: Path) -> None:
    """A reasoner's counts on every suite."""
    documents = [json.loads(each.read_text(encoding="utf-8")) for each in paths]
    rows = []
    for document in documents:
        scores = document["scores"]
        row = {"suite": document["suite"]["name"], "n": scores["overall"]["n"], "right": scores["overall"]["right"]}
        if scores["calibration_error"] is not None:
            row |= {"confidences": scores["rated"], "calibration_error": scores["calibration_error"]}
        rows.append(row)
    if rows:
        what, last = "The reasoner alone, from the first frame of every task", documents[-1]
        command, facts = "cognitivedrone reason --reasoner small --suite S", last["platform"]
        write(path, measurement(what, command, rows, seed=0, facts=facts, finished=last["finished"]))


def keep_trainings(paths: list[Path], path: Path) -> None:
    """Steps and times of training runs by the rates of their rounds, so without the pauses after a stop."""
    rows = []
    for each in paths:
        rounds = [json.loads(line) for line in each.read_text(encoding="utf-8").splitlines()]
        recipe = json.loads((each.parent / "recipe.json").read_text(encoding="utf-8"))["recipe"]
        ends = [0, *(row["step"] for row in rounds)]
        seconds = sum(
            (end - start) / row["steps_per_s"] for start, end, row in zip(ends, ends[1:], rounds, strict=False)
        )
        if ends[-1] < recipe["steps"]:
            print(f"{each.parent} is not finished: {ends[-1]} of {recipe['steps']} steps")
            continue
        row = {"run": each.parent.name, "recipe": recipe["name"], "steps": ends[-1]}
        rows.append({**row, "steps_per_s": round(ends[-1] / seconds, 2), "minutes": round(seconds / 60, 1)})
    if rows:
        write(path, measurement("Times of training runs", "runs/reproduce.sh", rows, seed=0))


def keep_audit(source: Path, path: Path) -> None:
    """The rows of an audit, with counts instead of rates."""
    document = json.loads(source.read_text(encoding="utf-8"))
    baseline = read_results(source.parent / "baseline")
    pilot = f"--policy {document['policy']} --reasoner {document['reasoner']}"
    suite = document["suite"]["name"].partition("[")[0]
    command = f"cognitivedrone audit {pilot} --episodes {document['episodes']} --suite {suite}"
    made = {row["audit"] for row in document["rows"]} - {"baseline"}
    if len(made) < len(AUDITS):
        command += " --only " + " ".join(f'"{each.name}"' for each in AUDITS if each.name in made)
    names = ("audit", "variant", "expected", "n", "declined", "chosen", "sound")
    rows = [
        {**{name: row[name] for name in names}, "right": round(row["n"] * (row["rate"] or 0))}
        | {name: row[name] for name in ("outcomes",) if name in row}  # not in older audits
        for row in document["rows"]
    ]
    facts, finished = baseline.platform, baseline.timing.finished
    what = "A pilot under changes"
    write(path, measurement(what, command, rows, seed=document["seed"], facts=facts, finished=finished))


def write(path: Path, made: Measurement) -> None:
    """Write and say so."""
    write_measurement(path, made)
    print(path)


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4) or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(*map(Path, sys.argv[1:]))
