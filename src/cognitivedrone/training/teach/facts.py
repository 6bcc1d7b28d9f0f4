"""What the user's own table says of their concepts: `facts.csv` beside the pictures, as statements of a lesson."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cognitivedrone.tasks.knowledge import Claim, own_claims
from cognitivedrone.training.language.fact_phrasing import AS_NOUN
from cognitivedrone.training.teach.statement import Statement

FACTS_FILE = "facts.csv"


def facts_file(labels: Path) -> Path | None:
    """The table of facts in a folder of pictures, if it has one."""
    path = labels / FACTS_FILE
    return path if path.exists() or path.is_symlink() else None  # a link to nothing is a mistake, not no table


def stated(path: Path, kinds: Mapping[str, str]) -> list[Statement]:
    """What the table in `path` says of the concepts of a lesson, given with the folder of each.

    Claims that single out none of the concepts are left out. Raises `TaskError` for a bad table.
    """
    names = {f"{kind}/{name.partition(':')[2]}": name for name, kind in kinds.items()}
    return [made for claim in own_claims(path, names) if (made := _statement(claim, names)) is not None]


def _statement(claim: Claim, names: Mapping[str, str]) -> Statement | None:
    true = tuple(sorted(names[thing] for thing in claim.true if thing in names))
    false = tuple(sorted(names[thing] for thing in claim.false if thing in names))
    if not true or len(false) < 2:
        return None
    phrases = tuple(frame.format(x=phrase.text) for phrase in claim.phrases for frame in AS_NOUN.get(phrase.form, ()))
    sentences = tuple(phrase.text for phrase in claim.phrases if phrase.form == "clause")
    return Statement(phrases, sentences, true, false) if phrases or sentences else None
