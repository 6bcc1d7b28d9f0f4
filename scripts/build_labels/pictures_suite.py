"""Write the suite `open-v2:pictures`: tasks whose drawings are all of held-out sets.

Run: python scripts/build_labels/pictures_suite.py

A pure function of the label pack and the generators; a test compares it with the committed file.
"""

from __future__ import annotations

from pathlib import Path

import cognitivedrone.tasks
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks.build import suite_text
from cognitivedrone.tasks.families.pictures import PICTURES, STYLES, pictures_suite
from cognitivedrone.tasks.suites import file_of


def main() -> None:
    """Write the file."""
    path = Path(cognitivedrone.tasks.__file__).parent / "suites" / file_of(PICTURES)
    path.write_text(suite_text(PICTURES, pictures_suite(load_pack("open-v2"), STYLES).tracks), encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
