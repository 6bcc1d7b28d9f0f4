"""Write the table of docs/leaderboard.md from the files in leaderboard/.

Run: python scripts/render_leaderboard.py [--check]

With --check nothing is written; the exit code is 1 if the page is not up to date.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from cognitivedrone.benchmark.submission import leaderboard, markdown, read_submission

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "leaderboard.md"
SUITES = ("open-v2:words", "open-v2:pictures", "open-v1:unseen", "open-v1:test", "open-v1:hard")
"""Columns: held-out suites first."""
_PLACE = re.compile(r"(<!-- leaderboard -->\n).*?(<!-- end -->)", re.DOTALL)


def rendered() -> str:
    """The page with the table of the committed files."""
    submissions = [read_submission(path) for path in sorted((ROOT / "leaderboard").glob("*.json"))]
    table = markdown(leaderboard(submissions, SUITES), SUITES)
    return _PLACE.sub(lambda found: f"{found[1]}{table}{found[2]}", PAGE.read_text(encoding="utf-8"))


def main() -> int:
    """Write the page, or compare it."""
    page = rendered()
    if "--check" in sys.argv[1:]:
        return int(page != PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(page, encoding="utf-8")
    print(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
