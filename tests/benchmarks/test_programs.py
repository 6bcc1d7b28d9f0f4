"""What lies in benchmarks/ measures a figure of the docs."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAMS = {path.stem: path.read_text() for path in (ROOT / "benchmarks").glob("*.py")}


def test_every_program_is_named_by_a_page_or_a_target_of_make_or_imported_by_another_program():
    files = (ROOT / "README.md", ROOT / "Makefile", *(ROOT / "docs").rglob("*.md"))
    pages = "".join(page.read_text() for page in files)
    named = set(re.findall(r"benchmarks/(\w+)\.py", pages))
    imported = set(re.findall(r"^\s*(?:from|import) (\w+)", "".join(PROGRAMS.values()), re.MULTILINE))
    assert set(PROGRAMS) - named - imported == set()
