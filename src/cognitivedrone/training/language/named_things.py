"""Animals, food, objects and people asked for by their name, by what they lack, or by a name that nobody knows."""

from __future__ import annotations

import functools
import re
from dataclasses import replace

import numpy as np

from cognitivedrone.references import PERSON_ATTRIBUTES
from cognitivedrone.tasks import knowledge, wording
from cognitivedrone.tasks.families.human import person_lacking, person_with, random_features
from cognitivedrone.tasks.families.symbols import RIVALS
from cognitivedrone.tasks.generate import Draw, Puzzle, article, words
from cognitivedrone.tasks.people import CAST, IDENTITY, TRAIN_CAST, person_label, seen
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.tasks.vocabulary import ANIMALS, FOODS, OBJECTS
from cognitivedrone.training.language.wordings import wordings_of
from cognitivedrone.types import Task

NAMED = "named"
"""Family of these problems."""
THINGS: tuple[str, ...] = (
    *(f"animal/{name}" for name in ANIMALS),
    *(f"food/{name}" for name in FOODS),
    *(f"object/{name}" for name in OBJECTS),
)
SAME_KIND = 0.7
"""Share of scenes whose wrong panels are of the right one's kind."""

_CONFUSED = (
    ("object/car", "object/taxi"),
    ("object/mobile_phone", "object/telephone"),
    ("object/watch", "object/alarm_clock"),
    ("object/house", "object/castle"),
    ("object/light_bulb", "object/candle"),
    ("object/package", "object/gift"),
    ("object/boot", "object/sneaker"),
    ("object/sailboat", "object/canoe"),
    ("object/socks", "object/gloves"),
    ("object/couch", "object/chair"),
    ("object/paintbrush", "object/toothbrush"),
    ("object/envelope", "object/mailbox"),
    ("object/umbrella", "object/parachute"),
    ("food/burger", "food/sandwich"),
    ("food/shortcake", "food/birthday_cake"),
    ("food/shortcake", "food/cupcake"),
    ("food/birthday_cake", "food/cupcake"),
    ("food/peanuts", "food/chestnut"),
    ("food/ramen", "food/spaghetti"),
    ("food/pie", "food/shortcake"),
    ("food/fried_shrimp", "food/sushi"),
    ("food/egg", "animal/chicken"),
    ("food/tea", "food/coffee"),
    ("food/wine", "food/champagne"),
    ("food/soda", "food/bubble_tea"),
    ("food/soda", "food/juice_box"),
    ("food/chicken_leg", "food/steak"),
    ("food/bread", "food/sandwich"),
    ("object/globe", "object/map"),
)
"""Food and objects that look alike or share one of the names in `wordings/thing_names.txt`."""
_OF_ANIMALS = re.compile(r"animal|beast|critter|creature|friend|wild|poor|\bpet\b|feed|bites|ran away|hiding|scared")
"""Wordings that suit animals alone."""
_PLURAL = re.compile(r"(?<![aious])s$")


def named_thing(draw: Draw) -> Puzzle:
    """A thing by its name, beside two others that nobody would call so."""
    right = draw.pick(THINGS)
    kind, _, concept = right.partition("/")
    alike = draw.chance(SAME_KIND)
    wrong = [thing for thing in clearly_other(right) if not alike or thing.startswith(f"{kind}/")]
    name = words(concept)
    slots = {"x": name, "a": "some" if _PLURAL.search(name) else article(name)}
    nouns = draw.pools.wordings(wording.ANIMALS, slots)
    if kind != "animal":
        nouns = [noun for noun in nouns if not _OF_ANIMALS.search(noun)]
    panels = [draw.drawing(*thing.split("/")) for thing in (right, *draw.sample(wrong, 2))]
    return draw.puzzle(draw.frame(draw.pick(nouns).format(**slots)), panels[0], panels[1:])


@functools.cache
def clearly_other(thing: str) -> tuple[str, ...]:
    """The things for which another thing cannot be taken, by its looks or its name, in the order of `THINGS`."""
    return tuple(other for other in THINGS if other not in _called(thing) and thing not in _called(other))


@functools.cache
def _called(thing: str) -> frozenset[str]:
    """The things that might be called by the name of a thing, itself among them."""
    kind, _, concept = thing.partition("/")
    name = words(concept)
    called = {thing, *(other for other in THINGS if set(name.split()) & set(words(other.partition("/")[2]).split()))}
    if kind == "animal":
        called |= {f"animal/{rival}" for rival in RIVALS[concept]}
    called |= {pair[1 - pair.index(thing)] for pair in _CONFUSED if thing in pair}
    for claim in knowledge.claims():
        if thing in claim.true and name in (claim.value, claim.head):  # a fish, and all fish
            called |= claim.true
    return frozenset(called)


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
