"""Animals, food and objects asked for by their name: "the banana".

People ask so first, but the suites only ask for animals so; for food and objects, by what is true of them.
"""

from __future__ import annotations

import functools
import re

from cognitivedrone.tasks import knowledge, wording
from cognitivedrone.tasks.families.symbols import RIVALS
from cognitivedrone.tasks.generate import Draw, Puzzle, article, words
from cognitivedrone.tasks.vocabulary import ANIMALS, FOODS, OBJECTS

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
