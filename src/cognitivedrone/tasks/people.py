"""Drawn people: what can be said of somebody, and a cast of invented names.

A person is a mapping from attribute to value; what is left out has the first value of its row. Nothing is ever asked
about skin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from cognitivedrone.references import PERSON_ATTRIBUTES, full_person

Person = dict[str, str]

IDENTITY: tuple[str, ...] = ("skin", "hair", "hair_color", "hat", "hat_color", "glasses", "beard")
"""The attributes that stay the same in every picture of a member of the cast; the rest varies."""


def person_label(person: Mapping[str, str], background: str) -> str:
    """The canonical label reference of a person: schema order, defaults omitted, skin always written."""
    words = [
        f"{name}={person[name]}"
        for name, values in PERSON_ATTRIBUTES.items()
        if name in person and (name == "skin" or person[name] != values[0])
    ]
    if "skin" not in person:
        words.insert(0, f"skin={PERSON_ATTRIBUTES['skin'][0]}")
    return f"person/{','.join(words)}@{background}"


def parse_person(concept: str) -> Person:
    """The attributes written in the concept of a person label, without defaults."""
    return dict(word.split("=", 1) for word in concept.split(","))


def seen(person: Mapping[str, str]) -> Person:
    """Every attribute as a viewer sees it; what a hat or a headscarf covers is `hidden`."""
    full = full_person(person)
    if full["hat"] == "none":
        full["hat_color"] = "hidden"
        if full["hair"] == "bald":
            full["hair_color"] = "hidden"
    else:
        full["hair"] = full["hair_color"] = "hidden"
    if full["hat"] == "hijab":
        full["clothes"] = "hidden"
    return full


_WORDS = {
    "hijab": "headscarf", "round": "round glasses", "full": "full beard", "tshirt": "T-shirt", "overall": "overalls",
    "vneck": "V-neck shirt", "smile": "smiling", "wink": "winking", "shaved_sides": "shaved sides",
    "short": "short hair", "curly": "curly hair", "long": "long hair",
}  # fmt: skip
"""Values that read badly alone."""


def describe_person(concept: str) -> str:
    """What a viewer sees of a person, in plain words: "green hat, full beard, yellow overalls, sad".

    As in all tasks, nothing is said about skin. Raises `ValueError` if the concept is not a person's.
    """
    person = parse_person(concept)
    if not person.keys() <= PERSON_ATTRIBUTES.keys():
        raise ValueError(f"{concept!r} is not a person")
    return described(seen(person))


def described(look: Mapping[str, str]) -> str:
    """The same for a person as a viewer sees it (see `seen`), where attributes may be missing."""
    words = []
    for name in ("hat", "hair", "glasses", "beard", "clothes", "expression"):
        value = look.get(name, "hidden")
        if value not in ("none", "hidden"):
            color = look.get(f"{name}_color", "hidden")
            words.append((f"{color} " if color != "hidden" else "") + _WORDS.get(value, value))
    return ", ".join(words)


@dataclass(frozen=True, slots=True)
class Feature:
    """A visible property of a person, phrased to follow "with"."""

    phrase: str
    wanted: Mapping[str, tuple[str, ...]]
    """Values that make it true, by attribute; all attributes must agree."""
    doubtful: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Further, debatable values; a person with one of them is never an option."""

    def holds(self, person: Mapping[str, str]) -> bool | None:
        """Whether it is true of a person; None if debatable."""
        return self.shows(seen(person))

    def shows(self, look: Mapping[str, str]) -> bool | None:
        """The same for a person as a viewer sees it (see `seen`)."""
        doubt = False
        for name, values in self.wanted.items():
            if look[name] in values:
                continue
            if look[name] not in (*self.doubtful.get(name, ()), "hidden"):
                return False
            doubt = True
        return None if doubt else True


def _hat(phrase: str, kind: str, *, doubtful: tuple[str, ...] = ()) -> list[Feature]:
    plain = Feature(f"a {phrase}", {"hat": (kind,)}, {"hat": doubtful})
    colored = [
        Feature(f"a {color} {phrase}", {"hat": (kind,), "hat_color": (color,)}, {"hat": doubtful})
        for color in PERSON_ATTRIBUTES["hat_color"]
    ]
    return [plain, *colored]


def _hair(phrase: str, kind: str, *doubtful: str) -> Feature:
    return Feature(phrase, {"hair": (kind,)}, {"hair": doubtful})


def _clothes(phrase: str, kind: str, doubtful: tuple[str, ...]) -> list[Feature]:
    return [
        Feature(f"a {color} {phrase}", {"clothes": (kind,), "clothes_color": (color,)}, {"clothes": doubtful})
        for color in PERSON_ATTRIBUTES["clothes_color"]
    ]


# Only attributes that are visible from the start are used, on a panel some forty pixels high: no stubble, no wink.
FEATURES: tuple[Feature, ...] = (
    *_hat("hat", "hat", doubtful=("beanie", "turban", "hijab")),
    *_hat("beanie", "beanie"),
    *_hat("turban", "turban", doubtful=("hijab",)),
    *_hat("headscarf", "hijab", doubtful=("turban",)),
    _hair("curly hair", "curly", "afro", "dreadlocks"),
    _hair("long hair", "long", "bob", "dreadlocks", "shaved_sides"),
    _hair("a bun", "bun"),
    _hair("an afro", "afro", "curly"),
    _hair("dreadlocks", "dreadlocks"),
    _hair("shaved sides", "shaved_sides", "bald", "long"),
    # A hat may hide a bald head, and only a bare head shows baldness: hats are debatable through `hidden`.
    _hair("a bald head", "bald", "shaved_sides"),
    *(
        Feature(f"{word} hair", {"hair_color": (color,)}, {"hair_color": doubtful})
        for word, color, doubtful in (
            ("brown", "brown", ("black", "red")),
            ("black", "black", ("brown",)),
            ("blond", "blond", ("gray",)),
            ("red", "red", ("brown", "pink")),
            ("gray", "gray", ("blond",)),
            ("pink", "pink", ("red",)),
        )
    ),
    Feature("glasses", {"glasses": ("glasses", "round")}, {"glasses": ("sunglasses",)}),
    Feature("round glasses", {"glasses": ("round",)}, {"glasses": ("glasses", "sunglasses")}),
    Feature("sunglasses", {"glasses": ("sunglasses",)}),
    Feature("an eyepatch", {"glasses": ("eyepatch",)}),
    Feature("a full beard", {"beard": ("full",)}, {"beard": ("stubble",)}),
    Feature("a moustache", {"beard": ("moustache",)}, {"beard": ("full", "stubble")}),
    Feature("a blazer", {"clothes": ("blazer",)}),
    Feature("overalls", {"clothes": ("overall",)}),
    *_clothes("hoodie", "hoodie", ("sweater",)),
    *_clothes("T-shirt", "tshirt", ("vneck", "sweater", "overall")),
    Feature("a surprised look", {"expression": ("surprised",)}),
    Feature("a laughing face", {"expression": ("laughing",)}, {"expression": ("smile", "wink")}),
)

_CAST = {
    "Amara": "skin=dark,hair=bun,hair_color=gray",
    "Anton": "skin=light,hair=afro,glasses=sunglasses,beard=moustache",
    "Bella": "skin=light,hair=bob,hair_color=black",
    "Boris": "skin=dark,hair=dreadlocks,hair_color=blond,glasses=eyepatch,beard=moustache",
    "Chiara": "skin=dark,hat=hijab,hat_color=yellow,glasses=glasses",
    "Carlos": "skin=dark,hair=dreadlocks,hair_color=blond,glasses=glasses,beard=full",
    "Dalia": "skin=brown,hat=hat,glasses=glasses",
    "Diego": "skin=dark,hair=shaved_sides,hair_color=red,beard=full",
    "Esra": "skin=tan,hair=afro,hair_color=pink,glasses=glasses",
    "Emil": "skin=tan,hair=bald,beard=full",
    "Freya": "skin=tan,hair=curly,glasses=eyepatch",
    "Farid": "skin=dark,hair=curly,hair_color=black,glasses=sunglasses,beard=full",
    "Greta": "skin=brown,hair_color=pink,glasses=sunglasses",
    "Gustav": "skin=dark,hat=beanie,hat_color=yellow,glasses=eyepatch,beard=full",
    "Hana": "skin=dark,hair=dreadlocks,hair_color=blond",
    "Hugo": "skin=tan,hat=turban,hat_color=black",
    "Ines": "skin=dark,hair=long,hair_color=gray,glasses=sunglasses",
    "Ivan": "skin=dark,hair_color=gray,hat=hat,hat_color=green,beard=moustache",
    "Jasmin": "skin=light,hair=bob,hair_color=gray,glasses=round",
    "Jonas": "skin=light,hair_color=blond,glasses=eyepatch",
    "Kaya": "skin=light,hat=beanie,glasses=sunglasses",
    "Kofi": "skin=brown,hair_color=black,glasses=glasses,beard=full",
    "Leila": "skin=tan,hair=long,hair_color=blond,glasses=round",
    "Luca": "skin=tan,hat=beanie,hat_color=yellow,beard=moustache",
    "Mira": "skin=brown,hair=afro,hair_color=blond,glasses=sunglasses",
    "Marco": "skin=light,hair_color=black,hat=turban,hat_color=black,glasses=eyepatch,beard=full",
    "Nadia": "skin=brown,hair=afro,hair_color=red",
    "Niko": "skin=dark,hair_color=red,hat=turban,hat_color=yellow,glasses=eyepatch,beard=moustache",
    "Olga": "skin=tan,hair=bun,hair_color=black,glasses=sunglasses",
    "Omar": "skin=tan,hair=shaved_sides,hair_color=black,beard=moustache",
    "Priya": "skin=brown,hat=hat,hat_color=white,glasses=sunglasses",
    "Pavel": "skin=tan,hair_color=red,hat=turban,hat_color=black,glasses=round,beard=moustache",
    "Rosa": "skin=dark,hair=bun,glasses=glasses",
    "Quinn": "skin=brown,hat=beanie,hat_color=white,glasses=round,beard=full",
    "Sanna": "skin=dark,hair=long,hair_color=pink",
    "Rafael": "skin=dark,hair_color=gray,beard=full",
    "Tara": "skin=dark,hair=bob,glasses=sunglasses",
    "Samir": "skin=brown,hat=beanie,hat_color=blue,glasses=glasses",
    "Uma": "skin=brown,hair_color=red,glasses=glasses",
    "Tomas": "skin=dark,beard=moustache",
    "Vera": "skin=tan,hat=hat,hat_color=blue,glasses=eyepatch",
    "Ugo": "skin=brown,hair=afro,hair_color=black,glasses=glasses,beard=moustache",
    "Wanda": "skin=light,hat=hijab,hat_color=white",
    "Viktor": "skin=dark,hair=shaved_sides,hair_color=gray,glasses=round,beard=full",
    "Yuki": "skin=tan,hat=beanie,hat_color=green,glasses=eyepatch",
    "Wei": "skin=dark,hair_color=black,hat=beanie,hat_color=blue,beard=full",
    "Zara": "skin=light,hair=dreadlocks,hair_color=black,glasses=round",
    "Yusuf": "skin=tan,hair=long,hair_color=black,glasses=eyepatch,beard=full",
}

CAST: dict[str, Person] = {name: parse_person(identity) for name, identity in _CAST.items()}
"""The identity of every named person: invented, and different from any other in at least two visible attributes."""

HELD_OUT_CAST: tuple[str, ...] = ("Uma", "Ugo", "Wanda", "Viktor", "Yuki", "Wei", "Zara", "Yusuf")
"""Unknown identities: only `unseen` asks for them, beside two people known from `train`."""
TRAIN_CAST: tuple[str, ...] = tuple(name for name in CAST if name not in HELD_OUT_CAST)
