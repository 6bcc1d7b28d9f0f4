"""Single-stage families of the `hard` suite: training ingredients, but harder reasoning."""

from __future__ import annotations

from cognitivedrone.tasks import wording
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.families.human import by_features, person_lacking, person_with, random_features
from cognitivedrone.tasks.families.reasoning import OPERATORS, binary, nested, other_numbers
from cognitivedrone.tasks.generate import Draw, Panel, Puzzle, plural, words
from cognitivedrone.tasks.vocabulary import LETTERS

PLAIN_THINGS: tuple[str, ...] = (
    "dog", "cat", "lion", "horse", "zebra", "elephant", "giraffe", "penguin", "owl", "frog", "turtle", "snake",
    "butterfly", "snail", "apple", "banana", "carrot", "pizza", "cookie", "strawberry", "pineapple", "croissant",
    "hammer", "key", "umbrella", "chair", "guitar", "bicycle", "airplane", "book", "camera", "car", "balloon",
)  # fmt: skip
"""Easily distinguished animals, foods and objects, for families whose difficulty lies elsewhere."""
COUNTABLE: tuple[str, ...] = (
    "cat", "dog", "frog", "turtle", "bee", "butterfly", "apple", "banana", "lemon", "carrot", "cookie", "donut",
    "star", "key", "car", "balloon", "bell", "cactus",
)  # fmt: skip
"""Things that remain distinguishable and countable with six of them on a panel."""
_PURE_ANIMALS: tuple[str, ...] = (
    "dog", "cat", "lion", "horse", "zebra", "elephant", "giraffe", "penguin", "owl", "frog", "snake", "butterfly",
    "koala", "monkey", "bear", "bat", "parrot",
)  # fmt: skip
"""Animals that are not also food."""


def conjunction(draw: Draw) -> Puzzle:
    """Three or four attributes of one person."""
    described, right, wrong = by_features(draw, 3 + draw.below(2))
    sentence = draw.say("conjunction", "Fly through the gate with the person with {x}", x=described)
    return draw.puzzle(sentence, right, wrong)


def exclusion(draw: Draw) -> Puzzle:
    """A person with one attribute and without another."""
    absent, present = random_features(draw, 2)
    while True:
        right = person_with(draw, [present])
        if absent.holds(right) is False:
            break
    with_both = person_with(draw, [absent, present])
    without_either = person_lacking(draw, [], present)
    sentence = draw.say(
        "exclusion",
        "Fly through the gate with the person who has {present} but not {absent}",
        "Fly to the gate with the person with {present} and without {absent}",
        "Look for somebody without {absent} who has {present}, and fly through that gate",
        present=present.phrase,
        absent=absent.phrase,
    )
    panels = [draw.portrait(person) for person in (right, with_both, without_either)]
    return draw.puzzle(sentence, panels[0], panels[1:])


_RELATIONS: dict[int, tuple[tuple[int, str, str], ...]] = {
    0: (
        (1, "left", "Fly through the gate to the left of the {x}"),
        (2, "farthest", "Fly through the gate farthest from the {x}"),
        (2, "two left", "Fly through the gate two places to the left of the {x}"),
    ),
    1: (
        (0, "directly right", "Fly through the gate directly to the right of the {x}"),
        (2, "directly left", "Fly through the gate directly to the left of the {x}"),
        (0, "between", "Fly through the gate between the {x} and the {y}"),
    ),
    2: (
        (1, "right", "Fly through the gate to the right of the {x}"),
        (0, "farthest", "Fly through the gate farthest from the {x}"),
        (0, "two right", "Fly through the gate two places to the right of the {x}"),
    ),
}
"""By target: the position of the named thing, the relation, and the sentence; `y` is the third thing."""


def relations(draw: Draw) -> Puzzle:
    """A gate by its position relative to another thing."""
    names = draw.sample(PLAIN_THINGS, 3)
    anchor, relation, sentence = draw.pick(_RELATIONS[draw.target])
    (rest,) = {0, 1, 2} - {draw.target, anchor}
    a, b, c = (draw.drawing(KIND_OF[name], name) for name in names)
    sentence = draw.say(f"relations {relation}", sentence, x=words(names[anchor]), y=words(names[rest]))
    return Puzzle(sentence, (a, b, c))


KINDS = ("an animal", "a letter", "a number", "something to eat", "a musical instrument")


def _member(draw: Draw, kind: str) -> Panel:
    """A thing that belongs to one of the kinds and to no other."""
    if kind == "a letter":
        return draw.glyph("letter", draw.pick([letter for letter in LETTERS if letter not in "IO"]))
    if kind == "a number":
        return draw.glyph("number", draw.between(2, 20))
    if kind == "an animal":
        return draw.drawing("animal", draw.pick(_PURE_ANIMALS))
    if kind == "something to eat":
        return draw.drawing("food", draw.pick(("apple", "banana", "pizza", "cookie", "burger", "carrot", "cupcake")))
    return draw.drawing("object", draw.pick(("guitar", "violin", "trumpet", "drum", "saxophone")))


def negation(draw: Draw) -> Puzzle:
    """Negation: neither of two kinds, or not of the kind of both others."""
    right, first, second = draw.sample(KINDS, 3)
    if draw.chance(0.5):
        sentence = draw.say(
            "negation neither",
            "Fly through the gate with neither {first} nor {second}",
            "Fly to the gate that shows neither {first} nor {second}",
            "Avoid {first} and avoid {second}; take the remaining gate",
            first=first,
            second=second,
        )
        wrong = [_member(draw, first), _member(draw, second)]
        return draw.puzzle(sentence, _member(draw, right), wrong)
    wrong = [_member(draw, first)]
    while len(wrong) < 2:
        other = _member(draw, first)
        if other.option != wrong[0].option:
            wrong.append(other)
    sentence = draw.say(
        "negation not",
        "Fly through the gate that does not show {first}",
        "Fly to the only gate without {first}",
        "Take a gate, but not one that shows {first}",
        first=first,
    )
    return draw.puzzle(sentence, _member(draw, right), wrong)


def counting(draw: Draw) -> Puzzle:
    """Panels with several things: a given number, the most, the fewest, or more of one than of another."""
    name, other = draw.sample(COUNTABLE, 2)
    if draw.chance(1 / 3):
        more, fewer = sorted(draw.sample(range(1, 5), 2), reverse=True)
        same = draw.between(1, 3)
        low, high = sorted(draw.sample(range(1, 5), 2))
        panels = [_several(draw, {name: n, other: m}) for n, m in ((more, fewer), (low, high), (same, same))]
        sentence = draw.say(
            "counting more", "Fly through the gate with more {x} than {y}", x=plural(name), y=plural(other)
        )
        return draw.puzzle(sentence, panels[0], panels[1:])
    counts = draw.sample(range(1, 7), 3)
    if draw.chance(0.5):
        right = counts[0]
        noun = plural(name) if right > 1 else words(name)
        sentence = draw.say(
            "counting exactly",
            "Fly through the gate with exactly {word} {x}",
            n=right,
            word=wording.NUMBER_WORDS[right],
            x=noun,
        )
    else:
        right, superlative = draw.pick(((max(counts), "most"), (min(counts), "fewest")))
        sentence = draw.say(
            f"counting {superlative}", f"Fly through the gate with the {superlative} {{x}}", x=plural(name)
        )
    panel = {count: _several(draw, {name: count}) for count in counts}
    return draw.puzzle(sentence, panel.pop(right), list(panel.values()))


def _several(draw: Draw, counts: dict[str, int]) -> Panel:
    return draw.drawing("several", "+".join(f"{KIND_OF[name]}/{name}={count}" for name, count in counts.items()))


def distraction(draw: Draw) -> Puzzle:
    """A clear request among words about the wrong gates."""
    right, other, third = draw.sample(PLAIN_THINGS, 3)
    sentence = draw.say(
        "distraction",
        "My sister would choose the {other}, but today fly through the gate with the {right}",
        "Yesterday we flew to the {other} and then to the {third}; now fly through the gate with the {right}",
        "Forget what I said about the {other}: fly to the gate with the {right}",
        "The {other} looks inviting and the {third} is nearer, but take the gate with the {right}",
        "Fly through the gate with the {right}, and do not let the {other} tempt you",
        "The other drone flies to the {other}. You fly through the gate with the {right}. Leave the {third} alone",
        right=words(right),
        other=words(other),
        third=words(third),
    )
    panels = [draw.drawing(KIND_OF[name], name) for name in (right, other, third)]
    return draw.puzzle(sentence, panels[0], panels[1:])


_BY_WEIGHT = (
    ("ant", "bee", "mosquito", "ladybug"),
    ("mouse", "frog", "dove", "bat"),
    ("cat", "chicken", "rabbit", "fox", "eagle"),
    ("pig", "lion", "gorilla", "deer", "kangaroo"),
    ("elephant", "rhinoceros", "hippopotamus"),
    ("whale",),
)
"""Animals in weight classes; every adult of one class is heavier than any of the previous class."""
_BY_LEGS = (
    ("snake", "dolphin", "worm"),
    ("dove", "owl", "penguin", "duck", "flamingo"),
    ("cat", "horse", "cow", "lion", "elephant", "rabbit"),
    ("ant", "bee", "beetle", "cricket"),
    ("spider",),
)
"""Animals by their number of legs: 0, 2, 4, 6 and 8."""


RANKS = ("first", "middle", "last")
"""Names of the places in an ascending order of three."""


def comparison(draw: Draw) -> Puzzle:
    """Three things in an order; the first, the last or the middle one is right."""
    return draw.pick((_middle_number, _largest_sum, _alphabet, _by_class))(draw)


def _ordered(draw: Draw, what: str, panels: list[Panel], sentences: tuple[str, str, str], **fields: object) -> Puzzle:
    """Panels in ascending order, and the sentence for each."""
    rank = draw.below(3)
    sentence = draw.say(f"comparison {what} {RANKS[rank]}", sentences[rank], **fields)
    return draw.puzzle(sentence, panels[rank], [p for i, p in enumerate(panels) if i != rank])


def _middle_number(draw: Draw) -> Puzzle:
    numbers = sorted(draw.sample(range(21), 3))
    return _ordered(
        draw,
        "number",
        [draw.glyph("number", n) for n in numbers],
        (
            "Fly through the gate with the only number below {n}",
            "Fly through the gate with the number that is neither the largest nor the smallest",
            "Fly through the gate with the only number above {n}",
        ),
        n=numbers[1],
    )


def _largest_sum(draw: Draw) -> Puzzle:
    by_value: dict[int, str] = {}
    while len(by_value) < 3:
        text, value = binary(draw)
        by_value[value] = text
    return _ordered(
        draw,
        "sum",
        [draw.glyph("sum", by_value[value]) for value in sorted(by_value)],
        (
            "Fly through the gate whose sum has the smallest result",
            "Fly through the gate whose sum has neither the largest nor the smallest result",
            "Fly through the gate whose sum has the largest result",
        ),
    )


def _alphabet(draw: Draw) -> Puzzle:
    letters = sorted(draw.sample(LETTERS, 3))
    return _ordered(
        draw,
        "letter",
        [draw.glyph("letter", letter) for letter in letters],
        (
            "Fly through the gate with the letter that comes first in the alphabet",
            "Fly through the gate with the letter that is second of the three in the alphabet",
            "Fly through the gate with the letter that comes last in the alphabet",
        ),
    )


def _by_class(draw: Draw) -> Puzzle:
    classes, low, high, what = draw.pick(
        ((_BY_WEIGHT, "lightest", "heaviest", "weight"), (_BY_LEGS, "fewest", "most", "legs"))
    )
    chosen = sorted(draw.sample(range(len(classes)), 3))
    panels = [draw.drawing("animal", draw.pick(classes[i])) for i in chosen]
    if what == "legs":
        low, high = f"animal with the {low} legs", f"animal with the {high} legs"
        middle = "animal that has neither the fewest nor the most legs"
    else:
        low, high = f"{low} animal", f"{high} animal"
        middle = "animal that is neither the lightest nor the heaviest"
    start = "Fly through the gate with the"
    return _ordered(draw, what, panels, (f"{start} {low}", f"{start} {middle}", f"{start} {high}"))


def two_step(draw: Draw) -> Puzzle:
    """Two calculations in sequence: in words, in brackets, or one on the board and one in the sentence."""
    return draw.pick((_in_words, _in_brackets, _from_board))(draw)


def _in_words(draw: Draw) -> Puzzle:
    while True:
        a, b = draw.between(1, 12), draw.between(1, 12)
        c = draw.between(1, 5)
        first, second = draw.pick("+-*"), draw.pick("+-*")
        inner = OPERATORS[first](a, b)
        answer = OPERATORS[second](inner, c)
        pairs_allowed = all(draw.pools.pair_allowed(*pair) for pair in ((a, b), (a, c), (b, c)))
        if inner >= 0 and 0 <= answer <= 20 and pairs_allowed:
            break
    begin = {"+": f"Add {a} and {b}", "-": f"Subtract {b} from {a}", "*": f"Multiply {a} by {b}"}[first]
    then = {"+": f"add {c}", "-": f"take away {c}", "*": f"multiply the result by {c}"}[second]
    sentence = draw.say(
        "two_step words",
        "{begin}, then {then}, and fly through the gate with the number you get",
        begin=begin,
        first=begin[0].lower() + begin[1:],
        then=then,
    )
    return draw.puzzle(sentence, draw.glyph("number", answer), other_numbers(draw, answer))


def _in_brackets(draw: Draw) -> Puzzle:
    text, answer = nested(draw)
    sentence = draw.say("two_step brackets", "Fly through the gate with the result of {x}", x=text)
    return draw.puzzle(sentence, draw.glyph("number", answer), other_numbers(draw, answer))


def _from_board(draw: Draw) -> Puzzle:
    text, on_board = binary(draw)
    step = draw.between(1, 5)
    more = on_board + step <= 20 and (on_board < step or draw.chance(0.5))
    answer = on_board + step if more else on_board - step
    if answer < 0:
        return _from_board(draw)
    name = "more" if more else "less"
    sentence = draw.say(
        f"two_step {name}",
        f"Fly through the gate with the number that is {{n}} {name} than the sum on the board",
        n=step,
    )
    wrong = other_numbers(draw, answer)
    return draw.puzzle(sentence, draw.glyph("number", answer), wrong, draw.glyph("sum", text).label)
