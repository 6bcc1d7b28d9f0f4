"""What is true of the things that panels show: a table of facts, and the phrases that ask for them.

The tables are CSV files beside this module, one row a concept; README.md describes them. `claims()` joins them: a claim
is one value of one property, with the things for which it clearly holds and clearly does not. A user's own file beside
their pictures adds to them (`own_claims`).
"""

from __future__ import annotations

from cognitivedrone.tasks.knowledge.own import own_claims
from cognitivedrone.tasks.knowledge.tables import Entry, Property, Table, load_table, table
from cognitivedrone.tasks.knowledge.wordings import FORMS, Claim, Phrase, Phrases, claims, load_phrases, make_claims

__all__ = [
    "FORMS",
    "Claim",
    "Entry",
    "Phrase",
    "Phrases",
    "Property",
    "Table",
    "claims",
    "load_phrases",
    "load_table",
    "make_claims",
    "own_claims",
    "table",
]
