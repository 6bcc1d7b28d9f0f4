"""Human recognition: people by visible attributes, and a named cast."""

from __future__ import annotations

from cognitivedrone.references import PERSON_ATTRIBUTES
from cognitivedrone.tasks import wording
from cognitivedrone.tasks.generate import Draw, Panel, Puzzle
from cognitivedrone.tasks.people import CAST, FEATURES, TRAIN_CAST, Feature, Person

_HATS = {"none": 0.6, "hat": 0.12, "beanie": 0.12, "turban": 0.08, "hijab": 0.08}
_GLASSES = {"none": 0.5, "glasses": 0.15, "round": 0.15, "sunglasses": 0.1, "eyepatch": 0.1}
_BEARDS = {"none": 0.55, "full": 0.2, "stubble": 0.1, "moustache": 0.15}

_BY_PHRASE = {feature.phrase: feature for feature in FEATURES}

# Colours of one thing must not dominate: draw the thing first, then one phrase for it.
_THINGS: tuple[tuple[str, ...], ...] = tuple(
    tuple(f.phrase for f in FEATURES if f" {f.phrase}".endswith(f" {ending}"))
    for ending in (
        *("hat", "beanie", "turban", "headscarf", "hoodie", "T-shirt", "blazer", "overalls"),
        *("curly hair", "long hair", "bun", "afro", "dreadlocks", "shaved sides", "bald head"),
        *("brown hair", "black hair", "blond hair", "red hair", "gray hair", "pink hair"),
        *("glasses", "sunglasses", "eyepatch", "full beard", "moustache"),
        *("surprised look", "laughing face"),
    )
)
"""Groups of phrases, drawn with equal probability."""


def random_person(draw: Draw) -> Person:
    """A random person."""
    person = {name: draw.pick(values) for name, values in PERSON_ATTRIBUTES.items()}
    person["hat"] = draw.weighted(_HATS)
    person["glasses"] = draw.weighted(_GLASSES)
    person["beard"] = "none" if person["hat"] == "hijab" else draw.weighted(_BEARDS)
    return tidy(person)


def tidy(person: Person) -> Person:
    """The same picture without invisible attributes: hair under a hat, the colour of a missing hat."""
    hidden = ("hat_color",) if person.get("hat", "none") == "none" else ("hair",)
    return {name: value for name, value in person.items() if name not in hidden}


def impose(draw: Draw, person: Person, feature: Feature) -> Person:
    """The person, changed so that the feature is visible."""
    changed = person | {name: draw.pick(values) for name, values in feature.wanted.items()}
    if "hair" in feature.wanted or "hair_color" in feature.wanted:
        changed["hat"] = "none"
        if changed.get("hair", "bald") == "bald" and "hair" not in feature.wanted:
            changed["hair"] = draw.pick(PERSON_ATTRIBUTES["hair"][:-1])
    if changed.get("hat") == "hijab":
        # A headscarf covers chin and collar: the newer of the two stays.
        changed |= {"hat": "none"} if {"beard", "clothes"} & set(feature.wanted) else {"beard": "none"}
    return tidy(changed)


def random_features(draw: Draw, count: int) -> list[Feature]:
    """Features that one person can show together: never a hat and hair, or two features of the same attribute."""
    while True:
        features = [_BY_PHRASE[draw.pick(thing)] for thing in draw.sample(_THINGS, count)]
        touched = [name for feature in features for name in touched_parts(feature)]
        if len(touched) == len(set(touched)):
            return features


def touched_parts(feature: Feature) -> set[str]:
    """Body parts that a feature involves; features with disjoint parts can be combined."""
    parts = {"top" if name in ("hat", "hat_color", "hair", "hair_color") else name for name in feature.wanted}
    parts = {"clothes" if name == "clothes_color" else name for name in parts}
    if feature.wanted.get("hat") == ("hijab",):
        parts |= {"beard", "clothes"}
    return parts


def person_with(draw: Draw, features: list[Feature]) -> Person:
    """A person for whom all the features are clearly true."""
    while True:
        person = random_person(draw)
        for feature in features:
            person = impose(draw, person, feature)
        if all(feature.holds(person) is True for feature in features):
            return person


def person_lacking(draw: Draw, features: list[Feature], missing: Feature) -> Person:
    """A person for whom `missing` is clearly false; the other features may be true."""
    while True:
        person = random_person(draw)
        for feature in features:
            if feature is not missing and draw.chance(0.6):
                person = impose(draw, person, feature)
        if missing.holds(person) is False:
            return person


def joined(phrases: list[str]) -> str:
    """Phrases joined in a sentence: "a, b and c"."""
    return " and ".join(part for part in (", ".join(phrases[:-1]), phrases[-1]) if part)


def by_features(draw: Draw, count: int) -> tuple[str, Panel, list[Panel]]:
    """A description of `count` features, a panel that fits it, and two that do not."""
    features = random_features(draw, count)
    right = draw.portrait(person_with(draw, features))
    wrong: list[Panel] = []
    while len(wrong) < 2:
        panel = draw.portrait(person_lacking(draw, features, draw.pick(features)))
        if panel.option not in (right.option, *(other.option for other in wrong)):
            wrong.append(panel)
    return joined([feature.phrase for feature in features]), right, wrong


def absent_features(draw: Draw, count: int) -> tuple[str, list[Panel]]:
    """A description of `count` features that one person could show, and three panels that clearly do not fit it."""
    features = random_features(draw, count)
    wrong: list[Panel] = []
    while len(wrong) < 3:
        panel = draw.portrait(person_lacking(draw, features, draw.pick(features)))
        if panel.option not in {other.option for other in wrong}:
            wrong.append(panel)
    return joined([feature.phrase for feature in features]), wrong


def attributes(draw: Draw) -> Puzzle:
    """One or two attributes of a person: "the person with a red hat and glasses"."""
    described, right, wrong = by_features(draw, 1 + draw.below(2))
    return draw.puzzle(draw.frame(draw.noun(wording.ATTRIBUTES, x=described)), right, wrong)


def people(draw: Draw) -> Puzzle:
    """A member of the cast. In `unseen`, the person asked for is the only unknown identity of the three."""
    name = draw.pick(draw.pools.cast)
    others = draw.sample([known for known in TRAIN_CAST if known != name], 2)
    wrong = [cast_portrait(draw, other) for other in others]
    return draw.puzzle(draw.frame(draw.noun(wording.PEOPLE, x=name)), cast_portrait(draw, name), wrong)


def cast_portrait(draw: Draw, name: str) -> Panel:
    """One of many pictures of a member of the cast: the face stays, expression and clothes change."""
    mood = {key: draw.pick(PERSON_ATTRIBUTES[key]) for key in ("clothes", "clothes_color", "expression")}
    return draw.portrait(CAST[name] | mood, name)
