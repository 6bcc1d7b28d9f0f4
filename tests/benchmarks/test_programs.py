"""What lies in benchmarks/ measures a figure of the docs."""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import card

ROOT = Path(__file__).parents[2]
PROGRAMS = {path.stem: path.read_text() for path in (ROOT / "benchmarks").glob("*.py")}


def test_every_program_is_named_by_a_page_or_a_target_of_make_or_imported_by_another_program():
    files = (ROOT / "README.md", ROOT / "Makefile", *(ROOT / "docs").rglob("*.md"))
    pages = "".join(page.read_text() for page in files)
    named = set(re.findall(r"benchmarks/(\w+)\.py", pages))
    imported = set(re.findall(r"^\s*(?:from|import) (\w+)", "".join(PROGRAMS.values()), re.MULTILINE))
    assert set(PROGRAMS) - named - imported == set()


def test_every_part_of_those_for_a_card_is_a_program_with_these_options(tmp_path):
    assert sum(part.limit_s for part in card.PARTS) <= card.SECONDS + 30
    for part in card.PARTS:
        _, script, *options = card.command_of(part, tmp_path)
        source = Path(script).read_text()
        assert [option for option in options if option.startswith("--") and f'"{option}"' not in source] == []
