"""Unknown identities: an unknown name beside two known people must mean the third."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cognitivedrone.references import PERSON_ATTRIBUTES
from cognitivedrone.tasks.people import CAST, IDENTITY, TRAIN_CAST, person_label, seen
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.training.language.wordings import wordings_of
from cognitivedrone.types import Task

UNKNOWN_NAMES = wordings_of("NAMES", whole=False)
"""Names of unknown people. No vocabulary of a training run has them among its trained words, so that another unknown
name is read alike: by its word vector and its spelling."""
_INVENTED = 0.3  # share of unknown people with a name that nobody has
_SYLLABLES = [consonant + vowel for consonant in "bdfgklmnprstvz" for vowel in "aeio"]
_ALIKE = 0.6  # share of unknown identities that look much like a known person


def with_unknown_person(rng: np.random.Generator, task: Task) -> Task:
    """A task of the family `people` about an unknown identity, who may look much like a known person."""
    near = rng.random() < _ALIKE
    while True:
        person = {key: values[int(rng.integers(len(values)))] for key, values in PERSON_ATTRIBUTES.items()}
        if near:
            like = CAST[TRAIN_CAST[int(rng.integers(len(TRAIN_CAST)))]]
            kept = set(rng.permutation(IDENTITY)[: len(IDENTITY) - 3].tolist())
            person |= {key: like.get(key, PERSON_ATTRIBUTES[key][0]) for key in kept}
        looks = seen(person)
        if all(sum(looks[k] != seen(CAST[n]).get(k) for k in IDENTITY if k != "skin") >= 2 for n in TRAIN_CAST):
            break
    first, second, third = (
        person_label(person, label.rpartition("@")[2]) if gate == task.target else label
        for gate, label in enumerate(task.labels)
    )
    instruction = task.instruction.replace(task.options[right_gate(task)], _unknown_name(rng))
    return replace(task, labels=(first, second, third), instruction=instruction)


def _unknown_name(rng: np.random.Generator) -> str:
    if rng.random() >= _INVENTED:
        return UNKNOWN_NAMES[int(rng.integers(len(UNKNOWN_NAMES)))]
    return "".join(_SYLLABLES[int(k)] for k in rng.integers(len(_SYLLABLES), size=int(rng.integers(2, 4)))).capitalize()
