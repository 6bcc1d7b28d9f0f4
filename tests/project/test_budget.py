"""The lines of Python that each part may have (`budget.toml`): what nobody counts grows."""

import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "cognitivedrone"


def test_no_part_of_the_project_is_over_its_budget():
    budget = tomllib.loads((ROOT / "budget.toml").read_text())
    lines: Counter[str] = Counter()
    for top in (PACKAGE, *(ROOT / name for name in ("tests", "benchmarks", "scripts"))):
        for file in top.rglob("*.py"):
            part = file.relative_to(PACKAGE).parts[0] if top == PACKAGE else top.name
            lines[part if part[-3:] != ".py" else "modules"] += file.read_bytes().count(b"\n")
    assert set(budget) == set(lines), "budget.toml has a line for every package, and for nothing else"
    over = {part: f"{count - budget[part]} lines over {budget[part]}" for part, count in lines.items()}
    assert not {part: text for part, text in over.items() if lines[part] > budget[part]}
