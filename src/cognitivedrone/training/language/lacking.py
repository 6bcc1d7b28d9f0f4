"""People asked for by what they lack: "the one without a beard". What `exclusion` is made of, by itself.

A network trained on two features, of which one must be absent, first learns to trust neither. Sentences about the
absent one alone teach it what "without" means.
"""

from __future__ import annotations

from cognitivedrone.tasks.families.human import person_lacking, person_with, random_features
from cognitivedrone.tasks.generate import Draw, Puzzle


def lacking(draw: Draw) -> Puzzle:
    """A person who lacks a feature that the two others have."""
    (absent,) = random_features(draw, 1)
    sentence = draw.say(
        "lacking",
        "Fly through the gate with the person who does not have {absent}",
        "Fly to the gate with the person without {absent}",
        absent=absent.phrase,
    )
    others = [draw.portrait(person_with(draw, [absent])) for _ in range(2)]
    return draw.puzzle(sentence, draw.portrait(person_lacking(draw, [], absent)), others)
